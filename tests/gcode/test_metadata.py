from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gcode.metadata import Stamp, find_stamp, scale_time, slicer_time_s, stamp_line
from tests.gcode.data import real


@pytest.mark.parametrize(
    ("line", "seconds", "twice"),
    [
        (
            b"; estimated printing time (normal mode) = 1h 2m 3s\n",
            3723,
            b"; estimated printing time (normal mode) = 2h 4m 6s\n",
        ),
        (
            b"; estimated printing time (silent mode) = 13h 0m 30s\r\n",
            46830,
            b"; estimated printing time (silent mode) = 1d 2h 1m\r\n",
        ),
        (b";TIME:2848\n", 2848, b";TIME:5696\n"),
        (b";Print Time: 3645\n", 3645, b";Print Time: 7290\n"),
        (b";   Build time: 1 hour 2 minutes\n", 3720, b";   Build time: 2 hours 4 minutes\n"),
    ],
)
def test_every_slicers_time(line: bytes, seconds: float, twice: bytes) -> None:
    assert slicer_time_s([b"G28\n", line]) == seconds
    assert scale_time(line, 2.0) == twice


@pytest.mark.parametrize(
    ("name", "seconds"),
    [
        ("ender3_ringing_tower.gcode", 3840),
        ("gcodepreview_vase.gcode", 4000),
        ("kossel_mks-pwc.gcode", 2655),
        ("makreeltje_cura_slicer.gcode", 2848),
        ("makreeltje_orca_slicer.gcode", 5563),
        ("flsun_v400_retract-tower.gcode", None),
    ],
)
def test_times_of_real_files(name: str, seconds: float | None) -> None:
    lines = real(name).splitlines(keepends=True)
    assert slicer_time_s(lines) == seconds
    changed = [scale_time(line, 1.5) for line in lines]
    assert slicer_time_s(changed) == (None if seconds is None else pytest.approx(1.5 * seconds, abs=30))
    assert sum(a != b for a, b in zip(lines, changed, strict=True)) <= 200


def test_progress_stays_whole() -> None:
    assert scale_time(b"M73 P50 R91\n", 1.11) == b"M73 P50 R101\n"
    assert scale_time(b"M73 Q10 S5 ; x\r\n", 3.0) == b"M73 Q10 S15 ; x\r\n"
    assert scale_time(b"M73 P50\n", 3.0) == b"M73 P50\n"


@given(st.binary(max_size=40).map(lambda text: b"; " + text))
def test_other_lines_come_back_as_they_are(line: bytes) -> None:
    assert scale_time(line, 2.0) == line


def test_stamp_round_trip() -> None:
    line = stamp_line("1.2.3", "MP Delta Pro, direct\ndrive", "abcd1234ef", "klipper")
    assert line.count(b"\n") == 1
    stamp = Stamp("1.2.3", "MP Delta Pro, direct drive", "abcd1234", "klipper")
    assert find_stamp(b"; head\n" + line, b"") == find_stamp(b"", b"M84\n" + line) == stamp
    assert find_stamp(b"; Processed by another tool\n", b"") is None
