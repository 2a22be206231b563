"""The firmware's plan: limits, look-ahead, trajectories, sections, segment timing."""
