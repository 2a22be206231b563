"""The firmware's plan: limits, look-ahead, trajectories, S-curves, sections, segment timing."""
