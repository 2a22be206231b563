"""Linear vibration models of machines."""
