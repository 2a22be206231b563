"""A long print in chunks: what comes out is what comes out in one piece, however many work at it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from ffcomp.compensation.chunks import LONGEST_S, Chunk, Splitting, split_chunks
from ffcomp.compensation.result import CompensatedFile
from ffcomp.firmware import program as reading
from ffcomp.firmware.program import firmware_plan, known_to_the_firmware, plan_program
from ffcomp.metrics import contour_error
from ffcomp.simulation.command import path_corners, section_starts
from gcode.dialect import KLIPPER, MARLIN
from gcode.embedded import original
from gcode.program import Program
from gcode.reader import read_parts, read_program
from models.file import load_machine
from models.machine import Machine
from tests.support.compensated import compensated
from tests.support.marlin_played import played, score
from validation.invariants import violations

PRINTS = Path(__file__).parents[2] / "sample_prints"
SMALL = 20_000  # bytes of a part


@pytest.fixture
def small_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Many chunks of a small file."""

    def parts(blocks: Iterator[bytes], path: str, **options: object) -> Iterator[Program]:
        return read_parts(blocks, path, part_bytes=SMALL, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(reading, "read_parts", parts)


def cut(data: bytes, machine: Machine, part_bytes: int = SMALL, longest_s: float = np.inf) -> list[Chunk]:
    parts = read_parts([data], flavor="klipper", part_bytes=part_bytes)
    return list(split_chunks(parts, Splitting(0.004, 0.008, partial(firmware_plan, machine=machine), longest_s)))


@pytest.fixture(scope="module")
def tower() -> bytes:
    return (PRINTS / "ringing_tower.gcode").read_bytes()[:45_000].rpartition(b"\n")[0] + b"\n"


def test_jobs_change_no_byte(tower: bytes, machine: Machine, small_parts: None) -> None:
    alone, one = compensated(tower, machine)
    together, two = compensated(tower, machine, jobs=2)
    assert alone == together
    timeless = (replace(each, compute_time_s=0.0) for each in (one, two))
    first, second = (CompensatedFile(each.path, None, {"": each}).to_dict() for each in timeless)
    assert first == second and first["predicted"]["compensated"]["contour_rms_um"] > 0


@pytest.fixture(scope="module")
def spiral() -> bytes:
    """A vase of 1,500 facets in one go, with lines between them, and rests before and after."""
    lines = [b"G28\nG90\nM83\nG1 X25 Y0 Z0.3 F6000\nG1 E1 F1800\n;TYPE:Perimeter\n"]
    for k in range(1_500):
        a, r = 0.036 * k, 25 + 2 * np.sin(0.252 * k)
        lines.append(b"G1 X%.3f Y%.3f Z%.4f E.03 F4800\n" % (r * np.cos(a), r * np.sin(a), 0.3 + 0.002 * k))
        lines += [b"M106 S%d\n" % (k % 255), b";LAYER_CHANGE\n"] if k % 250 == 249 else []
    return b"".join([*lines, b"G1 E-1 F1800\nG1 X0 Y0 F9000\nM84\n"])


@pytest.fixture
def short_spirals(monkeypatch: pytest.MonkeyPatch, small_parts: None) -> None:
    monkeypatch.setattr("ffcomp.compensation.chunks.MOST_MOVES", 500)


def test_a_spiral_is_cut_in_motion_without_a_trace(spiral: bytes, machine: Machine, short_spirals: None) -> None:
    several, cut_result = compensated(spiral, machine, flavor=KLIPPER)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("ffcomp.compensation.chunks.MOST_MOVES", 10**9)
        whole, result = compensated(spiral, machine, flavor=KLIPPER)
    assert cut_result.statistics.windows > result.statistics.windows  # there were cuts
    assert original(several) == original(whole) == spiral
    assert several.count(b"SET_VELOCITY_LIMIT") <= whole.count(b"SET_VELOCITY_LIMIT") + 4  # none of them in the spiral
    for name in ("original_print_time_s", "moves"):
        assert getattr(cut_result.statistics, name) == pytest.approx(getattr(result.statistics, name), abs=1e-6)
    # segments that the firmware executes late differ a little after a cut
    assert cut_result.statistics.print_time_s == pytest.approx(result.statistics.print_time_s, abs=1e-4)
    # joined segments end elsewhere after a cut: both commands, where they pass the same time
    mine, theirs = (plan_program(read_program(text, flavor=KLIPPER), machine).trajectory for text in (several, whole))
    assert mine.end_t == pytest.approx(theirs.end_t, abs=0.02)
    ends = [np.diff(read_program(text, flavor=KLIPPER).moves.end[:, 3]).sum() for text in (several, whole)]
    assert ends[0] == pytest.approx(ends[1], abs=1e-3)
    both = plan_program(read_program(several), machine), plan_program(read_program(whole), machine)
    path_t, path = path_corners(both[1].trajectory)
    t = np.linspace(1.0, both[0].trajectory.end_t - 1.0, 20_000)
    off = contour_error(path_t, path, t, both[0].trajectory.position(t)[:, :3])
    assert off.max() < 1.5e-3  # mm: segments are joined where they stay this near to what was solved


def test_marlins_steps_behind_a_cut_leave_the_same_error(machine: Machine, small_parts: None) -> None:
    """Beside a cut, windows at the limits lie elsewhere: 0.1 µm of the command, and from there on other whole steps.

    Ends of segments are then tens of µm apart until the choice begins anew, and what an independent printer leaves is
    the same.
    """
    data, scores = vase(1200, 4800.0), []
    planned = plan_program(read_program(data, flavor=MARLIN, **known_to_the_firmware(machine)), machine)
    for most in (400, 10**9):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("ffcomp.compensation.chunks.MOST_MOVES", most)
            text, result = compensated(data, machine, flavor=MARLIN, predict=False)
        assert original(text) == data and violations(data, text, machine, flavor=MARLIN) == []
        program = read_program(text, flavor=MARLIN, **known_to_the_firmware(machine))
        plan, motors = played(program, machine)
        clock = section_starts(program, planned).clock(plan.start_t)
        left = score(motors, "mp-delta-pro", clock, path_corners(planned.trajectory))
        scores.append((result.statistics.windows, result.statistics.print_time_s, program.moves.end[-1], left))
    (windows, print_time_s, end, cut), (fewer, whole_s, whole_end, whole) = scores
    assert windows > fewer  # there were cuts
    assert print_time_s == pytest.approx(whole_s, abs=1e-4)
    assert end == pytest.approx(whole_end, abs=1e-4)
    assert cut.seconds == pytest.approx(whole.seconds, abs=1e-3)
    assert cut.rms_um == pytest.approx(whole.rms_um, rel=0.03)
    assert cut.p99_um == pytest.approx(whole.p99_um, rel=0.05)


VASE = b"G28\nG90\nM83\nG1 X25 Y0 Z0.3 F6000\nG1 E1 F1800\n"


def vase(facets: int, speed: float, lift: float = 0.002) -> bytes:
    """Facets of 0.9 mm, F in mm/min; comments between them tell the layers."""
    lines = [VASE]
    for k in range(facets):
        lines += [b";LAYER_CHANGE\n"] if k % 175 == 0 else []
        a, r = 0.036 * k, 25 + 2 * np.sin(0.252 * k)
        place = r * np.cos(a), r * np.sin(a), 0.3 + lift * k
        lines.append(b"G1 X%.3f Y%.3f Z%.4f E.03 F%.3f\n" % (*place, speed))
    return b"".join([*lines, b"G1 E-1 F1800\nG1 X0 Y0 F9000\nM84\n"])


@pytest.mark.parametrize(
    "data",
    [
        vase(2000, 10.0),  # three hours
        VASE + b"G1 X-25 Y10 E20 F0.4249\nG1 X0 Y0 F3000\nG1 E-1 F1800\n",  # two hours in one line
        VASE + b"".join(b"G1 X%d F60\nG1 E.1 F60\n" % (20 * (k % 2)) for k in range(400)),  # rests every 20 s
    ],
)
def test_no_chunk_holds_more_than_some_minutes(machine: Machine, data: bytes) -> None:
    several = cut(data, machine, 10**6, longest_s=LONGEST_S)
    plans = [firmware_plan(each.program, machine) for each in several]
    assert max(plan.end_t for plan in plans) < LONGEST_S + 15.0  # what is around the cuts, whole moves of it
    assert max(map(len, plans)) < 1000
    assert max(len(each.program.frames) for each in several) < 10
    written_s = [
        (plan.end_t if each.extent.end is None else each.extent.end.time_in(plan))
        - (0.0 if each.extent.begin is None else each.extent.begin.time_in(plan))
        for each, plan in zip(several, plans, strict=True)
    ]
    assert sum(written_s) == pytest.approx(firmware_plan(read_program(data, flavor=KLIPPER), machine).end_t, abs=1e-6)


def test_limits_are_held_in_a_motion_that_is_cut(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    """On both sides of a cut, and at the cut: velocities, and accelerations from segment to segment."""
    monkeypatch.setattr("ffcomp.compensation.chunks.LONGEST_S", 8.0)
    tight = replace(machine, limits=replace(machine.limits, carriage_velocity_mm_per_s=45.0))
    data = vase(1150, 4800.0)
    text, result = compensated(data, tight, flavor=KLIPPER, predict=False)
    assert original(text) == data and violations(data, text, tight, flavor=KLIPPER) == []
    done, planned = result.statistics, plan_program(read_program(data, flavor=KLIPPER), machine)
    assert done.warnings == ()  # nowhere is more than a limit asked for
    assert done.original_print_time_s == pytest.approx(planned.firmware_s, abs=2e-3)
    assert 0.1 < done.print_time_s - done.original_print_time_s < 0.45
    assert {record.layer for record in done.slowed} == set(range(7))


def test_marlins_count_of_filament_goes_on_behind_a_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    """M221 is in our numbers while a block is open, so that the file's own absolute E is named again at each cut."""
    monkeypatch.setattr("ffcomp.compensation.chunks.LONGEST_S", 8.0)
    sides = ((60 + 40 * np.cos(k / 9), 60 + 40 * np.sin(k / 9), 0.3 * (k + 1)) for k in range(240))
    moves = b"".join(b"G1 X%.3f Y%.3f E%.4f F3000\n" % side for side in sides)
    data = b"G28\nM82\nG92 E0\nM221 S90\nG1 X100 Y60 Z.2 F6000\n" + moves
    text, _ = compensated(data, load_machine("ender-3"), flavor="marlin", predict=False)
    made = read_program(text, flavor="marlin").moves
    assert text.count(b"G92 E") >= 4 and text.count(b"M221 S100") == text.count(b"M221 S90 ; ffcomp")
    assert made.end[-1, 3] == pytest.approx(0.9 * 72.0, abs=1e-4)
    assert np.diff(made.end[:, 3]).max() < 0.3 and np.diff(made.end[:, 3]).min() > -1e-4
