"""Read G-code as a firmware for printers does: moves with their state, and what stands between them.

A small reader of its own: no code of the compensator is used. What it does not know moves nothing.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

ARC_MM = 2e-3  # how far a chord may leave its arc
ROUNDED_MM = 0.02  # by which an arc's radii differ at its ends where that is a slicer's rounding
E_RESTARTS = 0.3  # share of extrusions whose E is no more than the last one's, from which on E must be relative
X, Y, Z, E = range(4)

MOVE = re.compile(rb"\s*(?:N\d+\s*)?G0*([0-3])(?![\d.])", re.IGNORECASE)
_WORD = re.compile(rb"([A-Z])\s*([-+]?(?:\d+\.?\d*|\.\d+))", re.IGNORECASE)
_CODE = re.compile(rb"\s*(?:N\d+\s*)?([GMT])0*(\d+)(\.\d+)?", re.IGNORECASE)
_NAME = re.compile(rb"\s*([A-Z_][A-Z0-9_]+)", re.IGNORECASE)
_PARAMETER = re.compile(rb"([A-Z_]+)\s*=\s*([-+.\d]+)", re.IGNORECASE)
_MODE = re.compile(rb"^\s*(?:M8[23]|G91)\b", re.IGNORECASE | re.MULTILINE)
_EXTRUSION = re.compile(rb"^\s*G0*1\s[^;\n]*[XY][^;\n]*E\s*([-+.\d]+)", re.IGNORECASE | re.MULTILINE)

# Before these the motion comes to rest. Names that a bare Klipper carries out while the nozzle moves do not.
_RESTS = {("G", n) for n in (4, 10, 11, 27, 28, 29, 30, 32, 33, 34, 38, 80)} | {
    ("M", n) for n in (0, 1, 17, 18, 25, 84, 109, 116, 125, 190, 191, 400, 600, 701, 702)
}
_NO_REST = {
    b"SET_VELOCITY_LIMIT",
    b"SET_PRESSURE_ADVANCE",
    b"SET_FAN_SPEED",
    b"EXCLUDE_OBJECT_START",
    b"EXCLUDE_OBJECT_END",
    b"EXCLUDE_OBJECT_DEFINE",
    b"EXCLUDE_OBJECT",
    b"SET_PRINT_STATS_INFO",
    b"RESPOND",
    b"SET_HEATER_TEMPERATURE",
    b"ECHO",
    b"M",
    b"G",
}


@dataclass(frozen=True, slots=True)
class Limits:
    """What the firmware keeps to until a file says otherwise; the table [limits] of a machine file has these."""

    velocity: float = 300.0
    acceleration: float = 3000.0
    corner_velocity: float = 5.0
    cruise_ratio: float = 0.5
    travel_acceleration: float | None = None  # of moves without filament, where a file sets it
    most_acceleration: float = np.inf  # of each axis


@dataclass(slots=True)
class State:
    """What the words of the next line mean."""

    limits: Limits
    place: list[float] = field(default_factory=lambda: [0.0] * 4)  # mm as the machine counts; E: pushed so far
    base: list[float] = field(default_factory=lambda: [0.0] * 4)  # place = named x unit x flow + base
    absolute: bool = True
    absolute_e: bool = True
    unit: float = 1.0
    feed: float = 25.0  # mm/s
    feed_factor: float = 1.0
    flow: float = 1.0
    named: list[bool] = field(default_factory=lambda: [False] * 3)
    mode: int = 1


@dataclass(frozen=True, slots=True)
class Moves:
    """n moves in the file's order; arcs as chords."""

    line: IntArray  # (n,) index into the file's lines
    start: FloatArray  # (n, 4) X Y Z E, mm
    end: FloatArray
    feed: FloatArray  # (n,) mm/s as the file asks
    limits: FloatArray  # (n, 4) velocity, acceleration, corner velocity, cruise ratio in force
    rest: BoolArray  # (n,) the motion has come to rest before it
    wait_s: FloatArray  # (n,) dwell before it
    known: BoolArray  # (n,) it begins where the file has named X and Y since homing
    after: IntArray  # (lines + 1,) how many moves stand before each line

    def __len__(self) -> int:
        """How many there are."""
        return len(self.line)

    @property
    def step(self) -> FloatArray:
        """(n, 4) what each adds to X Y Z E."""
        return self.end - self.start

    def at(self, line: IntArray) -> FloatArray:
        """Where the nozzle and the filament are before lines (k,) → (k, 4)."""
        ends = np.vstack([self.start[:1] if len(self) else np.zeros((1, 4)), self.end])
        return np.asarray(ends[self.after[line]])


def relative_without_saying(text: bytes) -> bool:
    """Tell whether E must be relative in a file that never says which: it restarts with nearly every move."""
    if _MODE.search(text):
        return False
    e = np.array([float(m[1]) for m in _EXTRUSION.finditer(text)])
    return bool(len(e) > 10 and np.mean(np.diff(e) <= 0.0) > E_RESTARTS)


def read(text: bytes, limits: Limits, firmware: str = "klipper", relative_e: bool | None = None) -> Moves:
    """Read a whole file.

    Parameters
    ----------
    limits : before the file sets its own
    firmware : klipper, marlin or reprapfirmware: which commands set limits
    relative_e : how E is meant until the file says so; None: guessed
    """
    relative = relative_without_saying(text) if relative_e is None else relative_e
    return _Reader(limits, firmware, relative).run(text)


class _Reader:
    def __init__(self, limits: Limits, firmware: str, relative_e: bool) -> None:
        self.firmware = firmware
        self.keeps_e_mode = False  # at G90: Marlin 1, Bambu
        self.now = State(limits, absolute_e=not relative_e)
        self.kept: dict[bytes, State] = {}
        self.rows: list[tuple[float, ...]] = []
        self.lines: list[int] = []
        self.after: list[int] = []
        self.rest, self.wait_s = True, 0.0

    def run(self, text: bytes) -> Moves:
        lines = text.split(b"\n")
        self.keeps_e_mode = b"Bambu" in text
        for number, line in enumerate(lines):
            self.after.append(len(self.lines))
            code = line.partition(b";")[0]
            if not code or code.isspace():
                continue
            if match := MOVE.match(code):
                self.now.mode = int(match[1])
                self._move(number, code[match.end() :])
            elif match := _CODE.match(code):
                self._command(match[1].upper().decode(), int(match[2]), match[3], code[match.end() :])
            elif match := _NAME.match(code):
                self._named(match[1].upper(), code)
        self.after.append(len(self.lines))
        rows = np.array(self.rows).reshape(-1, 16)
        return Moves(
            np.array(self.lines, dtype=np.int64),
            rows[:, 0:4],
            rows[:, 4:8],
            rows[:, 8],
            rows[:, 9:13],
            rows[:, 13] > 0.0,
            rows[:, 14],
            rows[:, 15] > 0.0,
            np.array(self.after, dtype=np.int64),
        )

    def _move(self, number: int, words: bytes) -> None:
        now = self.now
        said = {letter.upper(): float(value) for letter, value in _WORD.findall(words)}
        if b"F" in said and said[b"F"] > 0.0:
            now.feed = said[b"F"] * now.unit / 60.0 * now.feed_factor
        end, known = list(now.place), now.named[X] and now.named[Y]
        for axis, letter in enumerate((b"X", b"Y", b"Z")):
            if letter in said:
                value = said[letter] * now.unit
                end[axis] = now.base[axis] + value if now.absolute else end[axis] + value
                now.named[axis] = now.named[axis] or now.absolute
        if b"E" in said:
            value = said[b"E"] * now.unit * now.flow
            absolute = now.absolute_e and (now.absolute or self.firmware != "klipper")
            end[E] = now.base[E] + value if absolute else end[E] + value
        chords = _arc(now.place, end, said, now.unit, clockwise=now.mode == 2) if now.mode >= 2 else [end]
        for point in chords:
            self._add(number, point, known)

    def _add(self, number: int, end: list[float], known: bool) -> None:
        now, limits = self.now, self.now.limits
        if end != now.place:
            self.lines.append(number)
            acceleration = limits.acceleration
            if limits.travel_acceleration is not None and not end[E] > now.place[E]:
                acceleration = limits.travel_acceleration
            acceleration = min(acceleration, limits.most_acceleration)
            told = (limits.velocity, acceleration, limits.corner_velocity, limits.cruise_ratio)
            self.rows.append((*now.place, *end, now.feed, *told, float(self.rest), self.wait_s, float(known)))
            self.rest, self.wait_s = False, 0.0
        now.place = end

    def _command(self, letter: str, number: int, more: bytes | None, words: bytes) -> None:
        now = self.now
        said = {key.upper(): float(value) for key, value in _WORD.findall(words)}
        if letter == "T" or (more and letter == "G"):
            self.rest = True
            return
        if (letter, number) in _RESTS:
            self.rest = True
            if number == 4 or (letter == "M" and number == 400):  # Bambu Lab's M400 waits, too
                self.wait_s += said.get(b"P", 0.0) / 1e3 + said.get(b"S", 0.0)
            if number == 28:
                now.named = [False] * 3
        elif letter == "G" and number in (20, 21):
            now.unit = 25.4 if number == 20 else 1.0
        elif letter == "G" and number in (90, 91):
            now.absolute = number == 90
            if self.firmware == "marlin" and not self.keeps_e_mode:
                now.absolute_e = now.absolute
        elif letter == "G" and number == 92:
            every = not said and self.firmware == "klipper"
            for axis, key in enumerate((b"X", b"Y", b"Z", b"E")):
                if key in said or every:
                    factor = now.flow if axis == E else 1.0
                    now.base[axis] = now.place[axis] - said.get(key, 0.0) * now.unit * factor
        elif letter == "M":
            self._of_machine(number, said)

    def _of_machine(self, number: int, said: dict[bytes, float]) -> None:
        now = self.now
        if number in (82, 83):
            now.absolute_e = number == 82
        elif number == 220 and b"S" in said:
            now.feed *= said[b"S"] / 100.0 / now.feed_factor
            now.feed_factor = said[b"S"] / 100.0
        elif number == 221 and said.get(b"S", 0.0) > 0.0:
            flow = said[b"S"] / 100.0
            now.base[E] = now.place[E] - (now.place[E] - now.base[E]) / now.flow * flow
            now.flow = flow
        elif number in (201, 203, 204, 205, 566):
            self._limits(number, said)

    def _limits(self, number: int, said: dict[bytes, float]) -> None:
        old, klipper = self.now.limits, self.firmware == "klipper"
        axes = [said[key] for key in (b"X", b"Y") if key in said]
        minutes = 60.0 if self.firmware == "reprapfirmware" else 1.0
        if number == 204 and klipper:
            given = [said[b"S"]] if b"S" in said else [said[key] for key in (b"P", b"T") if key in said]
            if given and min(given) > 0.0:
                self.now.limits = replace(old, acceleration=min(given))
        elif number == 204:
            printing = said.get(b"P", said.get(b"S", old.acceleration))
            self.now.limits = replace(
                old, acceleration=printing, travel_acceleration=said.get(b"T", said.get(b"S", old.travel_acceleration))
            )
        elif axes and min(axes) > 0.0 and not klipper:
            if number == 201:
                self.now.limits = replace(old, most_acceleration=min(axes))
            elif number == 203:
                self.now.limits = replace(old, velocity=min(axes) / minutes)
            elif number == (566 if minutes > 1.0 else 205):
                self.now.limits = replace(old, corner_velocity=min(axes) / minutes)

    def _named(self, name: bytes, code: bytes) -> None:
        now, old = self.now, self.now.limits
        said = {key.upper(): value for key, value in _PARAMETER.findall(code)}
        if name == b"SET_VELOCITY_LIMIT":

            def number(key: bytes, otherwise: float) -> float:
                return float(said[key]) if key in said else otherwise

            acceleration = number(b"ACCEL", old.acceleration)
            ratio = number(b"MINIMUM_CRUISE_RATIO", old.cruise_ratio)
            corner = number(b"SQUARE_CORNER_VELOCITY", old.corner_velocity)
            now.limits = Limits(number(b"VELOCITY", old.velocity), acceleration, corner, ratio)
        elif name == b"SAVE_GCODE_STATE":
            self.kept[code.partition(b"NAME=")[2].split(b" ")[0].strip()] = _copy(now)
            self.rest = True
        elif name == b"RESTORE_GCODE_STATE":
            kept = self.kept.get(code.partition(b"NAME=")[2].split(b" ")[0].strip())
            if kept:
                again = _copy(kept)
                again.place, again.limits, again.named = now.place, now.limits, now.named
                again.base[E] = now.place[E] - (kept.place[E] - kept.base[E])
                self.now = again
            self.rest = True
        elif name not in _NO_REST:
            self.rest = True


def _copy(state: State) -> State:
    return State(
        state.limits,
        list(state.place),
        list(state.base),
        state.absolute,
        state.absolute_e,
        state.unit,
        state.feed,
        state.feed_factor,
        state.flow,
        list(state.named),
        state.mode,
    )


def _arc(
    start: list[float], end: list[float], said: dict[bytes, float], unit: float, clockwise: bool
) -> list[list[float]]:
    """Chords of an arc in the plane of X and Y, whose radius is that of its start; the last one goes to its end."""
    dx, dy = end[X] - start[X], end[Y] - start[Y]
    if b"R" in said:
        radius, chord = said[b"R"] * unit, math.hypot(dx, dy)
        away = math.sqrt(max(radius**2 - chord**2 / 4.0, 0.0)) / max(chord, 1e-9)
        side = -away if clockwise != (radius < 0.0) else away
        i, j = dx / 2.0 - dy * side, dy / 2.0 + dx * side
    else:
        i, j = said.get(b"I", 0.0) * unit, said.get(b"J", 0.0) * unit
    cx, cy, radius = start[X] + i, start[Y] + j, math.hypot(i, j)
    if radius < 1e-6:
        return [end]
    begin = math.atan2(-j, -i)
    turn = math.atan2(end[Y] - cy, end[X] - cx) - begin
    if clockwise:
        turn = turn - 2.0 * math.pi if turn > -1e-9 and abs(turn) > 1e-9 else turn
        turn = -2.0 * math.pi if abs(turn) <= 1e-9 else turn
    else:
        turn = turn + 2.0 * math.pi if turn < 1e-9 and abs(turn) > 1e-9 else turn
        turn = 2.0 * math.pi if abs(turn) <= 1e-9 else turn
    step = 2.0 * math.acos(max(1.0 - ARC_MM / radius, -1.0))
    count = max(math.ceil(abs(turn) / max(step, 1e-3)), 1)
    last = math.hypot(end[X] - cx, end[Y] - cy)
    last = last if abs(last - radius) <= ROUNDED_MM else radius
    points = []
    for k in range(1, count):
        share = k / count
        angle, r = begin + turn * share, radius + (last - radius) * share
        others = [a + (b - a) * share for a, b in zip(start[Z:], end[Z:], strict=True)]
        points.append([cx + r * math.cos(angle), cy + r * math.sin(angle), *others])
    return [*points, end]
