"""Non-ideal behaviour of printers: each effect is one declaration, in the file of its family."""
