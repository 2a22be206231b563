"""Identification from a picture of a page that the printer has drawn."""
