"""A compensated file through the real Kalico host, on a printer of its own kinematics, compared with the file's feeds.

Late
    A segment that takes the host more than `LATE` longer than its way over its feed.
Unplanned stop
    The host rests between two segments of one motion that go on in nearly the same direction (within 60 degrees), or
    lets time pass between them, although no line between them requires it.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from validation.independent import reader
from validation.independent.checks import OURS, Printer, printer_of
from validation.independent.clock import times
from validation.independent.reader import Moves
from validation.kalico import kalico_moves

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

LATE = 0.01  # of a segment's time
STILL = 0.01  # of the slower of two segments' speeds
ONWARDS = 0.5  # cosine
PAUSE_S = 1e-6
ROOM_MM = 500.0  # beyond the printer's own: the host shall plan, not refuse
_KNOWN = re.compile(
    rb"\s*(?:G0*[0-4]|G9[0-2]|M8[23]|M204|M22[01]\s+S[\d.]+|SET_VELOCITY_LIMIT|SAVE_GCODE_STATE|RESTORE_GCODE_STATE)"
    rb"(?![\d.])",
    re.IGNORECASE,
)

_STEPPER = """
[stepper_{name}]
step_pin: gpio{pin}1
dir_pin: gpio{pin}2
enable_pin: !gpio{pin}3
endstop_pin: gpio{pin}4
microsteps: 16
rotation_distance: {turn}
{more}
"""
_REST = """
[printer]
kinematics: {kind}
max_velocity: {velocity}
max_accel: {acceleration}
square_corner_velocity: {corner}
{more}

[mcu]
serial: /dev/null

[force_move]
enable_force_move: True

[gcode_arcs]

[extruder]
nozzle_diameter: 0.4
filament_diameter: 1.75
heater_pin: gpio44
sensor_type: EPCOS 100K B57560G104F
sensor_pin: analog0
control: watermark
min_temp: 0
max_temp: 300
min_extrude_temp: 0
max_extrude_cross_section: 50
max_extrude_only_distance: 1000
"""


def config_of(machine: dict[str, Any]) -> str:
    """Write a printer.cfg for a machine file's tables: its kinematics, its limits, and room for every print."""
    kinematics, limits = machine["kinematics"], machine["limits"]
    kind, steppers = kinematics["type"], list[str]()
    delta = kind == "delta"
    for pin, name in (("", "a"), ("1", "b"), ("2", "c")) if delta else (("", "x"), ("1", "y"), ("2", "z")):
        if not delta:
            low, high = kinematics[f"{name}_range_mm"]
            more = f"position_min: {low - ROOM_MM}\nposition_max: {high + ROOM_MM}\nposition_endstop: {low - ROOM_MM}"
        else:
            more = f"arm_length: {kinematics['arm_length_mm']}"
            more += "\nhoming_speed: 50\nposition_endstop: 600" if name == "a" else ""
        steppers.append(_STEPPER.format(name=name, pin=pin, turn=8 if name == "z" else 40, more=more))
    more = "".join(
        f"max_z_{ours}: {limits[key]}\n"
        for ours, key in (("velocity", "z_velocity_mm_per_s"), ("accel", "z_acceleration_mm_per_s2"))
        if key in limits
    )
    if delta:
        more += f"delta_radius: {kinematics['delta_radius_mm']}\nminimum_z_position: -5\n"
    rest = _REST.format(
        kind=kind,
        velocity=limits["velocity_mm_per_s"],
        acceleration=limits["acceleration_mm_per_s2"],
        corner=limits.get("square_corner_velocity_mm_per_s", 5.0),
        more=more,
    )
    return "".join(steppers) + rest


def judged(text: bytes, machine: dict[str, Any], relative_e: bool = False) -> dict[str, float | int | None]:
    """Plan a compensated file with the host, and look for what is late and where it stops."""
    printer = printer_of(machine)
    known = b"".join(line for line in text.splitlines(keepends=True) if _KNOWN.match(line))
    host = kalico_moves(config_of(machine), (b"M83\n" if relative_e else b"") + known)
    written = reader.read(text, printer.limits, relative_e=relative_e)
    clock = times(written, printer.own)
    travels = np.flatnonzero(np.linalg.norm(written.step[:, :3], axis=1) > 1e-9)
    found: dict[str, float | int | None] = {"moves": len(host), "total_s": None, "late_percent": None}
    found |= {"late_s": None, "stops": None}
    first = _same_from(host, written, travels)
    if first is None:
        return found
    which, host = travels[-len(host) :][first:], host[first:]
    # before the first move that both have, a printer comes from where it was: only our clock has that, from the origin
    nowhere = float(clock.lasts_s[travels[~written.known[travels]]].sum())
    lasts = host[:, 1:4].sum(axis=1)
    found["total_s"] = float(clock.begin_s[which[0]]) - nowhere + float(host[-1, 0] + lasts[-1] - host[0, 0])
    return found | late_and_stops(text, written, printer, which, host)


def _same_from(host: FloatArray, written: Moves, travels: IntArray) -> int | None:
    """From which of the host's moves on they are those of our reader; None: never."""
    if len(travels) < len(host):
        return None
    starts = written.start[travels[-len(host) :], :3]
    other = np.flatnonzero(np.abs(starts - host[:, 4:7]).max(axis=1) > 1e-4)
    first = int(other[-1]) + 1 if len(other) else 0
    return first if first < 0.1 * len(host) else None


def late_and_stops(
    text: bytes, written: Moves, printer: Printer, which: IntArray, host: FloatArray
) -> dict[str, float | int | None]:
    """Compare the host's moves (m, 13) with the file's moves `which` (m,), where they are segments."""
    lines = text.split(b"\n")
    segment = _segments(lines)[written.line[which]]
    length = np.linalg.norm(written.step[which, :3], axis=1)
    asked = length / np.minimum(written.feed[which], written.limits[which, 0])
    lasts = host[:, 1:4].sum(axis=1)
    over = np.where(segment, lasts - asked, 0.0)
    late = over > LATE * asked
    # between two segments that follow each other in the file
    on = (
        segment[:-1] & segment[1:] & (np.diff(which) == 1) & ~written.rest[which[1:]] & (written.wait_s[which[1:]] == 0)
    )
    ahead = np.einsum("ij,ij->i", host[:-1, 7:10], host[1:, 7:10]) > ONWARDS
    speed = np.minimum(length[:-1] / asked[:-1], length[1:] / asked[1:])
    rests = on & ahead & (host[1:, 10] < STILL * speed) & ~_begins(lines, written.line[which[1:]])
    waits = on & (host[1:, 0] - host[:-1, 0] - lasts[:-1] > PAUSE_S) & ~_begins(lines, written.line[which[1:]])
    return {
        "segments": int(segment.sum()),
        "late_percent": 100.0 * float(late.sum() / max(segment.sum(), 1)),
        "late_s": float(over[late].sum()),
        "stops": int((rests | waits).sum()),
    }


def _segments(lines: list[bytes]) -> BoolArray:
    """Which lines are segments: in a block of ours, which a line of ours opens and the feed that it gives back ends."""
    found, inside = np.zeros(len(lines), dtype=np.bool_), False
    for number, line in enumerate(lines):
        if line.rstrip().endswith(OURS):
            inside = (inside or not line.startswith(b"G")) and not line.startswith(b"G1 F")
        elif inside and line.startswith(b"G1 "):
            found[number] = True
    return found


def _begins(lines: list[bytes], number: IntArray) -> BoolArray:
    """Whether a motion begins between each of these lines (k,) and the move before it."""
    begun, last = np.zeros(len(number), dtype=np.bool_), -1
    marks = np.cumsum([line.startswith(b";section ") for line in lines])
    for k, at in enumerate(number.tolist()):
        begun[k] = last >= 0 and marks[at] > marks[last]
        last = at
    return begun
