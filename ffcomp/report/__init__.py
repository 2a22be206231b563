"""Figures and pages of every verb; they read results only."""
