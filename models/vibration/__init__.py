"""Linear models of how a machine vibrates."""
