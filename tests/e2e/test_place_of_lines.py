"""Lines that are not moves stay where they were along the filament, in real files: docs/SAFETY.md says how exactly."""

from __future__ import annotations

import gzip

import pytest

from ffcomp.compensation.job import Job, Options
from gcode.embedded import joined
from models.file import load_machine
from tests.support.data import real
from validation.invariants import LINE_MM, violations


@pytest.mark.parametrize(
    ("name", "machine"),
    [
        ("real/kage_kirimoto.gcode.gz", "voron-300"),  # relative E, and nothing says so
        ("real/chest_benchy.gcode.gz", "prusa-mini"),  # a comment for each width of a line
        ("real/fast_part.gcode.gz", "ender-3"),  # a purge line beside the bed
    ],
)
def test_every_line_stays_within_what_safety_promises(name: str, machine: str) -> None:
    assert LINE_MM == 5e-3
    data = b"".join(gzip.decompress(real(name)).splitlines(keepends=True)[:1600])
    job = Job(data, name, load_machine(machine), Options(predict=False))
    assert violations(data, b"".join(joined(job.lines())), job.machine, job.offset, job.flavor) == []
