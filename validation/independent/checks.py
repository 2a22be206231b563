"""What must hold of a compensated file, asked by a reader of its own: nothing of the compensator is imported.

`check` gives numbers and, in sentences, what is wrong. It needs the two files, the printer's limits and its room.

Nothing lost
    Every line of the original is there, in its order: unchanged, as a comment behind `;~`, or with another time.
Place
    Each line that is no move goes out after the filament, and near the place, that it had.
Segments
    How many there are in the fullest second of the clock of `clock.times`, and the shortest by way and by time.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from validation.independent import reader
from validation.independent.clock import Own, Times, times
from validation.independent.reader import MOVE, Limits, Moves

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

KEPT, KEPT_CUT, OURS, TIME_WAS = b";~", b";~~", b"; ffcomp", b"; ffcomp was "
STAMPS = b"; Processed by ffcomp", b"; ffcomp offset_mm=", b"; ffcomp forecast="
FILAMENT_MM, LINE_MM, PLACE_MM, REACH_MM = 1e-3, 5e-3, 2.0, 2e-3  # what is found wrong from where on
NARROWER = 4 * 0.4**2 / (np.pi * (1.75 / 2) ** 2)  # the widest bead that Klipper expects, over the filament
NEAR_MM, MOVE_MM, WINDOW = 0.2, 1.0, 400  # the last in moves of the result
SHOWN = 5  # examples of each kind
_NUMBERS = re.compile(rb"[\d.:]+\s*(?:[dhms]\b|hours?|minutes?|seconds?)?\s*")
_SHIFT = re.compile(rb"^; ffcomp offset_mm=([-+.\de]+),([-+.\de]+)", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class Printer:
    """The numbers of a printer that the checks use."""

    limits: Limits
    outside: Callable[[FloatArray], FloatArray]  # places (n, 3) mm → how far each lies out of reach, mm
    own: Own


def printer_of(machine: dict[str, dict[str, object]], firmware: str = "klipper") -> Printer:
    """Read what the checks need from a machine file's tables, as `tomllib` reads them."""
    kinematics, told = machine["kinematics"], machine["limits"]

    def number(key: str, otherwise: float) -> float:
        return float(told.get(key, otherwise))  # type: ignore[arg-type]

    limits = Limits(
        number("velocity_mm_per_s", 300.0),
        number("acceleration_mm_per_s2", 3000.0),
        number("square_corner_velocity_mm_per_s", 5.0),
    )
    z_velocity, z_acceleration = number("z_velocity_mm_per_s", 0.0), number("z_acceleration_mm_per_s2", 0.0)
    if kinematics["type"] == "delta":
        radius, height = float(kinematics["print_radius_mm"]), float(kinematics["print_height_mm"])  # type: ignore[arg-type]

        def outside(places: FloatArray) -> FloatArray:
            beyond = np.hypot(places[:, 0], places[:, 1]) - radius
            return np.maximum.reduce([beyond, places[:, 2] - height, 0.0 * beyond])
    else:
        ranges = np.array([kinematics[f"{axis}_range_mm"] for axis in "xyz"], dtype=np.float64)

        def outside(places: FloatArray) -> FloatArray:
            return np.maximum(ranges[:, 0] - places, places - ranges[:, 1]).max(axis=1).clip(0.0)

    # an extruder that moves alone, by Klipper's defaults: a nozzle of 0.4 mm, filament of 1.75 mm
    filament = [NARROWER * of for of in (limits.velocity, limits.acceleration)]
    if firmware == "klipper":  # its limits of Z, where the configuration states none, are those of the nozzle
        z_velocity, z_acceleration = z_velocity or limits.velocity, z_acceleration or limits.acceleration
    own = Own(z_velocity or None, z_acceleration or None, *filament)
    return Printer(limits, outside, own)


@dataclass(frozen=True, slots=True)
class Lines:
    """Which line of the result each line of the original has become."""

    place: IntArray  # (lines of the original,) index into the result's lines; -1: not there
    kept: BoolArray  # (lines of the original,) as a comment
    own: BoolArray  # (lines of the result,) the compensator's
    lost: list[str]


@dataclass(slots=True)
class Report:
    """Numbers of one file, and what is wrong with it in sentences."""

    numbers: dict[str, float | int | None] = field(default_factory=dict)
    wrong: list[str] = field(default_factory=list)


def laid_over(before: list[bytes], after: list[bytes], embedded: bool = True) -> Lines:
    """Find each line of the original in the result, in order."""
    place, kept = np.full(len(before), -1), np.zeros(len(before), dtype=np.bool_)
    own, lost, at = np.ones(len(after), dtype=np.bool_), list[str](), 0
    for number, line in enumerate(before):
        bare = line.rstrip(b"\r")
        found = _find(bare, after, at, len(after))
        if found is None:
            if not embedded and (MOVE.match(line) or not line.strip()):
                continue
            lost.append(f"line {number + 1} is not there in its order: {line[:60]!r}")
            if len(lost) > SHOWN:
                break
            continue
        place[number], kept[number] = found, after[found].startswith(KEPT)
        own[found], at = False, found + 1
    return Lines(place, kept, own, lost)


def _find(line: bytes, after: list[bytes], begin: int, end: int) -> int | None:
    told = _NUMBERS.sub(b"", line)
    for at in range(begin, end):
        other = after[at].rstrip(b"\r")
        if other == line or (other[:2] == KEPT and other[2:] == line) or (other[:3] == KEPT_CUT and other[3:] == line):
            return at
        was = at and after[at - 1].startswith(TIME_WAS)
        if was and _NUMBERS.sub(b"", other) == told and other != line:
            return at
    return None


def check(before: bytes, after: bytes, printer: Printer, firmware: str = "klipper", embedded: bool = True) -> Report:
    """Hold a compensated file against the one that it was made of."""
    report = Report()
    relative = reader.relative_without_saying(before)
    read, written = (reader.read(text, printer.limits, firmware, relative) for text in (before, after))
    lines = before.split(b"\n"), after.split(b"\n")
    laid = laid_over(lines[0], lines[1], embedded)
    shift = _SHIFT.search(after[: 1 << 20])
    offset = np.array([float(shift[1]), float(shift[2])]) if shift else np.zeros(2)
    report.wrong += laid.lost
    report.numbers["lost_lines"] = len(laid.lost)
    _restored(before, lines[1], laid, report)
    _share(read, lines, laid, report)
    _filament(read, written, report)
    _places(read, written, lines[0], laid, offset, report)
    clock = times(written, printer.own)
    # moves that begin at an unknown place, as after homing, take nobody knows how long
    travels = np.linalg.norm(written.step[:, :3], axis=1) > 0.0
    report.numbers["own_clock_s"] = clock.end_s - float(clock.lasts_s[travels & ~written.known].sum())
    _segments(written, clock, laid, lines[1], report)
    _reach(written, laid, printer, report)
    return report


def _restored(before: bytes, after: list[bytes], laid: Lines, report: Report) -> None:
    """Whatever is not the compensator's, read in order, is the original; what is its own is a segment or says so."""
    strange = []
    for number in np.flatnonzero(laid.own).tolist():
        line = after[number].rstrip(b"\r")
        ours = line.endswith(OURS) or line.startswith((TIME_WAS, *STAMPS)) or MOVE.match(line) or not line
        if not ours:
            strange.append(f"line {number + 1} of the result is neither the original's nor marked: {line[:60]!r}")
    report.wrong += strange[:SHOWN]
    report.numbers["strange_lines"] = len(strange)


def _share(read: Moves, lines: tuple[list[bytes], list[bytes]], laid: Lines, report: Report) -> None:
    """How much of the way in X and Y, and of the filament pushed along it, has become segments."""
    step = read.step
    way = np.hypot(step[:, 0], step[:, 1]) * read.known  # from an unknown place the distance is unknown
    pushed = np.where(way > 0.0, np.maximum(step[:, 3], 0.0), 0.0)
    after = lines[1]
    place = laid.place[read.line]
    replaced = laid.kept[read.line] | (place < 0)
    followed = np.array(
        [at >= 0 and at + 1 < len(after) and _is_raw(after[at + 1]) for at in place.tolist()], dtype=np.bool_
    )
    done = replaced & ~followed
    report.numbers["share_path"] = float(way[done].sum() / way.sum()) if way.sum() else None
    report.numbers["share_filament"] = float(pushed[done].sum() / pushed.sum()) if pushed.sum() else None


def _is_raw(line: bytes) -> bool:
    """A move of the original, shifted, that the firmware plans itself."""
    return bool(MOVE.match(line)) and line.rstrip().endswith(OURS) and any(axis in line for axis in (b"X", b"Y"))


def _filament(read: Moves, written: Moves, report: Report) -> None:
    total = [float(moves.step[:, 3].sum()) for moves in (read, written)]
    report.numbers["filament_difference_mm"] = total[1] - total[0]
    if abs(total[1] - total[0]) > FILAMENT_MM:
        report.wrong.append(f"The filament was {total[0]:.4f} mm in all and is {total[1]:.4f} mm.")


def _places(read: Moves, written: Moves, before: list[bytes], laid: Lines, offset: FloatArray, report: Report) -> None:
    """Where lines that are no moves stood, and where they stand."""
    chosen = [
        number
        for number, line in enumerate(before)
        if laid.place[number] >= 0 and not laid.kept[number] and line.strip() and not MOVE.match(line)
    ]
    if not chosen:
        return
    number = np.array(chosen, dtype=np.int64)
    was, now = read.at(number), written.at(laid.place[number])
    was[:, :2] += offset
    filament = np.abs(now[:, 3] - was[:, 3])
    _moves_in_place(read, written, laid, offset, report)
    command = np.array([not before[k].lstrip().startswith(b";") for k in chosen], dtype=np.bool_)
    # before anything has moved, and after homing, the place is unknown
    apart = np.linalg.norm((now - was)[:, :3], axis=1)
    apart[read.after[number] < 1] = 0.0
    report.numbers |= {
        "line_filament_mm": float(filament.max()),
        "command_place_mm": float(apart[command].max(initial=0.0)),
    }
    for what, off, most, unit in (
        ("filament", filament, LINE_MM, "mm of filament"),
        ("place", np.where(command, apart, 0.0), PLACE_MM, "mm of way"),
    ):
        wrong = np.flatnonzero(off > most)
        if len(wrong):
            k = int(off.argmax())
            report.wrong.append(
                f"{len(wrong)} lines go out at another {what}; the worst, line {chosen[k] + 1} "
                f"({before[chosen[k]][:40]!r}), {off[k]:.4f} {unit} away."
            )


def _moves_in_place(read: Moves, written: Moves, laid: Lines, offset: FloatArray, report: Report) -> None:
    """Whether the result passes near the beginning of each move: a path that was cut short is found by this.

    On straight stretches the comments that keep moves may stand together: the result is looked through from there on.
    """
    first = np.flatnonzero(np.diff(read.line, prepend=-1) & (laid.place[read.line] >= 0) & read.known)
    if not len(first):
        return
    was, at = read.start[first, :3].copy(), laid.place[read.line[first]]
    was[:, :2] += offset
    apart = np.linalg.norm(written.at(at)[:, :3] - was, axis=1)
    for k in np.flatnonzero(apart > NEAR_MM).tolist():
        begin = int(written.after[at[k]])
        later = slice(max(begin - 1, 0), begin + WINDOW)
        apart[k] = min(float(apart[k]), _nearest(was[k], written.start[later, :3], written.step[later, :3]))
    if apart.max() > MOVE_MM:
        k = int(apart.argmax())
        report.wrong.append(
            f"{int((apart > MOVE_MM).sum())} moves begin where the result never comes; the worst, of line "
            f"{int(read.line[first[k]]) + 1}, {apart[k]:.3f} mm away."
        )


def _nearest(place: FloatArray, start: FloatArray, step: FloatArray) -> float:
    """How far a place (3,) is from the nearest of some lines (n, 3)."""
    if not len(start):
        return float("inf")
    share = np.einsum("ij,ij->i", place - start, step) / np.maximum(np.einsum("ij,ij->i", step, step), 1e-18)
    return float(np.linalg.norm(start + np.clip(share, 0.0, 1.0)[:, None] * step - place, axis=1).min())


def _segments(written: Moves, clock: Times, laid: Lines, after: list[bytes], report: Report) -> None:
    """Count the compensator's moves of the nozzle in the fullest second, and look for the shortest."""
    marked = np.array([line.rstrip().endswith(OURS) for line in after], dtype=np.bool_)
    travels = np.linalg.norm(written.step[:, :3], axis=1) > 0.0
    own = laid.own[written.line] & ~marked[written.line] & travels
    report.numbers["segments"] = int(own.sum())
    if not own.any():
        return
    begun, lasts, length = clock.begin_s[own], clock.lasts_s[own], clock.length[own]
    count = np.arange(len(begun)) - np.searchsorted(begun, begun - 1.0, side="right") + 1
    report.numbers |= {
        "segments_worst_second": int(count.max()),
        "shortest_um": float(length.min()) * 1e3,
        "shortest_ms": float(lasts.min()) * 1e3,
    }


def _reach(written: Moves, laid: Lines, printer: Printer, report: Report) -> None:
    """Segments must lie where the printer reaches; lines of the original that do not are its own affair."""
    own = laid.own[written.line]
    out = printer.outside(written.end[:, :3])
    worst = float(out[own].max(initial=0.0))
    report.numbers["segments_out_of_reach_mm"] = worst
    if worst > REACH_MM:
        k = int(np.where(own, out, 0.0).argmax())
        report.wrong.append(
            f"line {int(written.line[k]) + 1} of the result goes {worst:.3f} mm out of reach: {written.end[k, :3]}."
        )
