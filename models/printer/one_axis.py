"""Simulate a machine of one axis with its effects, and what its sensors would record."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from models.arrays import FloatArray
from models.effects.catalogue import CATALOGUE, effective_machine, effects_of, measured, terms_of
from models.effects.effect import Signals
from models.kinds import driven_axis
from models.machine import Machine
from models.printer.kernels.friction import RELAXED
from models.printer.kernels.motors import slopes
from models.printer.kernels.one_axis import NO_RIPPLES, AxisInput, AxisParameters, integrate_axis

LONGEST_STEP_S = 0.002
STEP_RAD = 0.25  # phase of the fastest mode per step
COARSE_STEP_RAD = 0.7  # for ranking effects: resonances are off by a thousandth
HARDENED = 2.0  # frequency factor of a hardening spring under a large motion
STEEPEST = 2.0  # the same, where a step can be no shorter: friction then falls with speed below that of one step
MOST_RAD = 1.0  # the same phase, where a step can be no shorter: bristles then bend further
STABLE = 1.5  # step times the decay rate by friction; the method is stable up to 2.8
MOST_SUBSTEPS = 60
MOST_FOR_FRICTION = 16  # of them for dry friction of what is light: more would resolve speeds far below its own
_NOTHING = np.empty(0)


@dataclass(frozen=True, eq=False)
class AxisMotion:
    """The motion of an axis, n samples."""

    t_s: FloatArray  # (n,)
    position_mm: FloatArray  # (n,) of the load; without one, of the mass
    motor_mm: FloatArray  # (n,) of the mass
    acceleration: FloatArray  # (n,) m/s², of the load; without one, of the mass
    speed: FloatArray  # (n,) mm/s, of the same
    force: FloatArray  # (n,) N, of the drive
    motor_acceleration: FloatArray  # (n,) m/s², of the mass
    steps: int = 0  # of the integration

    def sensed(self, machine: Machine) -> dict[str, FloatArray]:
        """Return what the sensors read, by the names of a recording's signals."""
        acceleration = self.acceleration[:, None] * [1.0, 0.0, 0.0]
        position = np.column_stack([self.position_mm, self.motor_mm])
        sensed = measured(machine, Signals(self.t_s, acceleration, acceleration, position))
        q, motor = sensed.position.T
        return {"pos_q": q, "pos_motor": motor, "acc_q": sensed.nozzle[:, 0], "vel_q": self.speed, "force": self.force}


def axis_effects(machine: Machine) -> tuple[str, ...]:
    """Return the effects that this axis may have; some need a spring or a commanded position."""
    axis = driven_axis(machine)
    has = {
        "spring": axis.last_stiffness > 0.0,
        "command": not axis.by_force,
        "freedom": axis.free or not axis.by_force,
        "turning": axis.unit != "mm",  # a file without a unit may have written 1 rad as 1 m
    }
    return tuple(name for name in effects_of(axis.moves) if has.get(CATALOGUE[name].needs, True))


def simulate_axis(
    machine: Machine,
    drive: FloatArray,
    dt_s: float,
    *,
    shot: int = 0,
    begin: FloatArray | None = None,
    substeps: int = 0,
    coarse: bool = False,
    supply_v: FloatArray | None = None,
    extra: FloatArray | None = None,
) -> AxisMotion:
    """Simulate an axis with its effects.

    drive : (n,) the input: N, A, V or a duty, linear between samples, or held (see the file); or mm of the
        commanded position, a cubic spline between them.
    shot : samples after which the motion restarts; 0: never.
    begin : (shots, 4) mm and mm/s of the last mass and of the first one at each beginning, NaN where one is not
        known; None: at rest where the input holds them.
    substeps : integration steps a sample; 0: automatic.
    coarse : automatic for ranking effects.
    supply_v : (n,) V, of a voltage or a duty; None: the file's.
    extra : (n,) N, known extra force; None: none.

    Raises ValueError if the motion diverges, or an effect is incomplete.
    """
    p, axis = axis_parameters(machine), driven_axis(machine)
    samples = np.ascontiguousarray(axis.force_of(drive, supply_v) if axis.by_force else 1e-3 * drive, float)
    held, extra_n = axis.by_force and axis.drive.hold == "steps", np.empty(0) if extra is None else extra
    return _integrated(p, samples, dt_s, shot, begin, substeps, coarse, held, extra_n)


def simulate_load(machine: Machine, motor_mm: FloatArray, dt_s: float, shot: int, begin: FloatArray) -> AxisMotion:
    """Simulate the load of an axis alone, on a coupling that a motor moves: as an axis that a position drives.

    motor_mm : (n,) mm, where the motor is: a cubic spline between samples.
    shot, begin : see `simulate_axis`; errors as there
    """
    axis = axis_parameters(machine)
    load = AxisParameters(axis.load, axis.coupling, drive_damping=axis.coupling_damping)
    if not axis.play_at_drive:
        load = load._replace(half_backlash=axis.half_backlash, landing=axis.landing)
    if not axis.hardens_at_drive:
        load = load._replace(cubic=axis.cubic, quintic=axis.quintic, peak_stretch=axis.peak_stretch)
    return _integrated(load, 1e-3 * motor_mm, dt_s, shot, begin)


def _integrated(
    p: AxisParameters,
    samples: FloatArray,
    dt_s: float,
    shot: int,
    begin: FloatArray | None,
    substeps: int = 0,
    coarse: bool = False,
    held: bool = False,
    extra: FloatArray = _NOTHING,
) -> AxisMotion:
    rest = 0.0 if p.by_force else float(samples[0])
    first = np.array([[rest, 0.0, rest, 0.0]]) if begin is None else 1e-3 * begin
    steps = substeps or substeps_of(p, dt_s, COARSE_STEP_RAD if coarse else STEP_RAD, load_of(p, samples))
    # a drive goes smoothly from order to order: a straight line between them would lose a percent of 100 Hz
    slope = np.empty(0) if p.by_force else slopes(np.diff(samples))
    inputs = AxisInput(np.ascontiguousarray(samples, float), slope, np.ascontiguousarray(extra, float), dt_s, held)
    resolved = p if shot == 1 else with_stable_friction(p, dt_s / steps)  # 1: it moves as measured
    out = integrate_axis(inputs, steps, shot or len(samples) + 1, np.ascontiguousarray(first), resolved)
    if not np.all(np.isfinite(out)):
        raise ValueError("With these numbers the motion of the axis diverges.")
    t = np.asarray(dt_s * np.arange(len(samples)), dtype=np.float64)
    motor, last, acceleration, speed, force, motor_acceleration = out.T
    return AxisMotion(
        t, 1e3 * last, 1e3 * motor, acceleration, 1e3 * speed, force, motor_acceleration, steps * len(samples)
    )


def load_of(p: AxisParameters, samples: FloatArray) -> float:
    """Return about the largest force, N, that friction by load grows with; 0 without such friction."""
    drive = float(np.abs(samples).max()) if p.by_force else p.stiffness * float(np.ptp(samples))
    held = p.held_share * (abs(p.weight_moment) + abs(p.ground) * float(np.ptp(samples)))
    return p.load_share * (min(drive, p.drive_limit) + held)


def with_stable_friction(p: AxisParameters, step_s: float) -> AxisParameters:
    """Return the parameters with friction that the step resolves: dry friction does not overshoot rest."""
    presliding = max(p.presliding, p.bristle_force * (step_s / MOST_RAD) ** 2 / p.mass)
    per_n = step_s / (STEEPEST * p.mass)
    creep = max(p.creep, per_n * (p.dry + p.sticking))
    return p._replace(creep=creep, creep_per_n=per_n, presliding=presliding, bending=RELAXED / step_s)


def substeps_of(p: AxisParameters, dt_s: float, step_rad: float = STEP_RAD, load_n: float = 0.0) -> int:
    """Return how many integration steps a sample needs."""
    least = min(p.mass, p.load or p.mass)
    omega = math.sqrt((p.stiffness + p.coupling + abs(p.weight_moment)) / least)
    rate = (p.damping + p.drive_damping + p.coupling_damping) / least
    if max(p.cubic, p.quintic) > 0.0:
        omega *= HARDENED
    if p.dry + p.sticking + load_n > 0.0:  # beyond, `with_stable_friction` lets it fall sooner
        rate += min((p.dry + p.sticking + load_n) / (p.creep * p.mass), STABLE * MOST_FOR_FRICTION / dt_s)
    if p.bristle_force > 0.0:
        omega = math.hypot(omega, math.sqrt(p.bristle_force / (p.presliding * p.mass)))
    longest = min(LONGEST_STEP_S, step_rad / max(omega, 1e-9), STABLE / max(rate, 1e-9))
    return min(max(1, math.ceil(dt_s / longest * (1 - 1e-9))), MOST_SUBSTEPS)


@lru_cache(maxsize=8)
def axis_parameters(machine: Machine) -> AxisParameters:
    """Return the kernel's numbers of an axis with its effects, SI."""
    effective = effective_machine(machine)
    terms = terms_of(effective, effective.vibration.printer_parameters(0.0))
    ripples = np.ascontiguousarray(terms.pop("ripples", NO_RIPPLES), float)
    numbers = {name: float(np.ravel(terms[name])[0]) for name in terms.keys() & set(AxisParameters._fields)}
    return AxisParameters(**numbers, ripples=ripples)
