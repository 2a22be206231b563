"""Estimate the time of a print by planning it as the firmware does."""
