"""The history of a printer's checks: one file of lines, each a check as JSON.

Each line has a finding. Motion is kept of the first check of a plan and of the last few, so that the file stays
small; a line that cannot be read is never overwritten.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from ffcomp.check.changes import SensorSignal
from ffcomp.errors import MeasurementError
from gcode.atomic_write import replace_atomically

SCHEMA = "ffcomp-check-history/1"
MOST, WITH_MOTION = 100, 5  # checks; the last ones whose motion is kept, besides the first
T = TypeVar("T")
MM = 1e3  # accelerations are kept as whole mm/s²


@dataclass(frozen=True, eq=False)
class Check:
    """One check of the history."""

    date: str  # ISO 8601
    plan: str  # of what moves it is, see `moves_hash`
    machine_sha256: str
    axes_map: str
    finding: str
    said: str
    gap: float  # to the machine file, as a share of the signal
    difference: float | None  # to the check before; None: there was none
    noise: float
    signals: tuple[SensorSignal, ...] = ()  # empty: no longer kept

    def is_same_recording(self, signals: Sequence[SensorSignal]) -> bool:
        """Tell whether these are the very captures of this check."""
        values = {each.name: _whole(each) for each in self.signals}
        return bool(signals) and all(
            each.name in values and np.array_equal(values[each.name], _whole(each)) for each in signals
        )


def moves_hash(experiments: Sequence[Mapping[str, Any]]) -> str:
    """Return a hash of the moves of a plan."""
    return hashlib.sha256(json.dumps(experiments, sort_keys=True).encode()).hexdigest()


def read_history(path: Path) -> list[Check]:
    """Read all checks, the oldest first; see `read_lines`."""
    return read_lines(path, SCHEMA, "check", _check)


def read_lines(path: Path, schema: str, what: str, read: Callable[[dict[str, Any]], T]) -> list[T]:
    """Read a history of lines of JSON, the oldest first; none where there is no file.

    Raises MeasurementError for a file that is damaged, or none of ours.
    """
    entries = list[T]()
    try:
        for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
            entry = json.loads(line)
            if entry["schema"] != schema:
                raise ValueError(f"its schema is {entry['schema']!r}")
            entries.append(read(entry))
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        rule = f"Line {len(entries) + 1} of the history is no {what} of ffcomp ({error}). Nothing was changed"
        remedy = f"Give another file with --history, or move this one away: {what}s then start again."
        raise MeasurementError(str(path), [f"{rule}. {remedy}"]) from error
    return entries


def write_history(path: Path, checks: Sequence[Check]) -> None:
    """Write the checks, of the oldest without their motion, replacing the file atomically."""
    kept = list(checks)[-MOST:]
    last = kept[-1].plan
    first = next(k for k, each in enumerate(kept) if each.plan == last and each.signals)
    lines = [
        json.dumps(_entry(each, k == first or k >= len(kept) - WITH_MOTION), separators=(",", ":"), ensure_ascii=False)
        for k, each in enumerate(kept)
    ]
    replace_atomically(path, [f"{line}\n".encode() for line in lines])


def _entry(check: Check, with_motion: bool) -> dict[str, Any]:
    values = {each.name: getattr(check, each.name) for each in fields(Check)[:-1]}
    kept = check.signals if with_motion else ()
    signals = [
        {
            "name": each.name,
            "noise_m_per_s2": np.round(each.noise, 5).tolist(),
            "clock_sd_s": round(each.clock_sd_s, 7),
            "acceleration_mm_per_s2": _whole(each).T.tolist(),
        }
        for each in kept
    ]
    return {"schema": SCHEMA, **values, "experiments": signals}


def _whole(signals: SensorSignal) -> Any:
    return np.rint(MM * signals.acceleration).astype(np.int64)


def _check(read: dict[str, Any]) -> Check:
    values = {each.name: read[each.name] for each in fields(Check)[:-1]}
    return Check(**values, signals=tuple(map(_signal, read["experiments"])))


def _signal(read: dict[str, Any]) -> SensorSignal:
    rows = np.array(read["acceleration_mm_per_s2"], dtype=np.float64).T / MM
    noise = np.array(read["noise_m_per_s2"], dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] != 3 or noise.shape != (3,) or not np.isfinite(rows).all() or noise.min() <= 0:
        raise ValueError("an acceleration is missing")
    return SensorSignal(str(read["name"]), rows, noise, float(read["clock_sd_s"]))
