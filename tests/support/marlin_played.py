"""What compensation leaves where Marlin plays it: blocks of whole motor steps through independent plants.

The written file is planned by Marlin's own rules (`ffcomp.firmware.marlin_planner`, which other tests compare with the
real planner's blocks), the motors follow the blocks from whole step to whole step, and a plant that shares no equation
with ffcomp moves the nozzle. Contour error is the distance to the path that Marlin plans for the sliced file.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ffcomp.compensation.job import Job
from ffcomp.compensation.request import CompensateOptions
from ffcomp.firmware.marlin import Marlin
from ffcomp.firmware.marlin_planner import settings_row
from ffcomp.firmware.marlin_queue import STEPS, Blocks, phases_of
from ffcomp.firmware.program import known_to_the_firmware, plan_program
from ffcomp.metrics import Track, contour_error
from ffcomp.planner.lookahead import stops_and_waits
from ffcomp.planner.trajectory import Trajectory
from ffcomp.simulation.command import SectionClock, path_corners, reference_clock, section_starts
from gcode.program import Program
from gcode.reader import read_program
from models.arrays import FloatArray
from models.file import find_machine, load_machine
from models.kinematics.delta import DeltaKinematics
from models.machine import Machine
from validation.plants import delta_plant, straight_plant

SAMPLES = Path(__file__).parents[2] / "sample_prints"
ARC = (f"G1 X{30 * np.cos(k / 60):.3f} Y{30 * np.sin(k / 60):.3f} E.02" for k in range(1, 200))
CIRCLE = "\n".join(["G90", "M83", "G28", "G1 X30 Y0 Z.3 F6000", "G1 F480", *islice(ARC, 100), "M204 P1500", *ARC])
CASES = {  # file or lines, machine, mm by which it is moved
    "tower": ("ringing_tower", "prusa-mk3s", (125.0, 105.0)),
    "star": ("far_star", "mp-delta-pro", (0.0, 0.0)),
    "circle": (CIRCLE, "mp-delta-pro", (0.0, 0.0)),
}
JUDGED_HZ, SETTLE_S = 1600, 0.5  # samples a second that count, and what is left out at first
DELTA_STEP_S, CHUNK_SAMPLES = 1 / 12800, 4000
AXIS_HZ, AXIS_KG = 12800, 0.4


class Score(NamedTuple):
    """What one motion leaves: s, and µm of contour error."""

    seconds: float
    rms_um: float
    p99_um: float
    max_um: float


def read(data: bytes, machine: Machine, offset: tuple[float, float] = (0.0, 0.0)) -> Program:
    return read_program(data, flavor="marlin", offset_mm=offset, **known_to_the_firmware(machine))


def beginning(data: bytes, machine: Machine, offset: tuple[float, float], seconds: float) -> bytes:
    """Return the file's lines until its plan has taken so long."""
    program = read(data, machine, offset)
    last = int(np.searchsorted(plan_program(program, machine).trajectory.start_t, seconds))
    return b"".join(program.lines[: int(program.moves.line[last])] if last < len(program.moves) else program.lines)


def played(program: Program, machine: Machine) -> tuple[Trajectory, Trajectory]:
    """Return Marlin's plan of a program: of its moves, and of its motors, mm."""
    stops, waits = stops_and_waits(program)
    planner = Marlin().planner(program, machine)
    blocks, ends = planner.blocks(program.moves, stops | (waits > 0.0))
    rested = np.cumsum(waits)[ends[blocks.target]]
    plan = planner(program.moves, stop_before=stops, wait_before=waits)
    return plan, motors(blocks, settings_row(machine)[STEPS], rested)


def motors(blocks: Blocks, steps_per_mm: FloatArray, rested: FloatArray) -> Trajectory:
    """Return blocks as a trajectory of the motors, mm; rested : (m,) s before each block in all."""
    p = phases_of(blocks)
    change = (blocks.end - blocks.start) / steps_per_mm
    mm = np.linalg.norm(change, axis=1)
    per_event = mm / blocks.events
    begin_t = rested + np.cumsum(p.duration) - p.duration
    speeds = (per_event * p.entry, per_event * p.level, per_event * p.last, per_event * blocks.acceleration)
    times = (begin_t, p.accel_t, p.cruise_t, p.decel_t)
    return Trajectory(*times, *speeds, blocks.start / steps_per_mm, change / mm[:, None])


def nozzle(motion: Trajectory, name: str) -> FloatArray:
    """Return where the plant of a machine of the library takes the nozzle, (n, 3) mm, from the first sample on."""
    machine, count = load_machine(name), int(motion.end_t * JUDGED_HZ)
    if not isinstance(machine.kinematics, DeltaKinematics):
        command = motion.position(np.arange(count * AXIS_HZ // JUDGED_HZ) / AXIS_HZ)[:, :3]
        command[:, :2] = (
            straight_plant.simulate(straight(machine), command[:, :2] - command[0, :2], AXIS_HZ)["position_mm"]
            + command[0, :2]
        )
        return command[:: AXIS_HZ // JUDGED_HZ]
    plant, state, every = delta_plant.load_machine(find_machine(name)), None, round(1 / DELTA_STEP_S / JUDGED_HZ)
    parts = []
    for first in range(0, count, CHUNK_SAMPLES):
        steps = min(CHUNK_SAMPLES, count - first) * every
        t = first / JUDGED_HZ + np.arange(2 * steps + 1) * (DELTA_STEP_S / 2)
        carriages = motion.position(t)[:, :3] + machine.kinematics.effector_height_mm
        answer = delta_plant.simulate(plant, carriages, DELTA_STEP_S, keep_every=every, start=state)
        state = answer["state"]
        parts.append(answer["nozzle_mm"][: steps // every])
    return np.concatenate(parts)


def straight(machine: Machine) -> straight_plant.Plant:
    """Return masses on belts that swing as a machine with one mode along x and one along y."""
    modes = machine.vibration.modes_at(np.zeros(2))
    order = np.argmax(np.abs(modes.nozzle[:, :2]), axis=0)
    omega, zeta = 2 * np.pi * modes.frequencies_hz[order], modes.damping_ratios[order]
    (kx, ky), (cx, cy) = (AXIS_KG * omega**2).tolist(), (2 * zeta * AXIS_KG * omega).tolist()
    return straight_plant.Plant(carriage_kg=(AXIS_KG, AXIS_KG), belt_n_per_m=(kx, ky), guide_n_s_per_m=(cx, cy))


def score(motion: Trajectory, name: str, clock: SectionClock, path: tuple[FloatArray, FloatArray]) -> Score:
    places = nozzle(motion, name)
    t = np.arange(len(places)) / JUDGED_HZ
    counted = t >= clock.executed_t[0] + SETTLE_S
    error = 1e3 * contour_error(*path, clock.plan_time(t[counted]), places[counted])
    return Score(motion.end_t, float(np.sqrt(np.mean(error**2))), float(np.percentile(error, 99)), float(error.max()))


def judge(case: str, seconds: float) -> Iterator[tuple[str, Score, Track]]:
    """Yield the motion as sliced and compensated: what the plant says, and what ffcomp predicts."""
    sliced, name, offset = CASES[case]
    machine = load_machine(name)
    data = CIRCLE.encode() if sliced == CIRCLE else (SAMPLES / f"{sliced}.gcode").read_bytes()
    data = beginning(data, machine, offset, seconds)
    original = plan_program(read(data, machine, offset), machine)
    path = path_corners(original.trajectory)
    lines = Job(data, "print", machine, CompensateOptions(flavor="marlin", offset_mm=offset)).lines()
    written = read(b"".join(lines), machine)
    predicted = lines.value.statistics.predicted
    tracks = {} if predicted is None else predicted.forecast(machine, "marlin").tracks
    motion = played(original.program, machine)[1]
    yield "as sliced", score(motion, name, reference_clock(motion), path), tracks["uncompensated"]
    plan, motion = played(written, machine)
    clock = section_starts(written, original).clock(plan.start_t)
    yield "compensated", score(motion, name, clock, path), tracks["compensated"]
