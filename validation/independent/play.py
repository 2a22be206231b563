"""Play a file on a printer that shakes, and measure how far the nozzle leaves the path that the original draws.

The motion is that of `clock.times`; the printer is one of the machine file's numbers: each straight axis as the modes
that the file states, a delta as the nonlinear plant of `validation/plants`. Where the nozzle should be is read off the
original: each of its moves stands in the result, as itself or as a comment, where its time comes.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import cont2discrete, lfilter

from validation.independent import reader
from validation.independent.checks import Lines, Printer, laid_over
from validation.independent.clock import Times, times
from validation.independent.reader import Moves
from validation.plants import delta_plant

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

JUDGED_S = 240.0  # of each print, from its first segment on
SETTLE_S = 0.5  # not judged: what moved before still rings
SAMPLE_S = 1.0 / 3200
AROUND = 8  # moves on either side of the one that is due, whose line may be the nearest
STEP_S, KEEP_EVERY = 1 / 12800, 4


def position(moves: Moves, clock: Times, t: FloatArray) -> FloatArray:
    """Where the command is at the times t (k,) → (k, 3) mm."""
    at = np.clip(np.searchsorted(clock.begin_s, t, side="right") - 1, 0, len(moves) - 1)
    a, start, cruise, end = (v[at] for v in (clock.acceleration, clock.start_v, clock.cruise_v, clock.end_v))
    since = np.clip(t - clock.begin_s[at], 0.0, clock.lasts_s[at])
    up, down = (cruise - start) / a, (cruise - end) / a
    first = np.minimum(since, up)
    last = np.clip(since - (clock.lasts_s[at] - down), 0.0, None)
    middle = np.clip(since - first - last, 0.0, None)
    way = start * first + 0.5 * a * first**2 + cruise * middle + cruise * last - 0.5 * a * last**2
    share = np.clip(way / np.maximum(clock.length[at], 1e-12), 0.0, 1.0)
    return np.asarray(moves.start[at, :3] + moves.step[at, :3] * share[:, None])


def contour(
    before: bytes, after: bytes, machine: dict[str, Any], printer: Printer, firmware: str = "klipper"
) -> dict[str, float | None]:
    """Contour error, rms in µm, of the original and of the result."""
    relative = reader.relative_without_saying(before)
    read, written = (reader.read(text, printer.limits, firmware, relative) for text in (before, after))
    laid = laid_over(before.split(b"\n"), after.split(b"\n"))
    plan, clock = times(read, printer.own), times(written, printer.own)
    shift = np.array([float(np.median(written.at(laid.place[[-1]])[0, k] - read.end[-1, k])) for k in (0, 1)])
    first, last = _part(read, written, clock, laid)
    if last <= first:
        return {}
    due = _due(read, written, clock, laid)
    found: dict[str, float | None] = {"judged_s": None}
    path = (read.start[:, :3], read.end[:, :3])
    shift = np.round(shift, 3) if np.abs(shift).max() > 0.5 else np.zeros(2)
    for key, moves, motion, begins in (("", read, plan, plan.begin_s), ("_compensated", written, clock, due)):
        begin, end = float(begins[first]), float(begins[last])
        t, nozzle = _played(machine, moves, motion, begin, end)
        if key:
            nozzle[:, :2] -= shift
            found["judged_s"] = end - begin
        error = _apart(path, begins, t, nozzle) * 1e3
        found[f"judged_contour{key}_um"] = float(np.sqrt(np.mean(error**2)))
    return found


def _due(read: Moves, written: Moves, clock: Times, laid: Lines) -> FloatArray:
    """When each move of the original is due in the result, (n,) s."""
    begin = np.append(clock.begin_s, clock.end_s)
    at = written.after[laid.place[read.line]]
    due = begin[at]
    # the chords of an arc share a line: they share its time, too, by their length
    same = np.flatnonzero(np.diff(read.line) == 0) + 1
    if len(same):
        due = due.copy()
        heads = np.flatnonzero(np.diff(read.line, prepend=-1))
        group = np.cumsum(np.diff(read.line, prepend=-1) != 0) - 1
        until = np.append(due[heads[1:]], clock.end_s)
        way = np.linalg.norm(read.step[:, :3], axis=1)
        gone = np.cumsum(way) - way
        due += (until[group] - due) * (gone - gone[heads[group]]) / np.maximum(np.bincount(group, way)[group], 1e-12)
    return np.asarray(np.maximum.accumulate(due))


def _part(read: Moves, written: Moves, clock: Times, laid: Lines) -> tuple[int, int]:
    """The moves that are judged: from the first that has become segments and begins at a known place."""
    travels = np.hypot(read.step[:, 0], read.step[:, 1]) > 0.0
    replaced = np.flatnonzero(laid.kept[read.line] & travels & read.known)
    if not len(replaced):
        return 0, 0
    due = _due(read, written, clock, laid)
    first = int(replaced[0])
    return first, int(min(np.searchsorted(due, due[first] + JUDGED_S), int(replaced[-1])))


def _played(
    machine: dict[str, Any], moves: Moves, clock: Times, begin: float, end: float
) -> tuple[FloatArray, FloatArray]:
    """The nozzle from a time on, t (k,) s and (k, 3) mm; it has settled."""
    if machine["kinematics"]["type"] == "delta":
        plant = {key: value for key, value in machine.items() if key != "effects"}
        span = (begin, end)
        t, nozzle = delta_plant.followed(plant, lambda t: position(moves, clock, t), span, STEP_S, KEEP_EVERY)
    else:
        t = np.arange(begin, end, SAMPLE_S)
        nozzle = position(moves, clock, t)
        for k, axis in enumerate("xyz"):
            if modes := machine.get("axes", {}).get(axis):
                nozzle[:, k] = _shaken(nozzle[:, k], modes)
    settled = t > begin + SETTLE_S
    return t[settled], nozzle[settled]


def _shaken(command: FloatArray, modes: dict[str, list[float]]) -> FloatArray:
    """An axis' answer: a mass on a spring that the motor pulls, damped against the frame; modes side by side."""
    frequencies, damping = modes["frequency_hz"], modes["damping_ratio"]
    shares = modes.get("share") or [1.0 / len(frequencies)] * len(frequencies)
    origin, answer = command[0], np.zeros_like(command)
    for f, zeta, share in zip(frequencies, damping, shares, strict=True):
        w = 2.0 * np.pi * f
        b, a, _ = cont2discrete(([w**2], [1.0, 2.0 * zeta * w, w**2]), SAMPLE_S, method="foh")
        answer += share * lfilter(b.ravel(), a, command - origin)
    return np.asarray(origin + answer)


def _apart(path: tuple[FloatArray, FloatArray], due: FloatArray, t: FloatArray, nozzle: FloatArray) -> FloatArray:
    """How far the nozzle (k, 3) is from the nearest of the lines that are due about then, (k,) mm."""
    start, step = path[0], path[1] - path[0]
    squared = np.maximum(np.einsum("ij,ij->i", step, step), 1e-18)
    at = np.searchsorted(due, t, side="right") - 1
    nearest = np.full(len(t), np.inf)
    for offset in range(-AROUND, AROUND + 1):
        k = np.clip(at + offset, 0, len(start) - 1)
        apart = nozzle - start[k]
        share = np.clip(np.einsum("ij,ij->i", apart, step[k]) / squared[k], 0.0, 1.0)
        nearest = np.minimum(nearest, np.linalg.norm(apart - share[:, None] * step[k], axis=1))
    return nearest
