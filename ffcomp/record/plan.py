"""A plan of experiments, the command of each, and the JSON file (ffcomp-moves/1) that keeps both.

Vertices, speeds and limits are those of the G-code, so that planning them gives the command at any time. Derived values
(durations, names of captures) are there for other readers, and are not read back.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ffcomp.errors import LimitsError, MeasurementError
from ffcomp.numerics.serialise import json_object, keys
from ffcomp.planner.limits import DeltaSlowZones, PlannerLimits
from ffcomp.planner.lookahead import plan_moves
from ffcomp.planner.segment_timing import SegmentLimits, SegmentSpeeds, segment_speeds
from ffcomp.planner.trajectory import Trajectory
from ffcomp.record.multisine import Band
from gcode.atomic_write import replace_atomically
from gcode.emit import F_COUNTS
from gcode.program import Moves
from models.arrays import BoolArray, FloatArray

LIMIT_COLUMNS = ("velocity_limit", "acceleration", "square_corner_velocity", "minimum_cruise_ratio")
"""Columns of `gcode.program.Moves` that state a single move's limits; NaN where it has none."""

LARGEST_DELAY_S = 5e-5  # of a knot: reached later, it demands too much
FEED_COUNTS = 60 * F_COUNTS  # of F, in one mm/s


@dataclass(frozen=True, eq=False)
class Motion:
    """n moves, each beginning where the one before ended. mm, mm/s, s."""

    start_mm: FloatArray  # (4,) columns X Y Z E
    ends_mm: FloatArray  # (n, 4) columns X Y Z E
    speed: FloatArray  # (n,) mm/s, as F states it
    limits: PlannerLimits  # of the firmware while it executes them
    move_limits: FloatArray  # (n, 4) columns `LIMIT_COLUMNS`; NaN: as `limits`
    stop_before: BoolArray  # (n,) the motion rests before the move
    wait_before: FloatArray  # (n,) s at rest before the move

    @cached_property
    def trajectory(self) -> Trajectory:
        """The nozzle's motion as the firmware executes the moves; it begins at zero."""
        starts = np.vstack([self.start_mm[None], self.ends_mm[:-1]])
        zeros = np.zeros(len(self.speed), dtype=np.int64)
        moves = Moves(zeros, starts, self.ends_mm, self.speed, zeros, *np.ascontiguousarray(self.move_limits.T))
        return plan_moves(moves, self.limits, stop_before=self.stop_before, wait_before=self.wait_before)

    @property
    def duration_s(self) -> float:
        """From rest to rest."""
        return self.trajectory.end_t

    def nozzle(self, t_s: FloatArray) -> FloatArray:
        """Return the nozzle's command at the times (k,) s: (k, 3) mm. It rests before and after."""
        return np.ascontiguousarray(self.trajectory.position(t_s)[:, :3])

    @property
    def stated_limits(self) -> dict[str, Any]:
        """The firmware's limits that are stated, by name."""
        return {key: value for key, value in asdict(self.limits).items() if value is not None}

    @property
    def own_limits(self) -> dict[str, list[float | None]]:
        """Limits of single moves, by name, those that a move has: (n,) each."""
        columns = zip(LIMIT_COLUMNS, self.move_limits.T, strict=True)
        return {name: column.tolist() for name, column in columns if not np.isnan(column).all()}

    @property
    def vertices_mm(self) -> FloatArray:
        """The corners of the path, (n + 1, 3) mm."""
        return np.vstack([self.start_mm[None], self.ends_mm])[:, :3]


def plain_motion(vertices_mm: FloatArray, speed: FloatArray, limits: PlannerLimits) -> Motion:
    """Build a motion without filament, waits and limits of single moves: through (n + 1, 3) mm at (n,) mm/s."""
    n = len(speed)
    places = np.column_stack([vertices_mm, np.zeros(n + 1)])
    nothing = np.full((n, len(LIMIT_COLUMNS)), np.nan)
    return Motion(places[0], places[1:], speed, limits, nothing, np.zeros(n, dtype=np.bool_), np.zeros(n))


# Segments of equal duration


def segment_motion(vertices_mm: FloatArray, segment_s: float, output: SegmentLimits) -> Motion:
    """Build the motion through (n + 1, 3) mm with segments of S, as the firmware executes it.

    Raises LimitsError for knots that the firmware's acceleration cannot reach in time.
    """
    n = len(vertices_mm) - 1
    speeds = segment_speeds(vertices_mm, np.zeros(n), np.full(n, segment_s), output)
    written = _as_written(np.linalg.norm(np.diff(vertices_mm, axis=0), axis=1), speeds)
    limits = PlannerLimits(
        velocity_mm_per_s=output.velocity_mm_per_s,
        acceleration_mm_per_s2=output.acceleration_mm_per_s2,
        square_corner_velocity_mm_per_s=output.square_corner_velocity_mm_per_s,
        minimum_cruise_ratio=0.0,
        z_acceleration_mm_per_s2=output.z_acceleration_mm_per_s2,
    )
    trajectory = plain_motion(vertices_mm, written, limits).trajectory
    delay = np.abs(trajectory.start_t + trajectory.duration - segment_s * np.arange(1, n + 1)).max()
    if delay > LARGEST_DELAY_S:
        raise LimitsError(
            f"Segments of {1e3 * segment_s:.2f} ms would come up to {1e3 * delay:.2f} ms late: the "
            f"firmware's own acceleration in Z, {output.z_acceleration_mm_per_s2:g} mm/s², is too low for them."
        )
    return plain_motion(vertices_mm, np.asarray(trajectory.cruise_v), limits)


def _as_written(length: FloatArray, speeds: SegmentSpeeds) -> FloatArray:
    """Round speeds to F, (n,) mm/s: each segment makes up for the delay that rounding gave the one before."""
    delay, written = 0.0, []
    columns = (length, speeds.cruise, speeds.acceleration, speeds.duration, speeds.junction[:-1], speeds.junction[1:])
    for d, cruise, a, duration, before, after in zip(*(column.tolist() for column in columns), strict=True):
        c = max(round(cruise * (1.0 + delay / duration) * FEED_COUNTS), 1) / FEED_COUNTS
        ramps = (c - min(before, c)) ** 2 + (c - min(after, c)) ** 2
        delay += (d + ramps / (2.0 * a)) / c - duration
        written.append(c)
    return np.array(written)


SCHEMA = "ffcomp-moves/1"
REST_BEFORE_S, REST_AFTER_S = 1.0, 0.5  # in the capture: gravity and noise; ringing
SETTLE_S = 0.5  # before a capture begins, so that the firmware has time in hand and begins exactly


@dataclass(frozen=True, eq=False)
class Excitation:
    """The periodic part of an experiment that excites one coordinate: after what settles, whole periods.

    Times count from the experiment's first move.
    """

    json_keys: ClassVar = keys("direction", "band", "first_knot", "periods", segment_s="band.segment_s")

    direction: str  # A B C: this carriage alone; x y z: the nozzle along this axis
    band: Band
    first_knot: int  # where the first whole period begins that is not transient
    periods: int


@dataclass(frozen=True, eq=False)
class Experiment:
    """One motion from rest to rest, and where."""

    json_keys: ClassVar = keys("name", "kind", "place", "position_mm", "duration_s", "measured_from_s") | keys(
        microstep_error="rounding",
        limits="motion.stated_limits",
        start_mm="motion.start_mm",
        ends_mm="motion.ends_mm",
        speed_mm_per_s="motion.speed",
        own_limits="motion.own_limits?",
        excitation="excitation?",
    )

    name: str  # ffcomp-<kind>-<place>; of an excitation ffcomp-<direction>-<place>
    kind: str
    place: int
    position_mm: tuple[float, float, float]  # of the nozzle at rest
    motion: Motion = field(repr=False)
    rounding: float  # by microsteps, as a share of the command
    excitation: Excitation | None = None

    @property
    def duration_s(self) -> float:
        """From rest to rest."""
        return self.motion.duration_s

    @property
    def moves(self) -> int:
        """How many it has."""
        return len(self.motion.speed)

    @property
    def measured_from_s(self) -> float:
        """Start of the first period whose response is periodic."""
        return 0.0 if self.excitation is None else float(self.motion.trajectory.start_t[self.excitation.first_knot])


@dataclass(frozen=True)
class Page:
    """How a page is drawn whose picture is the measurement."""

    pen: bool = False  # in place of the nozzle
    line_width_mm: float = 0.45
    nozzle_c: float = 210.0
    bed_c: float = 60.0


@dataclass(frozen=True, slots=True)
class Run:
    """One execution of an experiment, and how its capture is called."""

    name: str
    repeat: int
    capture: str


@dataclass(frozen=True, eq=False)
class Plan:
    """All experiments of a file, in the order of their first execution."""

    json_keys: ClassVar = keys(
        *("seed", "repeats", "rest_before_s", "rest_after_s", "experiments"), page="page?", runs="named_runs"
    ) | {"print": "print_file", "machine.name": "machine", "machine.sha256": "machine_sha256"}

    machine: str
    machine_sha256: str
    experiments: tuple[Experiment, ...]
    repeats: int
    rest_before_s: float = REST_BEFORE_S
    rest_after_s: float = REST_AFTER_S
    seed: int = 1
    print_file: str = ""  # the print that is the experiment
    page: Page | None = None  # that is drawn, and seen instead of felt

    def runs(self) -> list[tuple[Experiment, int]]:
        """List experiment and repeat, from 1, in the order of the file: a repeat follows when all were made once."""
        return [(each, repeat) for repeat in range(1, self.repeats + 1) for each in self.experiments]

    @property
    def named_runs(self) -> list[Run]:
        """The same with the names of their captures; none of a page."""
        runs = self.runs() if self.page is None else ()
        return [Run(each.name, repeat, capture_name(each.name, repeat)) for each, repeat in runs]

    def capture_s(self, experiment: Experiment) -> float:
        """Return how long the capture of one execution lasts, rests included, s."""
        return self.rest_before_s + experiment.duration_s + self.rest_after_s

    @property
    def duration_s(self) -> float:
        """From the first experiment to the end of the last one, without homing and travel."""
        resting = self.rest_before_s + self.rest_after_s + SETTLE_S
        return self.repeats * sum(each.duration_s + resting for each in self.experiments)


def run_name(name: str, repeat: int) -> str:
    """Return the name of one execution of an experiment."""
    return f"{name}-{repeat}"


def capture_name(name: str, repeat: int) -> str:
    """Return the pattern of a capture's file name; Klipper's begins with the chip."""
    return f"*{run_name(name, repeat)}.csv"


# To JSON


def save_plan(plan: Plan, path: Path) -> None:
    """Write the JSON file, replacing it atomically."""
    replace_atomically(path, [json.dumps(plan_dict(plan), ensure_ascii=False).encode(), b"\n"])


def plan_dict(plan: Plan) -> dict[str, Any]:
    """Return the object ffcomp-moves/1."""
    return {"schema": SCHEMA, **json_object(plan)}


# From JSON


def load_plan(path: str | Path) -> Plan:
    """Load a plan from its JSON file; MeasurementError for a file that is no such plan, or an incomplete one."""
    try:
        read = json.loads(Path(path).read_text(encoding="utf-8"))
        if read["schema"] != SCHEMA:
            raise ValueError(f"its schema is {read['schema']!r}")
        return Plan(
            machine=read["machine"]["name"],
            machine_sha256=read["machine"]["sha256"],
            experiments=tuple(_experiment(entry) for entry in read["experiments"]),
            print_file=read["print"],
            page=Page(**read["page"]) if "page" in read else None,
            **{key: kind(read[key]) for key, kind in _NUMBERS.items()},
        )
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        what = f"the key {error} is missing" if isinstance(error, KeyError) else str(error)
        rule = f"This is no complete plan ({SCHEMA}): {what}. Give the .json file next to the G-code."
        raise MeasurementError(str(path), [rule]) from None


_NUMBERS: dict[str, Any] = {"repeats": int, "rest_before_s": float, "rest_after_s": float, "seed": int}


def _experiment(entry: Mapping[str, Any]) -> Experiment:
    x, y, z = entry["position_mm"]
    excitation = None
    if "excitation" in entry:
        numbers = {each.name: entry["excitation"][each.name] for each in fields(Excitation)}
        excitation = Excitation(**numbers | {"band": Band(**numbers["band"])})
    name, kind, place, rounding = (entry[key] for key in ("name", "kind", "place", "microstep_error"))
    return Experiment(name, kind, int(place), (x, y, z), _motion(entry), float(rounding), excitation)


def _motion(entry: Mapping[str, Any]) -> Motion:
    ends = np.array(entry["ends_mm"], dtype=np.float64)
    n = len(ends)
    own, nothing = entry.get("own_limits", {}), [None] * n
    move_limits = np.array([own.get(name, nothing) for name in LIMIT_COLUMNS], dtype=np.float64).T
    limits = dict(entry["limits"])
    if "delta" in limits:
        limits["delta"] = DeltaSlowZones(*limits["delta"])
    return Motion(
        start_mm=np.array(entry["start_mm"], dtype=np.float64),
        ends_mm=ends,
        speed=np.array(entry["speed_mm_per_s"], dtype=np.float64),
        limits=PlannerLimits(**limits),
        move_limits=move_limits,
        stop_before=np.zeros(n, dtype=np.bool_),  # a plan that is written has neither rests nor waits inside
        wait_before=np.zeros(n),
    )
