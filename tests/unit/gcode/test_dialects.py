from __future__ import annotations

import pytest

from gcode.dialects import flavor_sign


@pytest.mark.parametrize(
    ("lines", "flavor"),
    [
        ([b"G28\n"], "marlin"),
        ([b"; gcode_flavor = klipper\n"], "klipper"),
        ([b"; gcode_flavor = reprapfirmware\n"], "reprapfirmware"),
        ([b";FLAVOR:RepRap\n"], "reprapfirmware"),
        ([b";FLAVOR:Marlin\n", b"START_PRINT BED=60\n"], "klipper"),
        ([b"M566 X600\n"], "reprapfirmware"),
        ([b"G32\n"], "reprapfirmware"),
        ([b"; by_hand\n", b"; Flavor\n", b"; GCODE_FLAVOR: RRF\n"], "reprapfirmware"),
        ([b"M204 S3000\n", b"G1 X1\n"], "klipper"),
        ([b";FLAVOR:Marlin\n", b"M204 S500\n", b"M205 X8 Y8\n"], "klipper"),  # Cura, which knows no Klipper
        ([b"M204 S3000\n", b"M205 X8 Y8\n"], "marlin"),
        ([b'M862.3 P "XL"\n', b"M572 S0.03\n"], "marlin"),  # Prusa's firmware
        ([b"; gcode_flavor = marlin\n", b"M204 S3000\n"], "marlin"),  # of a slicer that knows Klipper too
    ],
)
def test_flavor(lines: list[bytes], flavor: str) -> None:
    assert flavor_sign(lines).flavor == flavor
