"""Checks of a machine file: redundant parameters and physics."""
