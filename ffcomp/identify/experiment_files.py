"""A plan on disk: the G-code that executes it, and the JSON file (ffcomp-excitation/1) that holds its command.

The JSON file is complete: vertices as the G-code states them, the time between them, the limits they are executed under
and the geometry that turns them into carriage heights. Derived values (lines, times) are there for other readers, and
are not read back.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np

from ffcomp.identify.experiment import TOWERS, Experiment, Plan
from ffcomp.identify.multisine import Band, Lines
from ffcomp.measurement.plan_json import read_plan_json
from ffcomp.planner.segment_timing import SegmentLimits
from gcode.atomic_write import replace_atomically
from gcode.dialects import KLIPPER, close_limits, open_limits, shaper_off
from gcode.emit import MoveWriter
from gcode.limits import MotionLimits
from gcode.program import ModalState
from models.arrays import constant
from models.kinematics.base import Kinematics
from models.kinematics.cartesian import CartesianKinematics
from models.kinematics.delta import DeltaKinematics
from models.machine import Machine

SCHEMA = "ffcomp-excitation/1"
TRAVEL_SHARE = 0.2  # of the machine's velocity, between experiments
NOISE_S, DECAY_S = 1.0, 0.5  # at rest before and after each experiment, in the capture


# The JSON file


def save_plan(plan: Plan, path: Path) -> None:
    """Write the JSON file, replacing it atomically."""
    replace_atomically(path, [json.dumps(_account(plan), ensure_ascii=False).encode(), b"\n"])


def _account(plan: Plan) -> dict[str, Any]:
    first = plan.experiments[0]
    return {
        "schema": SCHEMA,
        "machine": {"name": plan.machine, "sha256": plan.machine_sha256},
        "kind": plan.kind,
        "seed": plan.seed,
        "kinematics": {name: _plain(value) for name, value in vars(first.geometry).items()},
        "output": asdict(first.output),
        "experiments": [_entry(experiment) for experiment in plan.experiments],
    }


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else value


def _entry(experiment: Experiment) -> dict[str, Any]:
    lines = experiment.lines
    return {
        "name": experiment.name,
        "direction": experiment.direction,
        "position_mm": experiment.position_mm,
        "band": asdict(experiment.band),
        "marker_knots": experiment.marker_knots,
        "first_knot": experiment.first_knot,
        "periods": experiment.periods,
        "segment_s": experiment.segment_s,
        "measured_from_s": experiment.measured_from_s,
        "lines": {each.name: getattr(lines, each.name).tolist() for each in fields(Lines)},
        "vertices_mm": experiment.vertices_mm.tolist(),
    }


def load_plan(path: str | Path) -> Plan:
    """Load a plan from its JSON file, with the command of every experiment at any time.

    Raises
    ------
    MeasurementError
        For a file that is no such record, or an incomplete one.
    """
    return read_plan_json(path, SCHEMA, _plan)


def _plan(account: Mapping[str, Any]) -> Plan:
    machine, output = account["machine"], SegmentLimits(**account["output"])
    arrays = {name: constant(value) for name, value in account["kinematics"].items() if isinstance(value, list)}
    kind = CartesianKinematics if "motor_matrix" in arrays else DeltaKinematics
    geometry = kind(**{**account["kinematics"], **arrays})
    experiments = tuple(_experiment(entry, geometry, output) for entry in account["experiments"])
    return Plan(machine["name"], machine["sha256"], account["kind"], account["seed"], experiments)


def _experiment(entry: Mapping[str, Any], geometry: Kinematics, output: SegmentLimits) -> Experiment:
    x, y, z = entry["position_mm"]
    given = {each.name: entry[each.name] for each in fields(Experiment) if each.name in entry}
    read = {"position_mm": (x, y, z), "band": Band(**entry["band"]), "vertices_mm": constant(entry["vertices_mm"])}
    return Experiment(**{**given, **read}, geometry=geometry, output=output)


# The G-code


def gcode_lines(
    plan: Plan, machine: Machine, flavor: str, chips: Sequence[str] = ("adxl345",), switch_shaper_off: bool = True
) -> Iterator[bytes]:
    """Yield the G-code file line by line.

    Parameters
    ----------
    machine : whose limits are put back after every experiment
    flavor : of `gcode.dialects`
    chips : Klipper's names of the accelerometers that each experiment starts and stops; none for no such commands
    """
    chips = chips if flavor == KLIPPER else ()
    yield from _comments(_instructions(plan, machine, flavor, bool(chips)))
    yield from (b"G28\n", b"G21\n", b"G90\n", b"M220 S100\n")
    if switch_shaper_off:
        yield from shaper_off(flavor)
    travel = TRAVEL_SHARE * machine.limits.velocity_mm_per_s
    height = plan.experiments[0].position_mm[2]
    yield b"G1 X%.10g Y%.10g Z%.10g F%.10g\n" % (*machine.kinematics.centre_mm, height, 60 * travel)
    for experiment in plan.experiments:
        yield from _comments(["", f"{experiment.name}: {what_moves(experiment)}, {experiment.duration_s:.1f} s"])
        yield from _measured(experiment, machine, flavor, chips, travel)
    yield from _comments(["", *_closing_words(plan, switch_shaper_off, bool(chips))])


def _measured(
    experiment: Experiment, machine: Machine, flavor: str, chips: Sequence[str], travel: float
) -> Iterator[bytes]:
    """Yield one experiment from rest to rest, between the start and the end of its capture."""
    toggles = [b"ACCELEROMETER_MEASURE CHIP=%b NAME=%b\n" % (c.encode(), experiment.name.encode()) for c in chips]
    there = b"G1 X%.10g Y%.10g Z%.10g F%.10g\n" % (*experiment.vertices_mm[0].tolist(), 60 * travel)
    yield from (there, b"M400\n", b"M117 %b\n" % experiment.name.encode(), *toggles)
    yield b"G4 P%.0f\n" % (1e3 * NOISE_S)
    yield there  # repeated: a reader of the file then knows the position after a command it does not know
    out = experiment.output
    yield from open_limits(
        flavor, out.velocity_mm_per_s, out.acceleration_mm_per_s2, out.square_corner_velocity_mm_per_s
    )
    yield from segment_lines(experiment)
    yield from close_limits(flavor, _own_limits(machine))
    yield from (b"G4 P%.0f\n" % (1e3 * DECAY_S), b"M400\n", *toggles)


def segment_lines(experiment: Experiment) -> list[bytes]:
    """Write the `G1` lines of one experiment, from its position on."""
    moves = MoveWriter()
    moves.reset(ModalState(), experiment.vertices_mm[0].tolist(), 0.0)
    ends = experiment.vertices_mm[1:]
    return moves.moves(np.column_stack([ends, np.zeros(len(ends))]), experiment.trajectory.cruise_v)


def _own_limits(machine: Machine) -> MotionLimits:
    own = machine.limits
    return MotionLimits(own.velocity_mm_per_s, own.acceleration_mm_per_s2, own.square_corner_velocity_mm_per_s, 0.5)


# Words


def _comments(sentences: Sequence[str]) -> Iterator[bytes]:
    for sentence in sentences:
        yield f"; {sentence}".rstrip().encode() + b"\n"


def what_moves(experiment: Experiment) -> str:
    """Name the moving coordinate and its position."""
    x, y, z = experiment.position_mm
    which = "carriage {} alone" if experiment.direction in TOWERS else "the nozzle along {}"
    return f"{which.format(experiment.direction)} at X{x:g} Y{y:g} Z{z:g}"


def capture_name(experiment: Experiment) -> str:
    """Return the pattern of a Klipper capture's file name; it begins with the chip."""
    return f"*-{experiment.name}.csv"


def duration_s(plan: Plan) -> float:
    """Sum the time from the first experiment to the end of the last, without homing and travel."""
    return sum(experiment.duration_s + NOISE_S + DECAY_S for experiment in plan.experiments)


def _instructions(plan: Plan, machine: Machine, flavor: str, captures: bool) -> list[str]:
    first = plan.experiments[0]
    minutes, rate = duration_s(plan) / 60, 1.0 / first.segment_s
    return [
        f"Excitation for the identification of {plan.machine} (machine file sha256 {plan.machine_sha256[:8]}).",
        f"{len(plan.experiments)} experiments, {minutes:.1f} min; {rate:.0f} segments a second, {flavor}.",
        "",
        "Before it runs:",
        "- Heaters off and cold, no filament needed, nothing on the bed; it homes by itself.",
        "- The accelerometer is screwed to the nozzle holder, rigidly, its axes along the printer's or written down;",
        "  a second one may sit on a carriage.",
        "- Bed mesh, skew correction and speed or flow overrides are off: moves must be executed as written.",
        *first.geometry.setup_notes,
        *_of_heights(plan, machine),
        "- Print it from the printer's own storage; a serial line is too slow.",
        "- Stay near: limits are opened for each experiment, so do not pause during one.",
        *([] if captures else ["- Record each experiment in a file of its own, from a second before it moves."]),
    ]


def _of_heights(plan: Plan, machine: Machine) -> list[str]:
    """Tell which limits in Z the firmware must allow, if anything moves there."""
    if not any(np.ptp(experiment.vertices_mm[:, 2]) for experiment in plan.experiments):
        return []
    out = plan.experiments[0].output
    return [
        f"- The firmware lets Z move at {machine.limits.velocity_mm_per_s:g} mm/s and "
        f"{out.z_acceleration_mm_per_s2:g} mm/s² (Klipper: max_z_velocity, max_z_accel)."
    ]


def _closing_words(plan: Plan, shaper_is_off: bool, captures: bool) -> list[str]:
    names = [capture_name(experiment) for experiment in plan.experiments]
    wanted = ["Bring back, from the temporary folder of the printer's host:", *names] if captures else []
    shaper = ["The input shaper stays off until the firmware is restarted."] if shaper_is_off else []
    return ["Done.", *wanted, *shaper]
