"""One axis by itself, driven by a force or by a position: its numbers, its equations, its simulation."""
