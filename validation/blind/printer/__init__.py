"""What every hidden printer has, whatever its kind: how it is drawn, driven and read, and what it may hide."""
