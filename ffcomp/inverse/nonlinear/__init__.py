"""Iterative correction on the simulated printer, for effects that no linear model holds."""
