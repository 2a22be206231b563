"""Stamps, and the lines that tell times: as slicers write them and as hosts read them."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gcode.metadata import Durations, Tells, Timed, retold, slicer_time_s, stated_time, tells, with_time
from tests.support.data import real

NORMAL, SILENT = (b"; estimated printing time (%s mode) = " % mode for mode in (b"normal", b"silent"))
MODEL, TOTAL = b"; model printing time: ", b"; total estimated time: "
TOTALS = [  # as the slicer writes it, s, and what is written for 93,784.6 s
    (NORMAL + b"1h 2m 3s\n", 3723, NORMAL + b"1d 2h 3m 5s\n"),
    (SILENT + b"13h 0m 30s\r\n", 46830, SILENT + b"1d 2h 3m 5s\r\n"),
    (b"; estimated printing time = 1h 5m 24s\n", 3924, b"; estimated printing time = 1d 2h 3m 5s\n"),
    (MODEL + b"28m 4s" + TOTAL + b"34m 6s\n", 2046, MODEL + b"1d 2h 3m 5s" + TOTAL + b"1d 2h 3m 5s\n"),
    (b"; total estimated time: 34m 6s\n", 2046, b"; total estimated time: 1d 2h 3m 5s\n"),
    (b";TIME:2848\n", 2848, b";TIME:93785\n"),
    (b";   Build time: 1 hour 2 minutes\n", 3720, b";   Build time: 26 hours 3 minutes\n"),
    (b";   Build Time: 0 hours 42 min 9 sec\n", 2529, b";   Build Time: 26 hours 3 minutes\n"),
]


@pytest.mark.parametrize(("line", "seconds", "new"), TOTALS)
def test_every_slicers_total(line: bytes, seconds: float, new: bytes) -> None:
    assert tells(line) is Tells.TOTAL
    stated = slicer_time_s([b"G28\n", b"; estimated first layer printing time (normal mode) = 9s\n", line])
    assert stated == pytest.approx(seconds)
    assert retold(Timed.at(line, 17.0), Durations(93784.6)) == new


@pytest.mark.parametrize(
    ("line", "at_s", "new"),
    [
        (MODEL + b"14m 40s" + TOTAL + b"2h 4m 0s\n", 0.0, MODEL + b"16m 40s" + TOTAL + b"2h 6m 0s\n"),
        (NORMAL + b"2h 4m 0s\n", 0.0, NORMAL + b"2h 6m 0s\n"),
        (b"M73 P3 R124\n", 0.0, b"M73 P3 R126\n"),
        (b"M73 P60 R40 S41\n", 1800.0, b"M73 P60 R41 S42\n"),
        (b"M73 P60 R20\n", 1800.0, b"M73 P60 R30\n"),
        (b"M73 P100 R0\n", 3600.0, b"M73 P100 R0\n"),
    ],
)
def test_what_a_slicer_counts_beside_the_moves_is_kept(line: bytes, at_s: float, new: bytes) -> None:
    assert retold(Timed.at(line, at_s), Durations(3600.0, sliced_s=3480.0)) == new


@given(st.lists(st.floats(0, 1e6), min_size=1), st.integers(0, 100))
def test_progress_never_goes_back(times: list[float], said: int) -> None:
    times = sorted(times)
    whole = Durations(times[-1])
    lines = [retold(Timed.at(b"M73 P%d R5\n" % min(said, 99), t), whole) for t in times]
    numbers = [tuple(map(int, re.findall(rb"\d+", line[4:]))) for line in lines]
    assert [p for p, _ in numbers] == sorted(p for p, _ in numbers)
    assert [r for _, r in numbers] == sorted((r for _, r in numbers), reverse=True)
    assert numbers[-1] == (100, 0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "seconds", "lines_that_tell"),
    [
        ("ender3_ringing_tower.gcode", 3840, 1),
        ("gcodepreview_vase.gcode", 4000, 2),
        ("kossel_mks-pwc.gcode", 2655, 1),
        ("makreeltje_cura_slicer.gcode", 2848, 26),
        ("makreeltje_orca_slicer.gcode", 5563, 195),
        ("flsun_v400_retract-tower.gcode", None, 0),
    ],
)
def test_times_of_real_files(name: str, seconds: float | None, lines_that_tell: int) -> None:
    lines = real(name).splitlines(keepends=True)
    assert slicer_time_s(lines) == seconds
    changed = [retold(Timed.at(line, 0.0), Durations(7261.0, 60.0)) for line in lines]
    assert slicer_time_s(changed) == (None if seconds is None else pytest.approx(7261.0, abs=1))
    assert sum(tells(line) is not None for line in lines) == lines_that_tell
    back = [with_time(new, stated_time(line)) for line, new in zip(lines, changed, strict=True)]
    assert back == lines
