"""Non-ideal behaviour of printers: one declaration per effect, in the file of its family."""
