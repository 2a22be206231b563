"""Hidden deltas: equations, numbers and effects of their own."""
