"""Step timings: from a nozzle path to step times, and to files and back."""
