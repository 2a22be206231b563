"""Compare what the printer's own accelerometer feels today with the machine file and with earlier checks."""
