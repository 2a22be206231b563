"""How long a print takes: against closed forms, the whole plan, the real host; and the times in compensated files."""

from __future__ import annotations

import json
import math
import re
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ffcomp.cli.app import app
from ffcomp.compensation.statistics import Statistics as Compensation
from ffcomp.estimation import statistics as cutting
from ffcomp.estimation.engine import Estimate, estimate, planned_slices
from ffcomp.estimation.statistics import Statistics
from ffcomp.firmware.program import plan_program
from ffcomp.planner.lookahead import stops_and_waits
from ffcomp.planner.trajectory import Trajectory
from gcode.program import Program
from gcode.reader import read_parts, read_program
from tests.support.cli import CliRunner, Result
from tests.support.compensated import compensated as anywhere
from tests.support.machines import machine
from validation.judge import HOST_KNOWS
from validation.kalico import kalico_plan

ROOT = Path(__file__).parents[2]
PRINTS = ROOT / "sample_prints"


def estimated(data: bytes) -> Estimate:
    return estimate(data, "print.gcode", machine())


def ramp_s(length: float, speed: float, acceleration: float) -> float:
    """A move from rest to rest that reaches its speed, and cruises at least half its way."""
    return length / speed + speed / acceleration


START = b"G28\nM109 S200\nG90\nM83\nG1 X0 Y0 Z0.2 F6000\nSET_VELOCITY_LIMIT ACCEL=2000 MINIMUM_CRUISE_RATIO=0\n"
SIMPLE = START + (
    b";LAYER_CHANGE\n;TYPE:Skirt\nG1 X40 E2 F3000\nG1 E-1 F1200\nG4 P1500\n;TYPE:Infill\nG1 X0 F6000\nG1 E1 F1200\n"
    b";LAYER_CHANGE\nG1 Z0.4 F600\nM400\nG1 Y40 E3 F3000\nSTART_FAN_DANCE\nM109 S210\n"
)


def test_every_kind_of_time_in_closed_form() -> None:
    statistics = estimated(SIMPLE).statistics
    filament_acceleration = machine().limits.acceleration_mm_per_s2 * 16 * 0.4**2 / (math.pi * 1.75**2)
    total = statistics.total
    assert total.extruding_s == pytest.approx(2 * ramp_s(40, 50, 2000))
    assert total.travelling_s == pytest.approx(ramp_s(40, 100, 2000) + ramp_s(0.2, 10, 2000))
    assert total.retracting_s == total.priming_s == pytest.approx(ramp_s(1, 20, filament_acceleration))
    assert total.waiting_s == 1.5
    assert statistics.filament_mm == pytest.approx(5.0)  # the millimetre that was pulled back came again
    assert statistics.retractions == 1


def spiral(k: int) -> tuple[float, float]:
    return 20 * math.cos(k / 10), 20 * math.sin(k / 10)


def planned(program: Program) -> Trajectory:
    return plan_program(program, machine()).trajectory


def account_of(data: bytes, part_bytes: int = 1 << 20) -> Statistics:
    statistics = Statistics()
    for span in planned_slices(read_parts([data], flavor="klipper", part_bytes=part_bytes), planned):
        statistics.add(span)
    return statistics


def test_parts_add_up_to_the_whole_plan() -> None:
    """To the rounding of sums, however the file is cut; lines before the first move and after the last one too."""
    data = (PRINTS / "ringing_tower.gcode").read_bytes()[:120_000].rpartition(b"\n")[0] + b"\n"
    program = read_program(data, flavor="klipper")
    whole = plan_program(program, machine()).firmware_s
    assert stops_and_waits(program)[1].sum() == 0.0
    for part_bytes in (300, 5_000, 1 << 20):
        statistics = account_of(data, part_bytes)
        assert statistics.total.time_s == pytest.approx(whole, rel=1e-12)
        assert statistics.moves == len(program.moves)
        numbers = [layer.number for layer in statistics.layers_in_order]
        assert len(numbers) > 5 and numbers == list(range(len(numbers)))


def test_a_spiral_without_rests_is_cut_in_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    places = (b"G1 X%.3f Y%.3f E.05 F6000\n" % spiral(k) for k in range(6000))
    data = START + b"".join(places)
    whole = account_of(data).total.time_s
    monkeypatch.setattr(cutting, "MOST_MOVES", 500)
    held = [
        len(span.program.moves)
        for span in planned_slices(read_parts([data], flavor="klipper", part_bytes=9_000), planned)
    ]
    assert len(held) > 5 and max(held) < 2000
    statistics = account_of(data, 9_000)
    assert statistics.moves == 6001 - 1  # the first one begins nowhere
    assert statistics.total.time_s == pytest.approx(whole, abs=1e-9)


@pytest.mark.slow
@pytest.mark.kalico
def test_the_real_host_takes_as_long() -> None:
    lines = (PRINTS / "ringing_tower.gcode").read_bytes().splitlines(keepends=True)[:1500]
    text = b"".join(line for line in lines if HOST_KNOWS.match(line))
    limits, geometry = machine().limits, machine().kinematics
    host = kalico_plan(
        text,
        max_velocity=limits.velocity_mm_per_s,
        max_accel=limits.acceleration_mm_per_s2,
        scv=limits.square_corner_velocity_mm_per_s,
        delta_radius=float(geometry.delta_radii_mm.max()),
        arm_length=float(geometry.arm_lengths_mm.min()),
    )
    statistics = Statistics()
    for span in planned_slices(read_parts([text], flavor="klipper", start=(0.0, 0.0, 10.0)), planned):
        statistics.add(span)
    assert statistics.total.time_s == pytest.approx(host["print_s"], abs=1e-6)


# -- the times in a compensated file --


def timed_print(layers: int = 3) -> bytes:
    """All forms at once, with more lines of progress than any slicer writes."""
    head = b";TIME:100\r\nM73 P0 R9\r\n; estimated first layer printing time (normal mode) = 9s\r\n"
    body = []
    for k in range(layers):
        ring = [b"G1 X%.3f Y%.3f E.5 F4800\r\nM73 P1 R1 C7\r\n" % spiral(5 * i) for i in range(13)]
        body += [b";LAYER:%d\r\nG1 Z%.1f F600\r\n" % (k, 0.2 + 0.2 * k), *ring, b"G1 E-2 F1800\r\nG4 P250\r\nG1 E2\r\n"]
        body += [b";TIME_ELAPSED:%d\r\n" % k]
    tail = b"G1 Z30 F600\r\nM73 P100 R0\r\n; estimated printing time (normal mode) = 1m 40s\r\n"
    tail += b";   Build time: 0 hours 1 minutes"
    return head + START.replace(b"\n", b"\r\n") + b"".join(body) + tail


def compensated(data: bytes, **options: Any) -> tuple[bytes, Compensation]:
    text, result = anywhere(data, machine(), predict=False, **options)
    return text, result.statistics


@cache
def timed() -> tuple[bytes, float]:
    text, found = compensated(timed_print())
    return text, found.print_time_s


def numbers(line: bytes) -> list[int]:
    return [int(word) for word in re.findall(rb"(?<=[PRC])\d+", line)]


def test_progress_is_what_the_plan_of_the_file_has_left() -> None:
    """Read again and planned as the firmware does; a run's rounding may be some ms."""
    text, total_s = timed()
    program = read_program(text, flavor="klipper")
    plan = plan_program(program, machine()).trajectory
    assert total_s == pytest.approx(plan.end_t, abs=0.05)
    ends = np.append(0.0, plan.start_t + plan.duration)
    told = [(program.lines[e.line], ends[e.move]) for e in program.events]
    lines = [(numbers(line), at_s) for line, at_s in told if line.startswith(b"M73")]
    assert len(lines) == 2 + 3 * 13
    for (percent, minutes, *change), at_s in lines:
        assert 100 * (at_s - 0.3) / total_s - 1 <= percent <= 100 * (at_s + 0.3) / total_s
        assert abs(minutes - (total_s - at_s) / 60) <= 0.51
        assert change in ([], [7])
    assert lines[0][0][0] == 0 and lines[-1][0][:2] == [100, 0]
    assert [p for (p, *_), _ in lines] == sorted(p for (p, *_), _ in lines)
    elapsed = [(float(line[14:]), at_s) for line, at_s in told if line.startswith(b";TIME_ELAPSED:")]
    assert [at_s for _, at_s in elapsed] == pytest.approx([t for t, _ in elapsed], abs=0.3)
    assert len(elapsed) == 3 and elapsed[-1][0] < total_s


# -- the command --


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(app, ["estimate", *map(str, arguments)])


def test_marlin_plans_a_file_whose_speeds_and_filament_change(tmp_path: Path) -> None:
    path = tmp_path / "print.gcode"
    path.write_text("G28\nG92 E0\nG1 X0 Y0 Z1 F3000\nG1 X10 E0.5 F1200\nG92 E0\nG1 Y10 E0.5 F1800\nG1 X0 F6000\n")
    answer = CliRunner().invoke(app, ["estimate", str(path), "-m", "voron-300", "--flavor", "marlin", "--json"])
    assert answer.exit_code == 0, answer.output
    assert json.loads(answer.stdout)["time_s"] == pytest.approx(10 / 20 + 10 / 30 + 10 / 100, rel=0.05)
