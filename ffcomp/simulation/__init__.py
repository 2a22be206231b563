"""Simulate any command, G-code as a firmware executes it or step timings, on the linear or the nonlinear printer."""
