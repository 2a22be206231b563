"""Commands on the simulated printer: chunks with sensor signals, or the nozzle of many printers at once.

Rows of a command are at most ROW_S apart. A cubic spline through a plan's rows strays by 0.02 µm in the nozzle where
its speed has corners (5 mm/s at 10 m/s²), straight lines by 0.03 to 0.1 µm.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from ffcomp.simulation.command import Command, CommandSection, Motion
from models.arrays import FloatArray
from models.effects.effect import Signals
from models.errors import MachineFileError, UnreachableError
from models.machine import Machine
from models.printer import playback
from models.printer.kernels.record import LANES
from models.printer.parameters import converted_printer
from models.printer.printer import Hold, longest_step
from models.printer.rest import static_deflection

Item = TypeVar("Item")

ROW_S = 1 / 6400
CHUNK_ROWS = 40_000
SETTLE_S = 0.5  # executed before a part that begins in motion, and not shown
ROUNDING = 1e-6  # of a sample
TAIL_S = 0.25  # shown after a section has ended: the printer still rings

KEEP_EVERY = 4  # rows between two samples of `simulate_nozzles`
COARSE = 2  # rows and steps are so much longer where a search is content with 0.4 µm
MOST_ROWS, FEWEST_ROWS = 64_000, 2_000  # of a chunk, for one plant and for very many
SAMPLE_S = KEEP_EVERY * ROW_S
JOBS = os.cpu_count() or 1


@dataclass(frozen=True, eq=False)
class PlayedPart:
    """n evenly spaced samples of a section; the next chunk goes on where this one ends."""

    section: CommandSection
    t_s: FloatArray  # (n,) s, on the command's clock
    carriage_mm: FloatArray  # (n, 3)
    nozzle_mm: FloatArray  # (n, 3), seen from the bed
    signals: Signals  # true accelerations


def rows_per_sample(rate_hz: float) -> int:
    """Return the number of rows of the command for each sample, so that they are no farther apart than ROW_S."""
    return math.ceil((1 - 1e-9) / (rate_hz * ROW_S))


def play(
    command: Command,
    plant: Machine,
    rate_hz: float,
    from_s: float = 0.0,
    to_s: float = math.inf,
    *,
    gravity: bool = True,
) -> Iterator[PlayedPart]:
    """Execute a part of a command on the plant, section by section, each from rest.

    While a chunk is used, the next one is computed in a thread. Raises MachineFileError if the plant cannot even rest,
    UnreachableError if its nozzle leaves the reach of its arms.
    """
    rows = rows_per_sample(rate_hz)
    for section, begin_s, end_s in command.between(from_s, to_s):
        tail_s = TAIL_S if end_s == section.end_s else 0.0
        lead = min(int((begin_s - section.begin_s) * rate_hz), math.ceil(SETTLE_S * rate_hz))
        last = int((end_s + tail_s - begin_s) * rate_hz + ROUNDING)
        t = begin_s + np.arange(-lead, last + 1) / rate_hz
        yield from _ahead(_section(section, plant, t, lead, 1 / (rate_hz * rows), rows, command.hold, gravity))


def _section(
    section: CommandSection,
    plant: Machine,
    t: FloatArray,
    lead: int,
    row_s: float,
    rows_a_sample: int,
    hold: Hold,
    gravity: bool,
) -> Iterator[PlayedPart]:
    """Yield samples at the even times t (n,) s, without the first `lead` of them."""

    def rows(first: int, last: int) -> FloatArray:
        return section.rows(t[first // rows_a_sample] + row_s * np.arange(last - first), row_s)

    count, chunk_rows = (len(t) - 1) * rows_a_sample + 1, CHUNK_ROWS // rows_a_sample * rows_a_sample
    chunks = playback.play([plant], rows, count, row_s, hold=hold, gravity=gravity, chunk_rows=chunk_rows)
    try:
        for row, (motion,) in chunks:
            first = row // rows_a_sample
            part = t[first : first + (len(motion.t_s) - 1) // rows_a_sample + 1]
            begin = max(lead - first, 0 if first == 0 else 1)  # the first sample is the last of the chunk before
            every = slice(begin * rows_a_sample, None, rows_a_sample)
            signals = Signals(part[begin:], motion.carriage_acceleration[every], motion.nozzle_acceleration[every])
            if begin < len(part):
                yield PlayedPart(section, part[begin:], motion.carriage_mm[every], motion.nozzle_mm[every], signals)
    except UnreachableError:
        raise
    except ValueError as error:
        raise MachineFileError(plant.path or plant.name, [str(error)]) from error


def _ahead(items: Iterator[Item]) -> Iterator[Item]:
    """Yield the same items, each made while the one before is used."""
    with ThreadPoolExecutor(1) as pool:
        coming = pool.submit(next, items, None)
        while (item := coming.result()) is not None:
            coming = pool.submit(next, items, None)
            yield item


def levelled(plant: Machine, nozzle: FloatArray) -> FloatArray:
    """Take the static deflection out of positions (n, 3) mm, as bed levelling does on a calibrated printer."""
    return nozzle - static_deflection(plant, nozzle)


def simulate_nozzles(
    plants: Sequence[Machine], motions: Sequence[Motion], believed: Machine, *, coarse: bool = False
) -> list[tuple[FloatArray, FloatArray]]:
    """Execute motions side by side, each from rest on a printer of its own, which takes little longer than one.

    Returns times (m,) s on each motion's clock, SAMPLE_S apart, and the levelled nozzle (m, 3) mm.

    plants, motions : one for all, or one for each; at best LANES motions of about the same length
    believed : the machine whose inverse kinematics the firmware uses
    coarse : with longer rows, as a search needs; printers that are not smooth keep the short ones
    """
    printers = map(converted_printer, plants if coarse else ())
    one_step_a_row = all(longest_step(p.parameters, p.modes) >= (1 - ROUNDING) * ROW_S for p in printers)
    longer = COARSE if coarse and one_step_a_row else 1
    row_s, keep_every, pairs = longer * ROW_S, KEEP_EVERY // longer, max(len(plants), len(motions))

    def command(motion: Motion) -> Callable[[int, int], FloatArray]:
        actuators, begin, end = motion.actuators(believed), motion.begin_t, motion.end_t
        return lambda first, last: actuators(np.minimum(begin + row_s * np.arange(first, last, dtype=np.float64), end))

    commands = [command(motion) for motion in motions]
    plants, motions = list(plants) * (pairs // len(plants)), list(motions) * (pairs // len(motions))
    kept = [int((motion.end_t - motion.begin_t) / ROW_S) // KEEP_EVERY for motion in motions]
    counts = [KEEP_EVERY * count // longer for count in kept]
    chunk_rows = max(min(8 * MOST_ROWS // pairs, MOST_ROWS), FEWEST_ROWS) // KEEP_EVERY * KEEP_EVERY
    how: Any = {"hold": "linear", "chunk_rows": chunk_rows, "substeps": 1 if longer > 1 else None}
    parts_of: list[list[FloatArray]] = [[] for _ in motions]
    for first, played in playback.play(plants, commands, max(counts) + 1, row_s, **how):
        for into, each, count in zip(parts_of, played, counts, strict=True):
            into.append(each.nozzle_mm[keep_every : max(count - first, 0) + 1 : keep_every])
    nozzles = [levelled(plant, np.concatenate(parts)) for plant, parts in zip(plants, parts_of, strict=True)]
    times = [m.begin_t + SAMPLE_S * np.arange(1, n + 1, dtype=np.float64) for m, n in zip(motions, kept, strict=True)]
    return list(zip(times, nozzles, strict=True))


def side_by_side(motions: Sequence[Motion]) -> list[list[int]]:
    """Group motions, by their numbers, for `simulate_nozzles`: as many as go at once, of about the same length."""
    order = sorted(range(len(motions)), key=lambda k: motions[k].end_t - motions[k].begin_t)
    return [order[k : k + LANES] for k in range(0, len(order), LANES)]


def check_same_kinematics(machine: Machine, plant: Machine) -> None:
    """Raise MachineFileError unless a plant has the machine's kinematics; else its error would be the geometry's."""
    if type(machine.kinematics) is not type(plant.kinematics):
        rule = f"A plant must have the machine's kind of kinematics, that of {machine.path or machine.name}."
        raise MachineFileError(plant.path or plant.name, [rule])
    problems = []
    for key, allowed in machine.kinematics.calibration_tolerances.items():
        nominal, other = (np.atleast_1d(getattr(m.kinematics, key)) for m in (machine, plant))
        if np.abs(nominal - other).max() > allowed:
            difference = f"kinematics.{key} is {_shown(other)}, but {_shown(nominal)} in {machine.path or machine.name}"
            rule = f"a plant must have the machine's kinematics, within {allowed:g}"
            problems.append(f"{difference}: {rule}. For another calibration there is the effect arm_geometry.")
    if problems:
        raise MachineFileError(plant.path or plant.name, problems)


def _shown(values: np.ndarray) -> str:
    return ", ".join(f"{v:g}" for v in values.ravel())
