"""What printers do beyond the model: one file per effect, found by `catalogue.py`."""
