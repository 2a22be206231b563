"""From measurements to the numbers of a machine file."""
