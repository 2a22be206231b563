"""One file's times: as it is written, and of the original that a compensated file keeps."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ffcomp.errors import NothingToDo
from ffcomp.estimate.layers import BEFORE, Layer
from ffcomp.estimate.spans import spans
from ffcomp.estimate.statistics import FILAMENT, KINDS, Account
from ffcomp.planner.program import plan_program
from ffcomp.planner.trajectory import PlannedMotion
from gcode.container import Source, blocks_of, ends_of
from gcode.dialects import FLAVORS, flavor_by_ends
from gcode.embedded import original_blocks
from gcode.errors import UnsupportedGcode
from gcode.program import Program
from gcode.reader import read_parts
from gcode.stamp import Stamp, find_offset, find_stamp
from models.arrays import FloatArray
from models.machine import Machine


@dataclass(frozen=True, slots=True)
class Estimate:
    """What a print takes on a machine."""

    path: str
    machine: Machine
    flavor: str
    account: Account  # of the file as it is written
    original: Account | None  # of the print before its compensation; None: the file is no compensated one

    @property
    def time_s(self) -> float:
        return seconds(self.account.total)


def stamp_of(source: Source) -> Stamp | None:
    """The stamp of a compensated file."""
    head, tail, _ = ends_of(source)
    return find_stamp(head, tail)


def estimate(
    source: Source,
    path: str,
    machine: Machine,
    *,
    flavor: str = "",
    offset: tuple[float, float] = (0.0, 0.0),
) -> Estimate:
    """Plan a file as the firmware does, and add up. Memory does not grow with the file.

    Parameters
    ----------
    path : the file's name, for errors
    flavor : "klipper", "marlin" or "reprapfirmware"; "": as the file says
    offset : mm, added to every position of a print that is not compensated yet

    Raises
    ------
    GcodeError
        A line that cannot be followed, or a place that the machine does not reach.
    NothingToDo
        A file that moves nothing.
    """
    head, tail, _ = ends_of(source)
    stamp = find_stamp(head, tail)
    flavor = flavor or (stamp.flavor if stamp else flavor_by_ends(head, tail))
    if flavor not in FLAVORS:
        raise UnsupportedGcode(f"The flavor {flavor!r} is none of {', '.join(sorted(FLAVORS))}.", path=path)
    if stamp is None:
        return Estimate(path, machine, flavor, _account(blocks_of(source), path, machine, flavor, offset), None)
    written = _account(blocks_of(source), path, machine, flavor, (0.0, 0.0))
    before = original_blocks(blocks_of(source))
    return Estimate(path, machine, flavor, written, _account(before, path, machine, flavor, find_offset(head)))


def _account(blocks: Iterable[bytes], path: str, machine: Machine, flavor: str, offset: tuple[float, float]) -> Account:
    def plan_of(program: Program) -> PlannedMotion:
        return plan_program(program, machine, offset).trajectory

    account = Account()
    for span in spans(read_parts(blocks, path, flavor=flavor, offset_mm=offset), plan_of):
        account.add(span)
    if not account.moves:
        raise NothingToDo(f"{path}: no move whose start is known; there is no time to tell.")
    return account


def seconds(row: FloatArray) -> float:
    """All the time in a row."""
    return float(row[:FILAMENT].sum())


def as_json(found: Estimate) -> dict[str, Any]:
    """The JSON object of `estimate`."""
    machine = found.machine
    return {
        "schema": "ffcomp-estimate/1",
        "input": found.path,
        "machine": {"name": machine.name, "sha256": machine.sha256},
        "flavor": found.flavor,
        "compensated": found.original is not None,
        **_told(found.account),
        "original": _told(found.original) if found.original else None,
    }


def _told(account: Account) -> dict[str, Any]:
    return {
        "time_s": seconds(account.total),
        **_row(account.total),
        "filament_mm": account.filament_mm,
        "moves": account.moves,
        "retractions": account.retractions,
        "slicer_time_s": account.slicer_s,
        "features": {name: {"time_s": seconds(row), **_row(row)} for name, row in account.features.items()},
        "layers": [_layer(number, layer) for number, layer in account.layers.in_order()],
        "unknown": [
            {"what": each.what, "command": each.command, "count": each.count, "lines": each.lines}
            for each in account.unknown.values()
        ],
        "warnings": account.warnings,
    }


def _row(row: FloatArray) -> dict[str, float]:
    return {f"{kind}_s": float(row[k]) for k, kind in enumerate(KINDS)}


def _layer(number: int, layer: Layer) -> dict[str, Any]:
    return {
        "layer": None if number == BEFORE else number,
        "line": layer.line,
        "z_mm": layer.z_mm if np.isfinite(layer.z_mm) else None,
        "time_s": seconds(layer.row),
        **_row(layer.row),
        "filament_mm": float(layer.row[FILAMENT]),
    }
