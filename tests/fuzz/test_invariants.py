"""The invariants of `validation/invariants.py` hold of real and odd prints, and every one of them can be broken."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

from ffcomp.compensation.job import Job
from ffcomp.errors import NothingToDo
from gcode.container import read_bytes
from gcode.errors import GcodeError
from tests.fuzz.test_random_programs import compensated, inverter
from tests.support import data
from tests.support.compensated import plainly
from validation.invariants import told_apart, violations

REAL, ODD = sorted(data.ROOT.glob("*.gcode")), sorted((data.ROOT / "odd").glob("*"))
OFFSETS = {  # beds with their origin in a corner; the vase's start moves need more room than its bed's centre leaves
    "ender3_ringing_tower.gcode": (-110.0, -110.0),
    "gcodepreview_benchy_arcs.gcode": (-100.0, -100.0),
    "gcodepreview_vase.gcode": (-70.0, -75.0),
    "makreeltje_orca_slicer.gcode": (-150.0, -150.0),
    "makreeltje_cura_slicer.gcode": (-150.0, -150.0),
}
ROOT = Path(__file__).parents[2]
SAMPLES = sorted((ROOT / "sample_prints").glob("*.gcode"))
LINES = 500

PRINT = (
    b"G28|G90|M82|M104 S200|G1 Z5 F6000|G1 X10 Y10 F9000|;LAYER:0|M106 S100|G1 X40 Y12 E1.5|M106 S200|G1 X38 Y40 E3|"
    b"G92 E0|T0|G1 X10 Y30 E1.5|M107|"
).replace(b"|", b"\n")


def beginning(path: Path) -> bytes:
    return b"".join(path.read_bytes().splitlines(keepends=True)[:LINES])


def job(data: bytes, path: Path) -> Job:
    own, offset = inverter(), OFFSETS.get(path.name, (0.0, 0.0))
    options = plainly(offset_mm=offset, predict=False)
    return Job(data, str(path), own.machine, options)


@pytest.mark.parametrize("path", [*SAMPLES[:1], *REAL[::2]], ids=lambda path: path.name)
def test_real_prints_are_safe(path: Path) -> None:
    data = beginning(path)
    work = job(data, path)
    out = b"".join(work.lines())
    assert len(told_apart(out.splitlines(keepends=True)).segments) > 20
    assert violations(data, out, work.machine, work.offset, work.flavor) == []


@pytest.mark.skipif(not ODD, reason=f"no G-code of others at {data.ROOT}; FFCOMP_DATA names its folder")
def test_odd_prints_are_safe_or_refused_with_a_place_and_a_rule() -> None:
    safe = 0
    for path in ODD:
        refused = None
        try:
            work = job(data := read_bytes(path), path)
            out = b"".join(work.lines())
        except (GcodeError, NothingToDo) as error:
            refused = error
        if refused is None:
            assert violations(data, out, work.machine, work.offset, work.flavor) == [], path.name
            safe += 1
        elif isinstance(refused, GcodeError):
            assert refused.path and refused.rule.endswith((".", "?", ")")), path.name
            assert refused.line is not None or path.stat().st_size == 0
        else:
            assert str(path) in str(refused)
    assert safe >= 5


# -- every invariant can be broken --


@cache
def safe() -> bytes:
    """A compensated print that has nothing wrong with it."""
    out = compensated(PRINT, inverter())
    assert violations(PRINT, out, inverter().machine) == []
    return out


def middle() -> int:
    """The line of a segment in the middle, which states X, Y and E."""
    lines = safe().splitlines()
    segments = [
        i for i in told_apart(safe().splitlines(keepends=True)).segments if b" E" in lines[i] and b" Y" in lines[i]
    ]
    return int(segments[len(segments) // 2])


def spoiled(change: Callable[[bytes], bytes]) -> bytes:
    """The print with one segment changed."""
    lines = safe().splitlines(keepends=True)
    lines[middle()] = change(lines[middle()].rstrip()) + b"\n"
    return b"".join(lines)


def word(line: bytes, letter: bytes, change: Callable[[float], float]) -> bytes:
    words = [w if w[:1] != letter else letter + b"%.4f" % change(float(w[1:])) for w in line.split()]
    return b" ".join(words)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda line: word(line, b"X", lambda x: x + 400), "outside"),
        (lambda line: word(line, b"X", lambda x: x + 10), "mm from the path; "),
        (lambda line: word(word(line, b"X", lambda x: x + 50), b"F", lambda f: 20 * f), "velocity"),
        (lambda line: word(line, b"E", lambda e: e + 0.5), "There and back"),
        (lambda line: line + b"\nG4 S9 ; ffcomp", "s and lasts 9"),
        (lambda line: line.replace(b"E", b"E" + b"0" * 90), "too long"),
        (lambda line: line.replace(b"G1 ", b"G1 Z1e1 "), "exponent"),
        (lambda line: line + b" S1", "no plain G1"),
        (lambda line: b"M107\n" + line, "not those of the original"),
        (lambda line: line + b"\nG28", "not those of the original"),
        (lambda line: line + b"\nM203 X1e5 ; ffcomp", "no plain decimal"),
        (lambda line: line + b"\n;~G1 X3", "byte for byte"),
    ],
)
def test_a_spoiled_segment_is_found(change: Callable[[bytes], bytes], sentence: str) -> None:
    try:
        found = violations(PRINT, spoiled(change), inverter().machine)
    except GcodeError as error:  # so bad that it cannot even be read
        found = [str(error)]
    assert any(sentence in each for each in found), found


def test_a_block_that_begins_beside_its_path_is_found() -> None:
    lines = safe().splitlines(keepends=True)
    at = next(i for i, line in enumerate(lines) if line.startswith(b";section line=14 "))
    lines.insert(at, b"G1 X38.05\n")
    assert any("the block begins 0.0500 mm" in each for each in violations(PRINT, b"".join(lines), inverter().machine))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("carriage_velocity_mm_per_s", 20.0),
        ("carriage_acceleration_mm_per_s2", 500.0),
        ("carriage_travel_mm", (0.0, 200.0)),
    ],
)
def test_a_limit_that_is_not_held_is_found(name: str, value: object) -> None:
    machine = inverter().machine
    tighter = replace(machine, limits=replace(machine.limits, **{name: value}))
    assert any("A carriage" in each for each in violations(PRINT, safe(), tighter))
