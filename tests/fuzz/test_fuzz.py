"""Whatever the bytes: a result or a documented error, that names its file and says what is wrong, in a sentence.

`HYPOTHESIS_PROFILE=default` draws new inputs at every run.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from ffcomp.errors import LimitsError, MeasurementError
from ffcomp.measurement.frf_files import read_frfs
from ffcomp.measurement.recording import read_recording
from ffcomp.measurement.vibration import read_vibrations
from gcode.errors import GcodeError
from gcode.reader import read_parts, read_program
from models.errors import MachineFileError
from tests.fuzz.test_random_programs import compensated, inverter
from validation.invariants import violations

quick = settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))

# -- G-code --

ODD_NUMBERS = """-0 +0 .5 5. -.5 1e3 1e400 nan inf --1 1.2.3 - 1e-9 999999 1000001 \u0661\u0662 {x} 1,5 0x10 1_0 \x00 #1
[1+2]"""
NUMBERS = st.one_of(
    st.integers(-60, 60).map(str),
    st.floats(-40, 40).map("{:.3f}".format),
    st.sampled_from([*ODD_NUMBERS.split(), "", "9" * 40, "0." + "0" * 400]),
)
WORDS = st.tuples(st.sampled_from([*"XYZEFIJKRSPHTN", "x", "A", "\u00e9", "*", ";", "(", '"']), NUMBERS).map("".join)
CODES = """G0 G1 G1 G1 G2 G3 G4 G10 G17 G18 G19 G20 G21 G28 G90 G91 G92 M82 M83 M104 M106 M117 M201 M203 M204 M205 M220
M221 M566 T0 T1 g01 MACRO_ N1 G1.5 G999999999999 T99999999999999999999 % *12"""
WHOLE = (
    "SAVE_GCODE_STATE NAME=a",
    "RESTORE_GCODE_STATE NAME=a MOVE=1",
    "SET_VELOCITY_LIMIT ACCEL=",
    "SET_GCODE_OFFSET Z=",
)
COMMANDS = st.sampled_from([*CODES.split(), *WHOLE, "M" + "9" * 30, "if {x}", ""])
LINES = st.tuples(
    COMMANDS, st.lists(WORDS, max_size=5).map(" ".join), st.sampled_from(["\n", "\r\n", "\r", "\n\n", ""])
)
TEXTS = st.lists(LINES.map(lambda parts: f"{parts[0]} {parts[1]}{parts[2]}"), max_size=12).map("".join)
START = b"G28\nG90\nM83\nG1 X10 Y10 Z5 F6000\nG1 X12 Y10 E.1\n"


@settings(quick, max_examples=30)
@given(text=TEXTS)
def test_gcode_by_its_grammar(text: str) -> None:
    """It is read, compensated and safe; or refused with the line and the rule."""
    data = START + text.encode() + b"\nG1 X14 Y11 E.1\n"
    out, refused = tried(lambda: compensated(data, inverter()), GcodeError, LimitsError)
    if isinstance(refused, GcodeError):
        assert refused.path == "print.gcode" and refused.rule[-1] in ".?)" and len(str(refused)) < 1000
        assert refused.line is not None and 5 <= refused.line <= data.count(b"\n") + data.count(b"\r") + 1
    elif out is not None:
        assert violations(data, out, inverter().machine) == []


T = TypeVar("T")


def tried(do: Callable[[], T], *documented: type[Exception]) -> tuple[T | None, Exception | None]:
    """A result, or a documented error; any other passes through."""
    try:
        return do(), None
    except documented as error:
        return None, error


@quick
@given(data=st.binary(max_size=300), cut=st.integers(1, 300))
@example(data=b"\xef\xbb\xbfG1 X1\n", cut=2)
@example(data=b"G1 X1\r\r\n\n\rG1 Y\x00", cut=1)
def test_any_bytes_read_whole_or_in_parts_say_the_same(data: bytes, cut: int) -> None:
    whole = outcome(lambda: [len(read_program(data, "p", flavor="marlin").moves)])
    blocks = [data[at : at + cut] for at in range(0, len(data), cut)]
    parts = outcome(lambda: [len(part.moves) for part in read_parts(blocks, "p", flavor="marlin", part_bytes=cut)])
    assert sum(whole) == sum(parts) if isinstance(whole, list) and isinstance(parts, list) else whole == parts


def outcome(read: Callable[[], list[int]]) -> list[int] | str:
    try:
        return read()
    except GcodeError as error:
        return str(error)


HOSTILE = {
    "one line of 1 MB": b"G1 X" + b"1" * 1_000_000,
    "a comment of 1 MB": START + b";" + b"x" * 1_000_000 + b"\nG1 X14\n",
    "brackets": START + b"G1 X1 " + b"(" * 200_000,
    "a note of 1 MB": START + b"G1 X14 (" + b"x" * 1_000_000 + b") Y12\n",
    "10,000 states": START + b"".join(b"SAVE_GCODE_STATE NAME=s%d\n" % k for k in range(10_000)),
    "10,000 frames": START + b"".join(b"G92 E%d\n" % k for k in range(10_000)),
    "10,000 limits": START + b"".join(b"M204 P%d\n" % (k + 1) for k in range(10_000)),
    "300,000 empty lines": START + b"\n" * 300_000,
    "digits": START + b"G1 X14." + b"3" * 100_000 + b"\n",
    "words": START + b"M117" + b" A1" * 100_000 + b"\n",
    "a huge arc": START + b"G2 X12 Y10 I900000 J0\n",
    "fields": START + b"SET_VELOCITY_LIMIT" + b" A=1" * 50_000 + b"\n",
    "no field": START + b"SET_VELOCITY_LIMIT " + b"a" * 200_000 + b"\n",
    "spaces": START + b"G1" + b" " * 300_000 + b"X14\n",
    "dots": START + b"G1 X" + b"." * 100_000 + b"\n",
    "exponents": START + b"G1 X" + b"1E" * 50_000 + b"\n",
}


@pytest.mark.parametrize("name", HOSTILE)
def test_nothing_takes_for_ever(name: str) -> None:
    begin = time.process_time()
    outcome(lambda: [len(read_program(HOSTILE[name], "p").moves)])
    assert time.process_time() - begin < 4.0


# -- machine files --


def holds(
    read: Callable[[Path], object],
    data: bytes,
    documented: type[MachineFileError] | type[MeasurementError],
    folders: pytest.TempPathFactory,
    suffix: str,
) -> None:
    """A result, or a documented error whose every sentence begins with the file and ends as sentences do."""
    path = folders.getbasetemp() / f"input{suffix}"
    path.write_bytes(data)
    _, refused = tried(lambda: read(path), documented)
    if isinstance(refused, (MachineFileError, MeasurementError)):
        assert refused.problems and str(refused).startswith(str(path))
        assert all(problem.rstrip()[-1] in ".?)" for problem in refused.problems), refused.problems


# -- measurements --

TIMES = np.arange(120) / 1600
RUN = "# position_mm: 0, 0, 5\nt_s,cmd_A_mm,cmd_B_mm,cmd_C_mm,acc_A_m_per_s2,pos_A_mm\n" + "".join(
    f"{t:.6f},{100 + np.sin(99 * t):.4f},{100 - t:.4f},100.0,{np.sin(400 * t):.3f},{100 + t:.4f}\n" for t in TIMES
)
FRF = "# input: cmd_A\n# output: pos_A\n# position_mm: 0, 0, 5\nfrequency_hz,real,imag,coherence\n" + "".join(
    f"{k},{1 + k / 50:.3f},{-k / 90:.3f},0.99\n" for k in range(1, 30)
)
RAW = "#time,accel_x,accel_y,accel_z\n" + "".join(f"{t:.6f},{100 * t:.1f},3.0,9806.0\n" for t in TIMES)
SPECTRA = "freq,psd_x,psd_y,psd_z,psd_xyz\n" + "".join(f"{k}.0,1e3,2e3,{k}.5,4e3\n" for k in range(5, 60))
READERS: dict[str, tuple[Callable[[Path], object], str]] = {
    "run": (read_recording, RUN),
    "frf": (read_frfs, FRF),
    "capture": (read_vibrations, RAW),
    "spectra": (read_vibrations, SPECTRA),
}
ODD_CELLS = """nan inf -inf 1e400 1e308 -1e308 0 -5 x 1;2 \u0661 1_0 "1" # 1,2"""
CELLS = st.sampled_from([*ODD_CELLS.split(), "", " 7 "])


@pytest.mark.parametrize("name", READERS)
@quick
@given(data=st.data())
def test_measurements_with_other_cells(
    name: str, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    read, text = READERS[name]
    lines = text.splitlines()
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(lines) - 1))
        cells = lines[at].split(",")
        cells[data.draw(st.integers(0, len(cells) - 1))] = data.draw(CELLS)
        lines[at] = data.draw(st.sampled_from([",".join(cells)] * 5 + ["", lines[0], lines[-1], "\x00", lines[at][:3]]))
    holds(read, "\n".join(lines).encode(), MeasurementError, tmp_path_factory, ".csv")


@pytest.mark.parametrize("name", READERS)
@quick
@given(head=st.integers(0, 60), data=st.binary(max_size=80))
def test_measurements_of_any_bytes(name: str, tmp_path_factory: pytest.TempPathFactory, head: int, data: bytes) -> None:
    read, text = READERS[name]
    holds(read, text.encode()[:head] + data, MeasurementError, tmp_path_factory, ".csv")
