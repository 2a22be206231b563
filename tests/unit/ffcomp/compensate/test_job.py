"""What a job does before the first move: firmware and offset."""

from __future__ import annotations

from dataclasses import replace

import pytest

from ffcomp.compensate.job import Job, Options
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
