"""ffcomp: feedforward vibration compensation for the G-code of delta 3-D printers."""

__version__ = "0.1.0"
