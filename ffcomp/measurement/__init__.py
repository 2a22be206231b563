"""Measurements: runs, frequency responses and accelerometer captures, from files to arrays."""
