"""Read measurements into arrays: recordings, frequency responses and accelerometer captures."""
