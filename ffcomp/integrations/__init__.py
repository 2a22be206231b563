"""Slicers and hosts: what they say when they call us, and the wrappers for those that cannot call a program."""
