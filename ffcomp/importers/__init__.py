"""Import printer configurations into a machine file: Klipper, Kalico, RepRapFirmware, Marlin.

Each firmware has its file (`klipper.py`, `reprapfirmware.py`, `marlin.py`) and returns `ConfigValues` (`values.py`);
`builder.py` detects the firmware by content, fills in from a library machine the values that no firmware
knows, names those still missing with a hint, and writes the machine file.
"""
