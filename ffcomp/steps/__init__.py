"""Step timings: from a nozzle path to the moments at which motors step, and to files and back."""
