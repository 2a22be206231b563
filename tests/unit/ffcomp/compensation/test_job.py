"""What a job does before the first move: firmware and offset."""

from __future__ import annotations

from dataclasses import replace

import pytest

from ffcomp.compensation.job import Job, Options
from models.file import load_machine

MARLIN = b"; gcode_flavor = marlin\nG1 X1 F60\n"


@pytest.mark.parametrize(
    ("asked", "stated", "flavor"),
    [("", "", "marlin"), ("", "klipper", "klipper"), ("reprapfirmware", "klipper", "reprapfirmware")],
)
def test_the_flavor_asked_for_goes_before_the_machines_and_that_before_the_files(
    asked: str, stated: str, flavor: str
) -> None:
    machine = replace(load_machine("mp-delta-pro"), flavor=stated)
    assert Job(MARLIN, "print.gcode", machine, Options(flavor=asked)).flavor == flavor


def test_a_print_for_another_firmware_is_compensated_with_a_warning() -> None:
    machine = replace(load_machine("mp-delta-pro"), flavor="klipper")
    job = Job(MARLIN + b"G1 X0 Y0 Z1 F600\nG1 X5 F3000\nG1 X0\n", "print.gcode", machine, Options(predict=False))
    answer = job.write(None).to_dict()
    assert answer["flavor_reason"] == "Firmware: klipper, as the machine file says."
    assert any("made for marlin (; gcode_flavor = marlin)" in warning for warning in answer["warnings"])
