"""What the public functions do and return; `ffcomp` offers them by name, and imports a module when it is first used."""
