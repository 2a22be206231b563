"""The firmwares that ffcomp knows."""

from __future__ import annotations

from collections.abc import Mapping

from ffcomp.firmware.base import Firmware
from ffcomp.firmware.klipper import Klipper
from ffcomp.firmware.marlin import Marlin
from ffcomp.firmware.reprapfirmware import RepRapFirmware

FIRMWARES: Mapping[str, Firmware] = {each.flavor: each for each in (Klipper(), Marlin(), RepRapFirmware())}
