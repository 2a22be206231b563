"""The inverse: from a reference to the command whose response it is."""
