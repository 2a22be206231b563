"""A plan on disk: the JSON file (ffcomp-moves/1) that holds the command of every experiment.

Vertices, speeds and limits are those of the G-code, so that planning them gives the command at any time. Derived values
(durations, names of captures) are there for other readers, and are not read back.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from ffcomp.measurement.plan_json import read_plan_json
from ffcomp.planner.limits import DeltaSlowZones, PlannerLimits
from ffcomp.record.motion import OWN, Motion
from ffcomp.record.plan import Experiment, MovesPlan
from gcode.atomic_write import replace_atomically
from models.arrays import FloatArray

SCHEMA = "ffcomp-moves/1"


def save_plan(plan: MovesPlan, path: Path) -> None:
    """Write the JSON file, replacing it atomically."""
    replace_atomically(path, [json.dumps(account(plan), ensure_ascii=False).encode(), b"\n"])


def account(plan: MovesPlan) -> dict[str, Any]:
    """Return the object ffcomp-moves/1."""
    return {
        "schema": SCHEMA,
        "machine": {"name": plan.machine, "sha256": plan.machine_sha256},
        "seed": plan.seed,
        "print": plan.print_file,
        "repeats": plan.repeats,
        "rest_before_s": plan.rest_before_s,
        "rest_after_s": plan.rest_after_s,
        "shaper": "off",
        "experiments": [_entry(each) for each in plan.experiments],
        "runs": [
            {"name": each.name, "repeat": repeat, "capture": capture_name(each.name, repeat)}
            for each, repeat in plan.runs()
        ],
    }


def run_name(name: str, repeat: int) -> str:
    """Return the name of one execution of an experiment."""
    return f"{name}-{repeat}"


def capture_name(name: str, repeat: int) -> str:
    """Return the pattern of a capture's file name; Klipper's begins with the chip."""
    return f"*{run_name(name, repeat)}.csv"


def _entry(experiment: Experiment) -> dict[str, Any]:
    motion = experiment.motion
    own = {name: _known(motion.own[:, i]) for i, name in enumerate(OWN) if not _unknown(motion.own[:, i])}
    waits = {str(i): float(motion.wait_before[i]) for i in np.flatnonzero(motion.wait_before).tolist()}
    of_prints = {"own_limits": own, "stops": np.flatnonzero(motion.stop_before).tolist(), "waits_s": waits}
    return {
        "name": experiment.name,
        "kind": experiment.kind,
        "place": experiment.place,
        "position_mm": experiment.position_mm,
        "duration_s": experiment.duration_s,
        "measured_from_s": 0.0,
        "microstep_error": experiment.rounding,
        "limits": {key: value for key, value in asdict(motion.limits).items() if value is not None},
        "start_mm": motion.start_mm.tolist(),
        "ends_mm": motion.ends_mm.tolist(),
        "speed_mm_per_s": motion.speed.tolist(),
        **{key: value for key, value in of_prints.items() if value},
    }


def _unknown(values: FloatArray) -> bool:
    return bool(np.isnan(values).all())


def _known(values: FloatArray) -> list[float | None]:
    """List values (n,), None where there is none: JSON has no NaN."""
    return [None if x != x else x for x in values.tolist()]


def is_moves_plan(path: str | Path) -> bool:
    """Tell by its schema whether a file is such a plan."""
    try:
        return bool(json.loads(Path(path).read_text(encoding="utf-8"))["schema"] == SCHEMA)
    except (OSError, ValueError, KeyError, TypeError):
        return False


def is_moves(path: str | Path) -> bool:
    """Tell by its schema whether a plan is of `record plan`."""
    try:
        found = json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False  # whoever reads it says what is wrong
    return isinstance(found, dict) and found.get("schema") == SCHEMA


def load_moves(path: str | Path) -> MovesPlan:
    """Load a plan from its JSON file.

    Raises
    ------
    MeasurementError
        For a file that is no such plan, or an incomplete one.
    """
    return read_plan_json(path, SCHEMA, _plan)


def _plan(read: Mapping[str, Any]) -> MovesPlan:
    return MovesPlan(
        machine=read["machine"]["name"],
        machine_sha256=read["machine"]["sha256"],
        experiments=tuple(_experiment(entry) for entry in read["experiments"]),
        repeats=int(read["repeats"]),
        rest_before_s=float(read["rest_before_s"]),
        rest_after_s=float(read["rest_after_s"]),
        seed=int(read["seed"]),
        print_file=read["print"],
    )


def _limits(read: Mapping[str, Any]) -> PlannerLimits:
    zones = {"delta": DeltaSlowZones(*read["delta"])} if "delta" in read else {}
    return PlannerLimits(**{**read, **zones})


def _experiment(entry: Mapping[str, Any]) -> Experiment:
    x, y, z = entry["position_mm"]
    ends = np.array(entry["ends_mm"], dtype=np.float64)
    n = len(ends)
    own = np.full((n, len(OWN)), np.nan)
    for i, name in enumerate(OWN):
        if name in entry.get("own_limits", {}):
            own[:, i] = np.array(entry["own_limits"][name], dtype=np.float64)
    stops, waits = np.zeros(n, dtype=np.bool_), np.zeros(n)
    stops[entry.get("stops", [])] = True
    for index, wait in entry.get("waits_s", {}).items():
        waits[int(index)] = wait
    motion = Motion(
        start_mm=np.array(entry["start_mm"], dtype=np.float64),
        ends_mm=ends,
        speed=np.array(entry["speed_mm_per_s"], dtype=np.float64),
        limits=_limits(entry["limits"]),
        own=own,
        stop_before=stops,
        wait_before=waits,
    )
    return Experiment(
        entry["name"], entry["kind"], int(entry["place"]), (x, y, z), motion, float(entry["microstep_error"])
    )
