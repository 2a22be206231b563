"""Non-ideal behaviour of printers: one file for each effect, found by `catalogue.py`."""
