"""Solutions as G-code."""
