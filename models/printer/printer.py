"""Simulate the motion of the nonlinear printer under commanded carriage heights.

A delta has full kinematics with J̇ q̇, gravity, drives, belts, guides, arms with mass at their ends and along them, and
the extruder on its mount; straight axes have their modes. Both have all effects of `models/effects` that the machine
lists. The equations are in `models/printer/kernels`, of straight axes in `axes.py` there.

Lengths mm, velocities mm/s, accelerations m/s² (as accelerometers are read), time s.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Any, Literal

import numpy as np

from models.arrays import BoolArray, FloatArray
from models.effects.effect import Signals
from models.errors import UnreachableError
from models.machine import Machine
from models.printer.kernels.axes import BELT_DAMPING, FREQUENCY2, SHARE, lanes_of_axes
from models.printer.kernels.friction import RELAXED
from models.printer.kernels.integrate import integrate
from models.printer.kernels.integrate_axes import integrate_axes
from models.printer.kernels.motors import cubic_spline
from models.printer.kernels.record import LANES, PrinterParameters, active_effects, lanes, parameter_table
from models.printer.parameters import ConvertedPrinter, converted_printer
from models.printer.rest import axes_at_rest, deltas_at_rest

SMOOTH_STEP_S = 1 / 6400  # a quarter of a nanometre on a violent motion
KINKED_STEP_S = 1 / 12800  # with backlash or dry friction; with strong friction down to
FINEST_STEP_S = 1 / 25600
SPLINE_ROWS = 24  # a cubic spline forgets a row's neighbours by 0.27 a row: 1e-14 after these

WELL_FOLLOWED, RESOLVED = 0.6, 2.5  # step x the fastest mode's ω; step x a rigid axis' pole, below 2.78

# friction / (speed x inertia) x step; guides and joints together below 2.78, where a Runge-Kutta step of order 4 grows
GUIDE_STIFFNESS, JOINT_STIFFNESS = 1.9, 0.8
BORDER_MM = 1e-6
KEPT_SPLINES = 64  # commands, and sets of commands, whose cubics are held


Hold = Literal["cubic", "linear"]


@dataclass(frozen=True, eq=False)
class PrinterState:
    """The state at the end of a simulation, to continue from."""

    t_s: float
    values: FloatArray  # SI: (30,), see `kernels.record`; of straight axes (rows, 3), see `kernels.axes`
    history: FloatArray  # (k, 3) mm, the command's last rows, the border row among them


@dataclass(frozen=True, eq=False)
class PrinterMotion:
    """Motion at the n rows of a command. Accelerations are second derivatives of position: zero at rest."""

    t_s: FloatArray  # (n,)
    carriage_mm: FloatArray  # (n, 3) columns A B C
    carriage_acceleration: FloatArray  # (n, 3) m/s²
    nozzle_mm: FloatArray  # (n, 3) columns X Y Z, relative to the bed
    nozzle_acceleration: FloatArray  # (n, 3) m/s², relative to the ground: includes the frame's
    motor_mm: FloatArray  # (n, 3) position of the motor's end of each belt
    state: PrinterState

    @property
    def signals(self) -> Signals:
        """Sensor signals of ideal accelerometers."""
        return Signals(self.t_s, self.carriage_acceleration, self.nozzle_acceleration)


def simulate_printer(
    machine: Machine,
    command: FloatArray,
    dt_s: float,
    *,
    start: PrinterState | None = None,
    substeps: int | None = None,
    gravity: bool = True,
    hold: Hold = "cubic",
    ahead: FloatArray | None = None,
) -> PrinterMotion:
    """Simulate a printer under a command, with all effects of `machine.effects` except those of the sensors.

    command : (n, 3) mm, columns A B C: commanded carriage heights every `dt_s`, from the inverse kinematics of the
        machine's own, nominal geometry (an `arm_geometry` effect is not known to the firmware). Before the first
        row, the printer rests under it.
    start : the `state` of the chunk before, whose last row is this chunk's first. None: from rest.
    substeps : integration steps from row to row. None: from `longest_step`.
    hold : how the command runs between rows: "cubic" spline, or "linear" for executed straight segments.
    ahead : (k, 3) mm, rows of the command that follow this chunk. A cubic spline needs some 20 of them to run over
        the border without an error.

    Raises ValueError if the command has another shape, or the effects are not complete; UnreachableError if the motion
    leaves the arms' reach; its indices are rows of the command.
    """
    starts, printers = None if start is None else [start], [converted_printer(machine, gravity=gravity)]
    (motion,) = simulate_printers(printers, [command], dt_s, starts=starts, substeps=substeps, hold=hold, ahead=ahead)
    return played(motion)


def played(motion: PrinterMotion | ValueError) -> PrinterMotion:
    """Return a motion of `simulate_printers`, or raise its error."""
    if isinstance(motion, ValueError):
        raise motion
    return motion


def simulate_printers(
    printers: Sequence[ConvertedPrinter],
    commands: Sequence[FloatArray],
    dt_s: float,
    *,
    starts: Sequence[PrinterState] | None = None,
    substeps: int | None = None,
    hold: Hold = "cubic",
    ahead: FloatArray | None = None,
    splines: Splines | None = None,
) -> list[PrinterMotion | ValueError]:
    """Simulate the i-th printer under the i-th command, up to LANES of them at once.

    `starts` and `ahead` are those of `simulate_printer`; `ahead` follows every command. `splines` are those of earlier
    calls under the same arrays of commands. Each gives what `simulate_printer` gives, whatever the others do; where
    that would raise, its ValueError or UnreachableError stands in the list instead. Those with as many steps from row
    to row go together, best when their commands are of one length.
    """
    motions: dict[int, PrinterMotion | ValueError] = {}
    tasks: dict[int, _Task] = {}
    splines = Splines() if splines is None else splines
    commands = list(commands)  # indexing an array of them would make a new object each time
    ready: dict[int, _Ready] = {}  # of each printer, which may run under several commands
    for i, (printer, command) in enumerate(zip(printers, commands, strict=True)):
        try:
            start = None if starts is None else starts[i]
            _check(command, dt_s, start)
            if id(printer) not in ready:
                ready[id(printer)] = _ready(printer, dt_s, substeps)
            prepared, coming = ready[id(printer)], command[:0] if ahead is None else ahead
            cubics = splines.of(command, coming, start, prepared.motors, dt_s, hold)
            tasks[i] = _task(command, cubics, prepared, start)
        except ValueError as error:
            motions[i] = error
    resting = {i: task for i, task in tasks.items() if len(task.values) == 0}
    begins = np.array([1e3 * task.cubics[0, :, 3] for task in resting.values()]).reshape(-1, 3)
    states = deltas_at_rest([task.printer.converted for task in resting.values()], begins)
    for i, state in zip(resting, states, strict=True):
        if isinstance(state, ValueError):
            motions[i] = state
            del tasks[i]
        else:
            tasks[i] = replace(tasks[i], values=state)
    for together in _batches(tasks):
        motions |= zip(together, _simulate([tasks[i] for i in together], dt_s, splines), strict=True)
    return [motions[i] for i in range(len(printers))]


class Splines:
    """Cubics of commands, computed once for all printers under one command; those of the last few are kept."""

    def __init__(self) -> None:
        self._cubics: dict[tuple[object, ...], tuple[FloatArray, FloatArray]] = {}
        self._joined: dict[tuple[int, ...], tuple[tuple[FloatArray, ...], FloatArray]] = {}

    def of(
        self,
        command: FloatArray,
        ahead: FloatArray,
        start: PrinterState | None,
        motors: FloatArray | None,
        dt_s: float,
        hold: Hold,
    ) -> FloatArray:
        """Return the cubics (n, 3, 4) of a command, of its motors where they are not those of the axes."""
        history = b"" if start is None else start.history.tobytes()
        key = (id(command), history, b"" if motors is None else motors.tobytes(), dt_s, hold)
        if key not in self._cubics:
            rows = command if start is None else np.concatenate([start.history[:-1], command])
            if motors is not None:
                rows, ahead = rows @ motors.T, ahead @ motors.T
            _forget(self._cubics)
            self._cubics[key] = command, HOLDS[hold](rows, ahead, dt_s)  # held, the command keeps its id
        return self._cubics[key][1]

    def joined(self, parts: Sequence[FloatArray]) -> FloatArray:
        """Return cubics of several commands one after the other."""
        key = tuple(map(id, parts))
        if key not in self._joined:
            _forget(self._joined)
            self._joined[key] = tuple(parts), np.concatenate(parts) if len(parts) > 1 else parts[0]
        return self._joined[key][1]


def _forget(kept: dict[Any, Any]) -> None:
    for old in list(kept)[: 1 - KEPT_SPLINES]:
        kept.pop(old, None)


@dataclass(frozen=True, eq=False)
class _Ready:
    """A converted printer, limited to what the integration steps can resolve."""

    converted: ConvertedPrinter
    motors: FloatArray | None  # (3, 3) from axes to motors; None where each axis has its own, and of a delta
    steps: int  # from row to row
    kept: int  # rows of the command that a simulation may be continued with


def _ready(printer: ConvertedPrinter, dt_s: float, substeps: int | None) -> _Ready:
    p, modes, kinematics = printer
    steps = substeps or math.ceil(dt_s / longest_step(p, modes) * (1 - 1e-9))
    limited = ConvertedPrinter(_limit_stiffness(p, dt_s / steps), _limit_rigidity(modes, dt_s / steps), kinematics)
    own = len(modes) == 0 or np.array_equal(p.motor_matrix, np.eye(3))
    kept = math.ceil(float(np.max(p.delay)) / dt_s) + SPLINE_ROWS + 1
    return _Ready(limited, None if own else p.motor_matrix, steps, kept)


@dataclass(frozen=True, eq=False)
class _Task:
    """One simulation, ready for a lane."""

    printer: _Ready
    cubics: FloatArray  # (n, 3, 4), see `kernels.motors.Commands`
    first: int  # first row of the command
    begin_s: float
    values: FloatArray  # state there, see `PrinterState`; empty of a delta at rest
    history: FloatArray  # (k, 3) mm, see `PrinterState`


def _task(command: FloatArray, cubics: FloatArray, printer: _Ready, start: PrinterState | None) -> _Task:
    """Prepare the simulation of a printer under a command : (n, 3) mm with its cubics."""
    if start is None:
        modes = printer.converted.modes
        values = axes_at_rest(modes, command[0] / 1e3) if len(modes) else np.empty(0)
        return _Task(printer, cubics, 0, 0.0, values, command[-printer.kept :].copy())
    history = np.concatenate([start.history[:-1], command])[-printer.kept :]
    return _Task(printer, cubics, len(start.history) - 1, start.t_s, start.values, history)


def _batches(tasks: Mapping[int, _Task]) -> Iterator[list[int]]:
    """Group tasks for the lanes: of as many modes, alike motors, steps and first row, and of about one length."""

    def kind(i: int) -> tuple[int, bytes, int, int]:
        printer = tasks[i].printer
        motors = b"" if printer.motors is None else printer.motors.tobytes()
        return len(printer.converted.modes), motors, printer.steps, tasks[i].first

    for _, group in groupby(sorted(tasks, key=lambda i: (kind(i), len(tasks[i].cubics))), kind):
        names = list(group)
        yield from (names[n : n + LANES] for n in range(0, len(names), LANES))


def _simulate(tasks: Sequence[_Task], dt_s: float, splines: Splines) -> list[PrinterMotion | UnreachableError]:
    """Simulate at most LANES tasks with the same number of steps and the same first row."""
    printers, values = [task.printer.converted for task in tasks], np.array([task.values for task in tasks])
    parameters = parameter_table([printer.parameters for printer in printers])
    commands = {id(task.cubics): task.cubics for task in tasks}
    ends = dict(zip(commands, np.cumsum([len(cubics) for cubics in commands.values()]), strict=True))
    ranges = [(ends[id(task.cubics)] - len(task.cubics), ends[id(task.cubics)]) for task in tasks]
    first, steps = tasks[0].first, tasks[0].printer.steps
    cubics = splines.joined(list(commands.values()))
    how = active_effects(parameters), cubics, np.array(ranges, dtype=np.int64), first, dt_s, steps
    if len(printers[0].modes):
        modes = np.array([printer.modes for printer in printers])
        m = lanes_of_axes(values, modes, parameters).ravel()
        samples = integrate_axes(m, values, (0.0,) * modes.shape[1], *how)
    else:
        samples = integrate(lanes(values, parameters).ravel(), values, *how)
    each = zip(tasks, zip(*samples, strict=True), values, strict=True)
    return [_motion(task, lane, end, dt_s) for task, lane, end in each]


def longest_step(p: PrinterParameters, modes: FloatArray) -> float:
    """Return the longest stable step, s: shorter with backlash and dry friction."""
    friction = float(np.max(p.dry + p.sticking))
    swinging = modes[:, FREQUENCY2] * ~_is_rigid(modes) * (modes[:, SHARE] != 0.0)
    smooth = min(SMOOTH_STEP_S, WELL_FOLLOWED / math.sqrt(swinging.max())) if swinging.any() else SMOOTH_STEP_S
    if friction == p.joint_dry == np.max(p.half_backlash) == 0:
        return smooth
    creeping = np.where(p.bristles > 0.0, math.inf, p.creep)  # bristles are no stiffer than a belt
    gentle = float(np.min(creeping)) * GUIDE_STIFFNESS * p.least_inertia / max(friction, 1e-9)
    return float(np.clip(gentle, FINEST_STEP_S, min(KINKED_STEP_S, smooth)))


def _limit_stiffness(p: PrinterParameters, step_s: float) -> PrinterParameters:
    """Widen the reversal of dry friction, given by its creep speed or its bristles, to what the step can resolve."""
    friction, joints = p.dry + p.sticking, p.joint_dry
    if not friction.any() and joints == 0.0:
        return p
    wider = p.copy()
    wider.creep = np.maximum(p.creep, friction * step_s / (GUIDE_STIFFNESS * p.least_inertia))
    stiffest = p.least_inertia * (WELL_FOLLOWED / step_s) ** 2
    wider.bristles = np.minimum(p.bristles, stiffest / np.maximum(friction, 1e-9))
    wider.bending = np.full(3, RELAXED / step_s)
    wider.joint_creep = max(p.joint_creep, joints * step_s / (JOINT_STIFFNESS * p.holder_mass))
    return wider


def _is_rigid(modes: FloatArray) -> BoolArray:
    """Return which of the modes (n, 7, 3) stand for axes that do not vibrate: their belts alone overdamp them."""
    return np.asarray(modes[:, BELT_DAMPING] ** 2 > 3.0 * modes[:, FREQUENCY2])


def _limit_rigidity(modes: FloatArray, step_s: float) -> FloatArray:
    """Slow a rigid axis down to what the step can resolve, with the same damping ratio."""
    rigid = _is_rigid(modes)
    if not rigid.any():
        return modes
    slower = np.ones_like(modes[:, 0])
    omega, c = np.sqrt(modes[:, FREQUENCY2][rigid]), modes[:, BELT_DAMPING][rigid]
    quickest = np.maximum(0.5 * c + np.sqrt(np.maximum(0.25 * c**2 - omega**2, 0.0)), omega)
    slower[rigid] = np.minimum(RESOLVED / (quickest * step_s), 1.0)
    limited = modes.copy()
    limited[:, FREQUENCY2] *= slower**2
    limited[:, BELT_DAMPING] *= slower
    return limited


def _cubic(rows: FloatArray, ahead: FloatArray, dt_s: float) -> FloatArray:
    return cubic_spline(np.concatenate([rows, ahead]) / 1e3, dt_s)[: len(rows)]


def _linear(rows: FloatArray, ahead: FloatArray, dt_s: float) -> FloatArray:
    cubics = np.zeros((len(rows), 3, 4))
    cubics[:-1, :, 2] = np.diff(rows / 1e3, axis=0) / dt_s
    cubics[-1, :, 2] = cubics[-2, :, 2]
    cubics[:, :, 3] = rows / 1e3
    return cubics


# From rows : (n, 3) mm and those ahead to (n, 3, 4) of `kernels.motors.Commands`: a cubic of each interval, and a line
# that continues the last one.
HOLDS: Mapping[Hold, Callable[[FloatArray, FloatArray, float], FloatArray]] = {"cubic": _cubic, "linear": _linear}


def _check(command: FloatArray, dt_s: float, start: PrinterState | None) -> None:
    if command.ndim != 2 or command.shape[1] != 3 or len(command) < 2:
        raise ValueError(f"The command has shape {command.shape}; it must be (n, 3) with at least two rows.")
    if not np.all(np.isfinite(command)):
        row = int(np.argmin(np.isfinite(command).all(axis=1)))
        raise ValueError(f"Row {row} of the command is {command[row]} mm; every carriage height must be finite.")
    if not dt_s > 0:
        raise ValueError(f"The time from row to row is {dt_s} s; it must be greater than zero.")
    if start is not None and np.abs(command[0] - start.history[-1]).max() > BORDER_MM:
        rule = f"it must repeat the last row of the chunk before, {start.history[-1]} mm."
        raise ValueError(f"The first row of the command is {command[0]} mm; {rule}")


def _motion(
    task: _Task, samples: Sequence[FloatArray], values: FloatArray, dt_s: float
) -> PrinterMotion | UnreachableError:
    """Build the motion from samples : five of (n, 3), and values : (30,) the last state, SI, from the kernels."""
    lane = [each[: len(task.cubics) - task.first] for each in samples]
    t = task.begin_s + dt_s * np.arange(len(lane[0]), dtype=np.float64)
    if not math.isfinite(sum(float(each[-1].sum()) for each in lane)):  # NaN persists
        lost = np.flatnonzero(~np.isfinite(np.hstack(lane)).all(axis=1))
        rule = f"At t = {t[lost[0]]:.4f} s the simulated nozzle has left the reach of its arms."
        return UnreachableError(rule, lost)
    end = PrinterState(float(t[-1]), values, task.history)
    return PrinterMotion(t, lane[0], lane[1], lane[2], lane[3], lane[4], end)
