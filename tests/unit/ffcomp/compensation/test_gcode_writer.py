"""What is written, for programs of every kind: nothing lost, nothing moved, limits opened and closed around it."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ffcomp.firmware.program import plan_program
from ffcomp.planner.limits import planner_limits
from ffcomp.planner.lookahead import plan_moves, stops_and_waits
from gcode.embedded import OURS, TIME_WAS, WAS, original
from gcode.metadata import tells
from gcode.program import Program
from gcode.reader import read_program
from gcode.words import Command, commands
from models.machine import RepRapFirmwareSettings
from tests.support.compensated import compensated as anywhere
from tests.support.machines import machine

MOVE = re.compile(rb"\s*(?:N\d+\s*)?G0*[0-3](?!\d)", re.IGNORECASE)


def compensated(data: bytes, **options: Any) -> bytes:
    return anywhere(data, machine(), predict=False, **{"flavor": "klipper", **options})[0]


def others(data: bytes) -> list[bytes]:
    """The lines that are neither moves nor ours nor tell a time, in order."""
    lines = data.splitlines(keepends=True)
    ours = (b"; Processed by ffcomp", b"; ffcomp offset_mm=", WAS, TIME_WAS)
    same = [a for a in lines if not MOVE.match(a) and not a.startswith(ours) and not a.rstrip().endswith(OURS)]
    return [a for a in same if tells(a) is None]


def ends(program: Program) -> np.ndarray:
    return program.moves.end[-1]


START = b"G28\nG90\nM83\nG1 Z0.3 F6000\nG1 X10 Y10 F9000\n"

lines = st.lists(
    st.one_of(
        st.tuples(st.integers(-40, 40), st.integers(-40, 40)).map(lambda p: b"G1 X%d Y%d F6000\n" % p),
        st.tuples(st.integers(-40, 40), st.integers(-40, 40), st.integers(1, 900)).map(
            lambda p: b"G1 X%d Y%d E.%03d F4800\n" % p
        ),
        st.integers(1, 30).map(lambda z: b"G1 Z%d.25\n" % z),
        st.sampled_from(
            [
                b"G1 E-2 F2400\n",
                b"G1 E2 F2400\n",
                b"; a comment\n",
                b";LAYER:3\n",
                b"M106 S128\n",
                b"G4 P50\n",
                b"M204 S3000\n",
                b"SET_VELOCITY_LIMIT ACCEL=4000\n",
                b"M220 S80\n",
                b"M221 S95\n",
                b"G92 E0\n",
                b"M82\nG92 E0\n",
                b"M83\n",
                b"G91\nG1 X3 Y-2 E.1\nG90\n",
                b"M400\n",
                b"M117 50 %\n",
                b"G2 X12 Y8 I3 J3 E.3\n",
                b"G1 F5000\n",
                b"\n",
            ]
        ),
    ),
    min_size=1,
    max_size=25,
)


@pytest.mark.slow
@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(body=lines, crlf=st.booleans())
def test_any_program_keeps_its_lines_its_filament_and_its_places(body: list[bytes], crlf: bool) -> None:
    data = START + b"G1 X20 Y10\n" + b"".join(line for line in body if b"G2 " not in line)
    data = data.replace(b"\n", b"\r\n") if crlf else data
    out = compensated(data)
    assert original(out) == data
    assert others(out) == others(data)
    before, after = read_program(data), read_program(out)
    np.testing.assert_allclose(ends(after)[:3], ends(before)[:3], atol=1e-4)
    total = [float(np.sum(p.moves.end[:, 3] - p.moves.start[:, 3])) for p in (before, after)]
    assert total[0] == pytest.approx(total[1], abs=1e-4)
    assert np.isfinite(after.moves.end).all() and (after.moves.speed > 0).all()


def test_the_file_lasts_as_long_as_it_should() -> None:
    """Planned as a firmware plans it, every segment takes its time: the sum is what the statistics say."""
    data = START + b"".join(b"G1 X%d Y%d E.4 F9000\n" % (20 * np.cos(k) + k / 3, 20 * np.sin(k)) for k in range(40))
    text, result = anywhere(data, machine(), predict=False)
    program = read_program(text)
    stop_before, wait_before = stops_and_waits(program)
    plan = plan_moves(program.moves, planner_limits(machine()), stop_before=stop_before, wait_before=wait_before)
    lead_and_tail = 0.012  # rests at a run's ends are not written
    runs = len(plan_program(read_program(data), machine()).sections)
    assert plan.end_t == pytest.approx(result.statistics.print_time_s, abs=lead_and_tail * runs)


def test_a_stop_comes_to_rest_on_the_path_and_the_limits_are_back() -> None:
    data = START + b"M204 S2500\nG1 X30 Y20 F9000\nG28\nG1 Z5 F600\nG1 X0 Y0 F6000\nG1 X5 Y5\n"
    out = compensated(data + b"SET_VELOCITY_LIMIT ACCEL=2500\n")
    text = out.splitlines()
    at = text.index(b"G28", 3)
    reach = read_program(out).moves.end
    assert reach[:, :2].min() > -1e-3 and reach[:, 2].max() < 5 + 1e-3  # it does not run ahead to where homing will be
    assert text[at - 1].startswith(b"G1 F9000") and text[at - 1].endswith(OURS)
    assert b"ACCEL=2500" in text[at - 2] and text[at - 2].endswith(OURS)
    last = [line for line in text[:at] if line.startswith(b"G1 ") and not line.endswith(OURS)][-1]
    moves = read_program(out).moves
    assert last
    assert np.abs(moves.end[moves.line < at, :3][-1] - [30, 20, 0.3]).max() < 1e-4
    assert text[at + 1] == b"G1 Z5 F600"  # nobody knows where homing leaves the nozzle: the firmware plans this


def test_marlins_own_caps_come_back_as_the_file_set_them() -> None:
    limits = b"M201 X500 Y600\nM203 X200 Y200\nM204 P800 T900\nM205 X8 Y8\nM201 X700 Y600\n"
    out = compensated(START + limits + b"G1 X30 Y20 F9000\nG28\n", flavor="marlin").splitlines()
    at = out.index(b"G28", 3)
    closing = [line.removesuffix(OURS) for line in out[at - 9 : at - 1]]
    opened = max(i for i, line in enumerate(out[:at]) if line.startswith(b"M204 P100000"))
    assert b"M204 P10000 T10000" in closing and opened < at - 9  # the machine's own first,
    assert closing[-4:] == [b"M203 X200 Y200", b"M204 P800 T900", b"M205 X8 Y8", b"M201 X700 Y600"]  # then the file's


def marlin_extruder_steps(text: bytes, steps_per_mm: float = 415.0) -> tuple[int, float]:
    """Steps of the extruder, each block's times M221 and rounded as Marlin does, and where E counts to at the end."""
    steps, factor, at, place, absolute = 0, 1.0, 0, 0.0, True
    for line in text.splitlines():
        (command,) = commands(line, 1)[:1] or [Command("", b"", 1)]
        words = command.settings()
        if command.name in ("M82", "M83", "G90", "G91"):
            absolute = command.name in ("M82", "G90")
        elif command.name == "M221":
            factor = words["S"] / 100
        elif command.name == "G92" and "E" in words:
            place, at = words["E"], round(words["E"] * steps_per_mm)
        elif command.name == "G1" and "E" in words:
            place = words["E"] if absolute else place + words["E"]
            block = round(place * steps_per_mm) - at
            at += block
            steps += int(np.sign(block)) * int(abs(block) * factor + 0.5)
    return steps, place


@pytest.mark.parametrize("percent", [90, 95, 105])
@pytest.mark.parametrize("mode", ["M83", "M82"])
def test_marlin_feeds_as_much_filament_as_the_print_at_any_flow(percent: int, mode: str) -> None:
    """150 mm of lines, with G92 and M221 on the way; then lines that Marlin plans itself, in the file's own numbers."""
    start, sides = b"G28\nG90\n%b\nG1 Z0.3 F6000\nG1 X10 Y10 F9000\n" % mode.encode(), [(40, 10), (40, 30), (10, 30)]
    count, body = 0.0, b"M221 S%d\n" % percent
    for k, (x, y) in enumerate([*sides, (10, 10), *sides]):
        count = 1.2 if mode == "M83" else count + 1.2
        if k in (2, 4):
            count, body = 1.2, body + (b"G92 E0\n" if k == 2 else b"G92 E%.5f\nM221 S%d\n" % (0.0, percent))
        body += b"G1 X%d Y%d E%.5f F4800\n" % (x, y, count)
    after = b"M400\nG28\nG1 Z5 F600\nG1 E%.5f\n" % (2.0 if mode == "M83" else count + 2.0)
    data = start + body + after
    out = compensated(data, flavor="marlin")
    steps, place = marlin_extruder_steps(out)
    assert steps == pytest.approx((7 * 1.2 + 2.0) * percent / 100 * 415, abs=2)
    if mode == "M82":
        assert place == count + 2.0
    assert original(out) == data


def test_reprapfirmwares_limits_come_back_axis_by_axis() -> None:
    with_axes = RepRapFirmwareSettings((300, 200, 10, 60), (3000, 2000, 100, 5000), (10, 8, 0.2, 5), 1500, 2500, 1)
    data = START + b"M566 X300\nG1 X30 Y20 F9000\nG28\n"
    own = replace(machine(), reprapfirmware=with_axes)
    lines = anywhere(data, own, predict=False, flavor="reprapfirmware")[0].splitlines()
    at = lines.index(b"G28", 3)
    assert [line.removesuffix(OURS) for line in lines[at - 6 : at - 1]] == [
        b"M201 X3000 Y2000 Z100", b"M203 X18000 Y12000 Z600", b"M204 P1500 T2500", b"M566 X600 Y480 Z12", b"M566 X300",
    ]  # fmt: skip


def test_a_wipe_costs_no_time() -> None:
    """Filament pulled back while moving: firmwares hold its acceleration down, so it must flow evenly."""
    wipe = b"G1 X%d Y20 E1 F9000\nG1 X%d Y16 E-.8\nG1 E-1 F2400\nG1 X%d Y18 F9000\nG1 E1.8 F2400\n"
    data = START + b"".join(wipe % (k, k, k + 1) for k in range(10, 20))
    text, result = anywhere(data, machine(), predict=False, flavor="klipper")
    program = read_program(text, flavor="klipper")
    stop_before, wait_before = stops_and_waits(program)
    plan = plan_moves(program.moves, planner_limits(machine()), stop_before=stop_before, wait_before=wait_before)
    assert plan.end_t == pytest.approx(result.statistics.print_time_s, rel=0.015)  # 9 % when it follows the clock
    falls = program.moves.end[:, 3] < program.moves.start[:, 3]
    moving = np.abs(program.moves.end[:, :3] - program.moves.start[:, :3]).max(axis=1) > 0
    pulled = (program.moves.end[:, 3] - program.moves.start[:, 3])[falls & moving]
    assert float(pulled.sum()) == pytest.approx(-8.0, abs=0.05)
