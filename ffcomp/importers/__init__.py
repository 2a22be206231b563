"""Printer configurations of other programs, read into a machine file: Klipper, Kalico, RepRapFirmware, Marlin.

`source.read` tells by content which one a file is; each firmware has its file (`klipper.py`, `reprapfirmware.py`,
`marlin.py`) and hands back what it says as `Found` (`found.py`); `draft.py` fills in from a library machine what no
firmware knows, names what is still missing, and writes the machine file.
"""
