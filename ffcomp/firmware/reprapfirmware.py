"""RepRapFirmware's plan, by its documentation: each axis and the filament have limits and jumps of speed of their own.

    speed          F, and M203 of each axis by its share of the path
    acceleration   M201 likewise; where X or Y moves also M204 P (extruding) or T (travel)
    corner         the lower top speed of both moves, with no axis jump above M566: |u - u'| v <= jerk; a
                   stop where only one of both extrudes, or only one moves X or Y, unless M566 P1 allows jumps there
    look-ahead     as many moves as the queue holds (M595); the last one ends at rest

u is the direction of a move, mm of X Y Z E per mm of path. Along X and Y a delta keeps to the lower of both axes'
limits in every direction, and CoreXY to those that keep each motor within its own. This was not compared with the
firmware itself; the assumptions are in docs/explanation/firmware_planners.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from math import ceil

import numpy as np
from numpy.typing import NDArray

from ffcomp.firmware import marlin_queue as q
from ffcomp.firmware.base import AxisLimits, Firmware, Planner
from ffcomp.firmware.settings_in_force import SettingsInForce, assumed_sentence, own_row
from ffcomp.planner.limits import lines_of
from ffcomp.planner.lookahead import phases_from_corners, timed
from ffcomp.planner.trajectory import Trajectory
from gcode.dialect import REPRAPFIRMWARE
from gcode.program import Moves, Program
from models.arrays import BoolArray, FloatArray, IntArray
from models.compiled import kernel
from models.kinematics.delta import DeltaKinematics
from models.machine import Machine, RepRapFirmwareSettings

Singles = NDArray[np.float32]
FASTEST_HZ, SLOWEST_HZ = 1600.0, 1300.0  # of the accelerometers that it knows, at the usual settings
SLOWEST_MM_PER_S = 0.5  # of any move, unless the file's M203 I says otherwise
_AXES, _TOWERS, _BELTS = range(3)  # how X and Y share their limits


def reprapfirmware_settings(machine: Machine) -> RepRapFirmwareSettings:
    """Return the planner's settings, by the machine's limits where its file states none."""
    return machine.reprapfirmware or RepRapFirmwareSettings.within(
        machine.limits, isinstance(machine.kinematics, DeltaKinematics)
    )


def settings_row(machine: Machine) -> FloatArray:
    """Return a machine's own settings as one row of numbers, (COLUMNS,)."""
    s = reprapfirmware_settings(machine)
    row = own_row(s)
    row[q.DEVIATION], row[q.LEAST], row[q.POLICY] = -1.0, SLOWEST_MM_PER_S, s.jerk_policy
    return row


class RepRapFirmware(Firmware):
    """Plans lines of mm within limits of each axis, as far as its queue holds; executes segments exactly."""

    flavor = REPRAPFIRMWARE
    usual_chips = ("0",)
    corrections_off = ("G29 S2",)
    corrections_on = ("G29 S1",)
    shaper_kept = (
        "var ffcompShaper = move.shaping.type",
        "var ffcompFrequency = move.shaping.frequency",
        "var ffcompDamping = move.shaping.damping",
    )
    shaper_back = ("M593 P{var.ffcompShaper} F{var.ffcompFrequency} S{var.ffcompDamping}",)
    restores = (
        "The file puts back limits, shaper and mesh at the end. When the run is cancelled, cancel.g must: "
        'M98 P"config.g" and G29 S1 in it, or a reset.'
    )

    def capture(self, chips: Sequence[str], name: str, lasting_s: float) -> tuple[list[str], list[str]]:
        """Return M956 for each chip; it ends when it has all samples, later the slower the chip."""
        start = [f'M956 P{chip} S{ceil(lasting_s * FASTEST_HZ)} A0 F"{name}.csv"' for chip in chips]
        return start, [f"G4 P{ceil(1e3 * lasting_s * (FASTEST_HZ / SLOWEST_HZ - 1.0)) + 200}"]

    def planner(self, program: Program, machine: Machine, within: bool = False) -> Planner:
        """Return the planner with the settings in force at each line of a program."""
        in_force = SettingsInForce.of(program, machine, settings_row(machine))
        queue = reprapfirmware_settings(machine).queue_moves
        return partial(plan_by_axes, in_force=in_force, sharing=sharing_of(machine), queue=queue)

    def assumed(self, machine: Machine) -> str:
        """Say which settings are assumed."""
        stated = () if machine.reprapfirmware is None else machine.reprapfirmware.stated
        matter = ("acceleration_mm_per_s2", "speed_mm_per_s", "jerk_mm_per_s")
        return assumed_sentence("RepRapFirmware", stated, matter, "config.g")

    def own_limits(self, machine: Machine) -> AxisLimits:
        """Return the planner's settings."""
        return AxisLimits.of(reprapfirmware_settings(machine))


def sharing_of(machine: Machine) -> int:
    """Return how X and Y share their limits on this machine."""
    if isinstance(machine.kinematics, DeltaKinematics):
        return _TOWERS
    return _BELTS if machine.kinematics.shares_motors else _AXES


def plan_by_axes(
    moves: Moves,
    *,
    stop_before: BoolArray,
    wait_before: FloatArray,
    start_t: float = 0.0,
    in_force: SettingsInForce,
    sharing: int,
    queue: int,
) -> Trajectory:
    """Plan moves from rest to rest; other parameters as of `lookahead.plan_moves`.

    in_force : the settings at each line;  sharing : of X and Y, `sharing_of`;  queue : lines that are in sight
    """
    lines, settings, rests = lines_of(moves), in_force.at(moves), stop_before | (wait_before > 0.0)
    top, acceleration = _bounds(lines.direction, lines.length, moves.speed, settings, sharing)
    kept, corner = _corners(lines.direction, lines.length, top, settings, rests)
    in_sight = _in_sight(corner, 2.0 * lines.length[kept] * acceleration[kept], queue)
    phases = phases_from_corners(kept, in_sight, lines.length, top, acceleration, acceleration)
    return timed(moves, lines, phases, wait_before, start_t)


@kernel
def _bounds(
    direction: FloatArray, length: FloatArray, speed: FloatArray, settings: Singles, sharing: int
) -> tuple[FloatArray, FloatArray]:
    """Return the top speed and the acceleration of each line, (n,) mm/s and mm/s²."""
    n = len(speed)
    top, acceleration = np.empty(n), np.full(n, np.inf)
    for i in range(n):
        u, s = direction[i], settings[i]
        top[i] = max(speed[i], s[q.LEAST])
        if length[i] == 0.0:
            continue
        top[i] = min(top[i], _most(u, s, q.SPEED.start, sharing))
        acceleration[i] = _most(u, s, q.ACCELERATION.start, sharing)
        if u[0] != 0.0 or u[1] != 0.0:
            acceleration[i] = min(acceleration[i], s[q.PRINT] if u[3] > 0.0 else s[q.TRAVEL])
        acceleration[i] *= s[q.SCALE]
    return top, acceleration


@kernel
def _most(u: FloatArray, s: Singles, first: int, sharing: int) -> float:
    """Return what all axes allow along a direction: four limits stand from a column of the settings on."""
    x, y = abs(u[0]), abs(u[1])
    share = max(abs(u[2]) / s[first + 2], abs(u[3]) / s[first + 3])
    if sharing == _TOWERS:
        share = max(share, np.sqrt(x * x + y * y) / min(s[first], s[first + 1]))
    elif sharing == _BELTS:
        share = max(share, x / s[first] + y / s[first + 1])
    else:
        share = max(share, x / s[first], y / s[first + 1])
    return 1.0 / share


@kernel
def _corners(
    direction: FloatArray, length: FloatArray, top: FloatArray, settings: Singles, rests: BoolArray
) -> tuple[IntArray, FloatArray]:
    """Return the lines with a length, (m,), and the highest v² at their starts, (m,)."""
    kept, corner = np.empty(len(length), dtype=np.int64), np.zeros(len(length))
    m, last, stops = 0, 0, True
    for i in range(len(length)):
        stops |= rests[i]
        if length[i] == 0.0:
            continue
        u, before = direction[i], direction[last]
        aside, was_aside = u[0] != 0.0 or u[1] != 0.0, before[0] != 0.0 or before[1] != 0.0
        alike = aside == was_aside and (aside and u[3] > 0.0) == (was_aside and before[3] > 0.0)
        if not stops and (alike or settings[i, q.POLICY] > 0.0):
            v = min(top[i], top[last])
            for k in range(4):
                jump = abs(u[k] - before[k])
                if jump * v > settings[i, q.JERK.start + k]:
                    v = settings[i, q.JERK.start + k] / jump
            corner[m] = v * v
        kept[m] = i
        m, last, stops = m + 1, i, False
    return kept[:m], corner[:m]


@kernel
def _in_sight(corner: FloatArray, gain: FloatArray, queue: int) -> FloatArray:
    """Lower each v² at the start of a line to what the queue behind it lets it brake from."""
    n = len(corner)
    out = np.empty(n)
    for i in range(n):
        v2 = 0.0
        for j in range(min(i + queue, n) - 1, i - 1, -1):
            v2 = min(corner[j], v2 + gain[j])
        out[i] = v2
    return out
