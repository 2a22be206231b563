"""Judging a whole print: what a firmware plays, through the independent plant, against the path that was wanted.

The wanted motion is the firmware's plan of the original file. A method is a nozzle command over time (the plan
itself, the plan shaped, the segments of the compensated file as our planner or as the Kalico host plans them) and a
`SectionClock`, which says at what time of the wanted plan each instant of it is: compensated runs begin a little
earlier and end a little later than the path does, and nothing may hide in that.

All methods are judged alike: contour error to the wanted path's segments, tracking raw and with the best constant
delay removed, and also the largest commanded acceleration of any carriage over one segment's time. The
first `SETTLE_S` of a print are left out: before them the file's own first moves run uncompensated, and still ring.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ffcomp import shapers
from ffcomp.comparison import methods as ours
from ffcomp.comparison.methods import Compensated, Segments, shaped
from ffcomp.firmware.program import PlannedProgram, plan_program
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.settings import Settings, settings_for
from ffcomp.metrics import contour_error, peak_acceleration, tracking
from ffcomp.planner.trajectory import Trajectory
from ffcomp.simulation.command import Motion, SectionClock, motion_of, path_corners, planned_motion
from gcode.program import Program
from gcode.reader import read_program
from models.file import load_machine
from models.kinds import delta_vibration
from models.machine import Machine
from validation.kalico import kalico_plan, trajectory_of
from validation.plants import delta_plant

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

ROOT = Path(__file__).parents[1]
MACHINE_FILE = ROOT / "models" / "library" / "mp-delta-pro.toml"
PRINTS = ("ringing_tower", "lobed_vase", "far_star")

STEP_S = 1 / 12800  # of the plant's integration
KEEP_EVERY = 8  # steps between two samples that are judged
SETTLE_S = 0.5
EFFORT_S = 0.004  # one segment: the span over which accelerations of commands are taken
EFFORT_SAMPLE_S = 0.001
# Without heaters and endstops the host refuses the other commands of a print.
HOST_KNOWS = re.compile(rb"\s*(G0|G1|G4|G90|G91|G92|M82|M83|M204|SET_VELOCITY_LIMIT)\b", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Answer:
    """What the plant made of a motion, at m samples that count."""

    due: FloatArray  # (m,) s, when on the wanted plan's clock
    wanted: FloatArray  # (m, 3) mm, the nozzle as planned
    late: FloatArray  # (m, 3) mm, the same `delay_s` earlier: the constant delay that explains most of the error
    nozzle: FloatArray  # (m, 3) mm, the nozzle's actual place
    delay_s: float
    peak_m_per_s2: float  # largest commanded acceleration of any carriage


@dataclass(frozen=True, slots=True)
class Score:
    """µm, and m/s² of command."""

    tracking_rms_um: float
    tracking_rms_no_delay_um: float
    delay_s: float
    contour_rms_um: float
    contour_p99_um: float
    contour_max_um: float
    peak_m_per_s2: float


class Original:
    """A print to be judged: its file, the firmware's plan for it, and the machine it runs on."""

    def __init__(self, data: bytes, path: str, machine_file: Path = MACHINE_FILE) -> None:
        self.data = data
        self.machine: Machine = load_machine(machine_file)
        self.plant: dict[str, Any] = delta_plant.load_machine(machine_file)
        self.planned: PlannedProgram = plan_program(read_program(data, path, flavor="klipper"), self.machine)

    @property
    def trajectory(self) -> Trajectory:
        return self.planned.trajectory

    @property
    def corner_velocity_mm_per_s(self) -> float:
        """The file's at its first move, or the machine's (Kalico does not know Marlin's M205)."""
        asked = float(self.planned.program.moves.square_corner_velocity[0])
        return self.machine.limits.square_corner_velocity_mm_per_s if np.isnan(asked) else asked

    @cached_property
    def corners(self) -> tuple[FloatArray, FloatArray]:
        """When each corner of the path is due (n + 1,) s, and where it is (n + 1, 3) mm."""
        return path_corners(self.trajectory)

    @cached_property
    def motion(self) -> Motion:
        """The plan as it stands."""
        return planned_motion(self.trajectory)


def sample_print(name: str, from_s: float = 0.0, until_s: float = np.inf) -> Original:
    """A sample print, or the part of it that the plan has between two times; it begins with a retraction."""
    path = ROOT / "sample_prints" / f"{name}.gcode"
    whole = Original(path.read_bytes(), path.name)
    last = int(np.searchsorted(whole.trajectory.start_t, until_s))
    first = 0
    if from_s > 0.0:
        pulls_back = whole.trajectory.direction[:, 3] == -1.0
        first = int(np.flatnonzero(pulls_back & (whole.trajectory.start_t >= from_s))[0])
    return Original(b"".join(_cut(whole.planned.program, first, last)), path.name)


def _cut(program: Program, first: int, last: int) -> Iterator[bytes]:
    """The file without its moves before `first`, and without anything from the move `last` on."""
    moves, frame = program.moves, program.frames[int(program.moves.frame[first])]
    dropped = set(moves.line[:first].tolist())
    end = int(moves.line[last]) if last < len(moves) else len(program.lines)
    for at, line in enumerate(program.lines[:end]):
        if first and frame.absolute_e and at == moves.line[first]:
            yield b"G92 E%.5f\n" % (moves.start[first, 3] - frame.base[3])
        if at not in dropped:
            yield line


def compensated(original: Original, settings: Settings | None = None) -> Compensated:
    """The original print, compensated for its machine as the command line does it, in Klipper's flavor."""
    inverter = InverseModel(original.machine, settings or settings_for(original.machine))
    return ours.compensated(original.planned, inverter, "klipper")


# ---- the Kalico host's plan ----------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Replanned:
    """What the Kalico host makes of a file: its moves that are also moves of ours, and how it would play them."""

    trajectory: Trajectory
    motion: Motion


def original_through_kalico(original: Original) -> Replanned:
    travels = original.trajectory.travels
    own = original.trajectory.part(travels)
    played = kalico_trajectory(original, original.data, own)
    runs = [run for run in original.planned.sections if run.travels]
    firsts = np.searchsorted(np.flatnonzero(travels), [run.first for run in runs])
    begin_t, end_t = np.array([run.begin_t for run in runs]), np.array([run.end_t for run in runs])
    return Replanned(played, motion_of(played, SectionClock(played.start_t[firsts], begin_t, begin_t, end_t)))


def ours_through_kalico(original: Original, found: Compensated, own: Segments) -> Replanned:
    played = kalico_trajectory(original, found.text, own.trajectory)
    return Replanned(played, motion_of(played, own.clock(played.start_t)))


def kalico_trajectory(original: Original, text: bytes, own: Trajectory) -> Trajectory:
    """The host's last moves, one for each of `own`: the first ones in a file start where no plan of ours knows."""
    geometry, limits = delta_vibration(original.machine).kinematics, original.machine.limits
    moves = kalico_plan(
        b"".join(line for line in text.splitlines(keepends=True) if HOST_KNOWS.match(line)),
        max_velocity=limits.velocity_mm_per_s,
        max_accel=limits.acceleration_mm_per_s2,
        scv=original.corner_velocity_mm_per_s,
        delta_radius=float(geometry.delta_radii_mm.max()),
        arm_length=float(geometry.arm_lengths_mm.min()),
    )["moves"][-len(own) :]
    apart = np.abs(moves[:, 4:7] - own.origin[:, :3]).max()
    if apart > 1e-6:
        raise ValueError(f"The host's moves begin up to {apart:.3g} mm away from ours: they are not the same.")
    return trajectory_of(moves)


# ---- judgement -----------------------------------------------------------------------------------


def play(plant: dict[str, Any], motion: Motion, step_s: float = STEP_S) -> tuple[FloatArray, FloatArray]:
    """The nozzle's answer to a motion, from rest: t (m,) s, nozzle (m, 3) mm."""
    return delta_plant.followed(plant, motion.position, (motion.begin_t, motion.end_t), step_s, KEEP_EVERY)


def peak_m_per_s2(plant: dict[str, Any], motion: Motion) -> float:
    """The largest commanded acceleration of a carriage: second difference over one segment's time."""
    t = np.arange(motion.begin_t, motion.end_t, EFFORT_SAMPLE_S)
    carriages = delta_plant.carriages_of(plant, motion.position(t))
    return peak_acceleration(carriages, EFFORT_SAMPLE_S, EFFORT_S) / 1e3


def answer(original: Original, motion: Motion, step_s: float = STEP_S) -> Answer:
    """Play a motion on the plant, and find where it should have been."""
    t, nozzle = play(original.plant, motion, step_s)
    counted = t >= motion.clock.executed_t[0] + SETTLE_S
    t, nozzle = t[counted], nozzle[counted]

    def planned(at: FloatArray) -> FloatArray:
        return np.ascontiguousarray(original.trajectory.position(motion.clock.plan_time(at))[:, :3])

    wanted = planned(t)
    delay_s = tracking(wanted, nozzle, KEEP_EVERY * step_s).delay_s
    due, effort = motion.clock.plan_time(t), peak_m_per_s2(original.plant, motion)
    return Answer(due, wanted, planned(t - delay_s), nozzle, delay_s, effort)


def score(original: Original, found: Answer, beyond_mm: float = 0.0) -> Score:
    """Judge an answer, where the wanted nozzle is `beyond_mm` or more from the middle of the bed."""
    there = np.hypot(found.wanted[:, 0], found.wanted[:, 1]) >= beyond_mm
    if not there.any():
        raise ValueError(f"The print never is {beyond_mm} mm from the middle of the bed.")
    nozzle = found.nozzle[there]
    contour = contour_error(*original.corners, found.due[there], nozzle)
    return Score(
        _rms_um(np.linalg.norm(nozzle - found.wanted[there], axis=1)),
        _rms_um(np.linalg.norm(nozzle - found.late[there], axis=1)),
        found.delay_s,
        _rms_um(contour),
        float(np.percentile(contour, 99)) * 1e3,
        float(contour.max()) * 1e3,
        found.peak_m_per_s2,
    )


def judge(original: Original, motion: Motion, step_s: float = STEP_S) -> Score:
    """`score` of `answer`, over the whole bed."""
    return score(original, answer(original, motion, step_s))


def _rms_um(error_mm: FloatArray) -> float:
    return float(np.sqrt(np.mean(error_mm**2))) * 1e3


@dataclass(frozen=True, slots=True)
class Tuned:
    """The best shaper of its kind on one very motion, x and y alike."""

    frequency_hz: float
    damping_ratio: float
    score: Score


def best_shaper(
    original: Original,
    motion: Motion,
    kind: str,
    frequencies_hz: Iterable[float],
    damping_ratios: Iterable[float] = (shapers.DAMPING_RATIO,),
    step_s: float = STEP_S,
) -> Tuned:
    """The one with the least contour error of all that are tried."""
    make = shapers.SHAPERS[kind]
    tried = (
        Tuned(f, zeta, judge(original, shaped(motion, make(f, zeta), make(f, zeta)), step_s))
        for f in frequencies_hz
        for zeta in damping_ratios
    )
    return min(tried, key=lambda each: each.score.contour_rms_um)


# ---- what the tests share ------------------------------------------------------------------------

PARTS_S = {"ringing_tower": (75.0, 92.0), "lobed_vase": (75.0, 108.0), "far_star": (180.0, 197.0)}


@dataclass(frozen=True, slots=True)
class Case:
    """A sample print or a part of one, and what was made of it."""

    original: Original
    ours: Compensated
    segments: Segments


@cache
def case(name: str, when_s: tuple[float, float]) -> Case:
    """A sample print, or a part of it, compensated."""
    original = sample_print(name, *when_s)
    found = compensated(original)
    return Case(original, found, ours.segments(found, original.machine))


def part(name: str) -> Case:
    """Some 20 s: 200 mm/s at 5 and 8 m/s² (tower), 150 at 4 on a spiral (vase), 200 at 10 far out (star)."""
    return case(name, PARTS_S[name])
