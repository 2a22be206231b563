"""What printers of every kind can hide: effects of the catalogue in other shapes than a machine file's, and others.

`SHARED[name](kind, rng, size, real)` → (the table a machine file would have to hold, the printer with the effect). The
same seed with another `size` is the same effect, larger or smaller; with size zero nothing is hidden. No entry of the
catalogue is meant for `OUTSIDE`, whose table is empty: there a diagnosis must end in `unknown`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeAlias

import numpy as np
from numba import njit
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from validation.blind.real import (
    FloatArray,
    Hide,
    Order,
    Range,
    Reading,
    Real,
    Rng,
    Tables,
    read_at,
    sign,
    slowed,
    told,
)
from validation.plants.shapes import BREAKS, TANH

SLIP_S = 0.006
# Ranges that sizes are drawn from: of deltas, of straight axes, and of an axis that a force drives if it has its own.
# Forces are for each motor of a delta, and per kilogram elsewhere.
SIZES: Mapping[str, Sequence[Range]] = {
    "uneven": ((0.3, 1.7), (0.4, 1.6)),  # where motors differ, each is so many times the middle
    "friction": ((1.0, 4.0), (1.2, 4.0), (0.3, 1.5)),
    "stiction": ((0.8, 2.2), (1.2, 3.0), (0.4, 1.5)),
    "grease": ((8.0, 25.0), (12.0, 40.0), (2.0, 8.0)),
    "slope_per_m": ((0.7, 1.8), (1.0, 2.2)),
    "centre_mm": ((330, 430), (70, 130)),
    "play_mm": ((0.04, 0.12), (0.06, 0.16), (0.04, 0.12)),
    "stretch_m": ((2e-4, 4e-4), (2.5e-4, 6e-4), (0.6, 1.5)),  # at which a belt that hardens is half as stiff again
    "stepper_mm": ((0.35, 0.8), (0.5, 1.0)),
    "ripple_mm": ((0.004, 0.014), (0.005, 0.015)),
    "frame_kg": ((4.0, 14.0), (5.0, 15.0)),
    "frame_hz": ((10.0, 45.0), (10.0, 30.0)),
    # outside the catalogue
    "pulley_m": ((4e-5, 9e-5), (8e-5, 1.6e-4)),
    "pulley_share": ((0.15, 0.3), (0.2, 0.35)),
    "warm_share": ((0.15, 0.3), (0.2, 0.35)),
    "warm_s": ((0.8, 2.0), (0.6, 1.5)),
    "cable": ((0.1, 0.25), (0.1, 0.2)),  # kg, or a share of what `loads` has
    "fan": ((0.4, 1.2), (0.5, 1.5)),
    "notch": ((3.0, 8.0), (4.0, 10.0)),
}


@dataclass(frozen=True)
class Drawn:
    """How one kind of printer hides effects."""

    column: int  # of SIZES
    motors: int
    loads: Callable[[Real], FloatArray]  # (motors,), what a force of one is on each motor, N
    forces: Callable[..., Tables]  # of a printer and arrays (motors,) by key: a file's table of forces
    springs: Callable[[Real], FloatArray]  # (motors,) N/m
    stiffened: Callable[[Real, FloatArray], Real]  # by these shares, (motors,)
    of_belts: Callable[..., Tables]  # as `forces`, of the belts
    felt: tuple[float, ...]  # (6,): 1 where a sensor of carriages or nozzle is
    softens: float = 0.0  # share of the belts that harden which soften
    bends: bool = True  # whether dry friction may bend before it slides
    stretched: Callable[[Real], float] = lambda _: 1.0  # m, that `stretch_m` is in parts of

    def draw(self, rng: Rng, size: str, count: int | None = None) -> Any:
        """Draw a size, or some."""
        ranges = SIZES[size]
        return rng.uniform(*ranges[min(self.column, len(ranges) - 1)], count)

    def each(self, rng: Rng, value: float) -> FloatArray:
        """Draw the same for every motor, or as often as not different ones: (motors,)."""
        uneven = self.draw(rng, "uneven", self.motors)
        return np.asarray(value * (uneven if rng.random() < 0.35 else np.ones(self.motors)))

    def some(self, rng: Rng) -> FloatArray:
        """Draw one motor, or all: (motors,), ones and zeros."""
        return np.eye(self.motors)[rng.integers(self.motors)] if rng.random() < 0.5 else np.ones(self.motors)


Drawing: TypeAlias = Callable[[Drawn, Rng, float, Real], tuple[Tables, Real]]


def of_kind(drawings: Mapping[str, Drawing], kind: Drawn, lacking: str = "") -> dict[str, Hide]:
    """Return how one kind of printer hides each of these, but for what it lacks."""
    return {name: partial(hide, kind) for name, hide in drawings.items() if name not in lacking.split()}


def by_name(*hides: Any) -> dict[str, Any]:
    """Return functions that hide something by their names."""
    return {hide.__name__: hide for hide in hides}


# ---- friction ------------------------------------------------------------------------------------


def _dry(kind: Drawn, rng: Rng, force: FloatArray) -> dict[str, Any]:
    """Draw a tanh, or a bristle that bends for some µm before it slides, of any kind."""
    law = int(rng.integers(TANH, BREAKS + 1)) if kind.bends else TANH
    length, speed = rng.uniform(1.2e-5, 4e-5), rng.uniform(1e-3, 2e-3)
    return {"dry_kind": law, "dry_v": speed, **presliding(rng, force, law, length)}


def presliding(rng: Rng, force: FloatArray, kind: int, length: float) -> dict[str, Any]:
    """Return how friction bends before it slides: within `length`, or a part of it where it breaks away."""
    length *= rng.uniform(0.15, 1.0) if kind == BREAKS else 1.0
    damping = rng.uniform(0.1, 0.4) * float(np.max(force)) / np.sqrt(2 * length)
    return {"bristle": length, "micro": damping, "breaks": rng.uniform(0.4, 0.8)}


def coulomb_friction(kind: Drawn, rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
    """Hide dry friction of the guides."""
    force = size * kind.each(rng, kind.draw(rng, "friction")) * kind.loads(real)
    return kind.forces(real, force_n=force), real.having(dry=force, **_dry(kind, rng, force))


def stribeck_friction(kind: Drawn, rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
    """Hide friction whose surplus falls as exp(-|v|/v_s), not as a bell."""
    force = size * kind.draw(rng, "stiction") * kind.loads(real)
    extra, speed = rng.uniform(0.5, 1.2) * force, rng.uniform(6.0, 25.0)
    table = {**kind.forces(real, force_n=force, extra_force_n=extra), "velocity_mm_per_s": speed}
    return table, real.having(dry=force, stick=extra, stick_v=speed / 1e3, stick_power=1.0, **_dry(kind, rng, force))


def guide_damping(kind: Drawn, rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
    """Hide grease that thins with speed."""
    added = size * kind.each(rng, kind.draw(rng, "grease")) * kind.loads(real)
    return kind.forces(real, added_n_s_per_m=added), real.having(grease=added)


# ---- belts and motors ----------------------------------------------------------------------------


def belt_stiffness(kind: Drawn, rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
    """Hide belts tighter or slacker than the file says: one, or all."""
    change = size * kind.some(rng) * kind.each(rng, sign(rng) * rng.uniform(0.12, 0.25))
    return {"relative_change": told(change)}, kind.stiffened(real, change)


def belt_hardening(kind: Drawn, rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
    """Hide a cubic force, with a fifth power that comes to a tenth of it at the usual stretch, and always hardens."""
    stretch, way = kind.draw(rng, "stretch_m") * kind.stretched(real), -0.25 if rng.random() < kind.softens else 1.0
    cubic = size * way * 0.5 * kind.springs(real) / stretch**2
    return kind.of_belts(real, cubic_n_per_m3=cubic), real.having(cubic=cubic, quintic=0.1 * abs(cubic) / stretch**2)


def belt_position_stiffness(kind: Drawn, rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
    """Hide belts whose compliance grows evenly with their free length: k = k_0/(1 - r (q - q_c))."""
    slope = size * sign(rng) * kind.draw(rng, "slope_per_m") * np.ones(kind.motors)
    centre = kind.draw(rng, "centre_mm")
    table = {"slope_per_m": told(slope), "q_centre_mm": centre}
    return table, real.having(slope=slope, slope_at=np.full(kind.motors, centre / 1e3))


def belt_backlash(kind: Drawn, rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
    """Hide play with soft flanks and a damped landing."""
    width = size * kind.each(rng, kind.draw(rng, "play_mm"))
    fields = {"play": width / 1e3, "flank": rng.uniform(1e-6, 4e-6), "landing": rng.uniform(0.1, 0.5)}
    return {"width_mm": told(width)}, real.having(**fields)


def torque_angle(kind: Drawn, rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
    """Hide a motor's sine in series with its belt, a tenth of the compliance; a smaller `size`, a stronger motor."""
    peak = kind.draw(rng, "stepper_mm") / size if size > 0 else 0.0
    return {"amplitude_mm": peak}, real.having(stepper=np.full(kind.motors, peak / 1e3), stepper_share=0.9)


def command_delay(kind: Drawn, rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
    """Hide a delay of all motors or of one, which wanders by some hundredths of itself."""
    motors = kind.some(rng)
    delay = size * rng.uniform(4e-4, 2e-3) * motors
    return {"delay_s": told(delay)}, real.ordered(_late(rng, delay))


def _late(rng: Rng, delay: FloatArray) -> Order:
    pace, phase = rng.uniform(2, 7, 4), rng.uniform(0, 2 * np.pi, 4)

    def late(t: FloatArray, command: FloatArray) -> FloatArray:
        wander = 1 + 0.01 * np.sin(np.outer(t, 2 * np.pi * pace) + phase).sum(axis=1)
        at = np.clip(t[:, None] - np.broadcast_to(delay, command.shape[1]) * wander[:, None], 0.0, None)
        return np.column_stack([CubicSpline(t, own)(late) for own, late in zip(command.T, at.T, strict=True)])

    return late


def cogging(kind: Drawn, rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
    """Hide a ripple once a full step or once in four, with a second harmonic."""
    amplitude = size * kind.each(rng, kind.draw(rng, "ripple_mm"))
    pitch = float(rng.choice([1.0, 4.0])) / real.machine["steps"]["full_steps_per_mm"]
    fields = {
        "ripple": amplitude / 1e3,
        "ripple_wave": np.full(kind.motors, 2e3 * np.pi / pitch),
        "ripple_second": rng.uniform(0.05, 0.2),
        "ripple_phase": rng.uniform(0, 2 * np.pi),
    }
    return {"amplitude_mm": told(amplitude), "pitch_mm": pitch}, real.having(**fields)


# ---- frame ---------------------------------------------------------------------------------------


def frame_mode(kind: Drawn, rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
    """Hide a frame that sways in one direction, or in both as two modes a few percent apart."""
    mass, hertz, ratio = kind.draw(rng, "frame_kg"), kind.draw(rng, "frame_hz"), rng.uniform(0.02, 0.07)
    angle, both = rng.uniform(0, np.pi), rng.random() < 0.4
    along = np.array([np.cos(angle), np.sin(angle)])
    omega = 2 * np.pi * hertz * np.array([1.0, rng.uniform(0.97, 1.03) if both else 1.0])
    swaying = mass / size if size > 0 else 1.0
    directions = np.eye(2) if both else np.stack([along, np.zeros(2)])
    table = {
        "mass_kg": swaying,
        "frequency_hz": hertz,
        "damping_ratio": ratio,
        "direction": "both" if both else along.tolist(),
    }
    return table, real.having(
        sway_dir=directions if size > 0 else np.zeros((2, 2)),
        sway_mass=np.full(2, swaying),
        sway_k=swaying * omega**2,
        sway_b=2 * ratio * omega * swaying,
    )


# ---- the measurement -----------------------------------------------------------------------------


def sensor_gain(kind: Drawn, rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
    """Hide that one in three channels reads too much or too little."""
    felt, gain = np.flatnonzero(kind.felt), np.zeros(6)
    wrong = rng.permutation(felt)[: max(len(felt) // 3, 1)]
    gain[wrong] = size * rng.choice([-1.0, 1.0], len(wrong)) * rng.uniform(0.05, 0.15, len(wrong))
    table = {"carriage_relative_change": gain[:3].tolist()} if np.any(kind.felt[:3]) else {}

    def read(r: Reading) -> Reading:
        return replace(r, carriage=r.carriage * (1 + gain[:3]), nozzle=r.nozzle * (1 + gain[3:]))

    return {**table, "nozzle_relative_change": gain[3:].tolist()}, real.read_by(read)


def sensor_misalignment(_: Drawn, rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
    """Hide a sensor turned by three angles: it reads the same vector in its own axes."""
    angles = size * rng.uniform(1.5, 5.0, 3) * rng.choice([-1.0, 1.0], 3)
    axes = Rotation.from_rotvec(np.radians(angles)).as_matrix()

    return {"angles_deg": angles.tolist()}, real.read_by(lambda r: replace(r, nozzle=r.nozzle @ axes))


def sensor_time_offset(_: Drawn, rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
    """Hide accelerometers that are late, or early."""
    offset = size * sign(rng) * rng.uniform(4e-4, 3e-3)
    return {"offset_s": offset}, real.read_by(lambda r: read_at(r, r.t - offset))


def sensor_clock_drift(_: Drawn, rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
    """Hide a clock that is fast, or slow."""
    drift = size * sign(rng) * rng.uniform(7e-4, 6e-3)
    return {"relative_drift": drift}, real.read_by(lambda r: read_at(r, r.t / (1 + drift)))


# ---- outside the catalogue -----------------------------------------------------------------------


def off_centre_pulley(kind: Drawn, rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
    """Hide a belt that runs ahead once a turn (40 mm), and is tighter."""
    fields = {
        "ripple": size * kind.draw(rng, "pulley_m", kind.motors),
        "ripple_wave": np.full(kind.motors, 2 * np.pi / 0.04),
        "pulley_share": size * kind.draw(rng, "pulley_share"),
        "pulley_wave": 2 * np.pi / 0.04,
    }
    return {}, real.having(**fields)


def warming_belt(kind: Drawn, rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
    """Hide belts that soften while they work; before the next run they cool."""
    return {}, real.having(warm_share=size * kind.draw(rng, "warm_share"), warm_s=kind.draw(rng, "warm_s"))


def slow_driver(_: Drawn, rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
    """Hide a driver that cannot turn its motors faster than a limit, and catches up when it can."""
    fastest = rng.uniform(25.0, 40.0) / size if size > 0 else np.inf
    return {}, real.ordered(lambda t, command: _behind(np.ascontiguousarray(command), fastest * (t[1] - t[0])))


@njit(cache=True)
def _behind(command: FloatArray, most: float) -> FloatArray:
    """Follow (n, motors) by at most so much a row."""
    out = command.copy()
    for n in range(1, len(command)):
        for i in range(command.shape[1]):
            out[n, i] = out[n - 1, i] + min(max(command[n, i] - out[n - 1, i], -most), most)
    return out


def missed_steps(kind: Drawn, rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
    """Hide a motor that slips by four full steps, six times in every run, at unknown times."""
    slip = 4.0 / real.machine["steps"]["full_steps_per_mm"] * (1.0 if size > 0 else 0.0)
    motor, shares = int(rng.integers(kind.motors)), np.sort(rng.uniform(0.1, 0.9, 6))
    steps = slip * rng.choice([-1.0, 1.0], 6)

    def slipping(t: FloatArray, command: FloatArray) -> FloatArray:
        out = command.copy()
        for share, step in zip(shares, steps, strict=True):
            x = np.clip((t - share * t[-1]) / SLIP_S, 0.0, 1.0)
            out[:, motor] += step * x**2 * (3 - 2 * x)
        return out

    return {}, real.ordered(slipping)


def swinging_cable(kind: Drawn, rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
    """Hide a bundle of cables and filament that hangs on the moving part, and swings by itself."""
    mass, omega = size * kind.draw(rng, "cable") * kind.loads(real).mean(), 2 * np.pi * rng.uniform(6.0, 16.0)
    ratio = rng.uniform(0.05, 0.15)
    kept = mass if size > 0 else 1.0
    return {}, real.having(cable_mass=kept, cable_k=mass * omega**2, cable_b=2 * ratio * omega * mass)


def fans_tone(kind: Drawn, rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
    """Hide a fan that starts with every run shakes all sensors at its own frequency."""
    level = size * kind.draw(rng, "fan", 6) * kind.felt
    hertz, phase = rng.uniform(44.0, 110.0), rng.uniform(0, 2 * np.pi, 6)

    def read(r: Reading) -> Reading:
        tone = level * np.sin(2 * np.pi * hertz * r.t[:, None] + phase)
        return replace(r, carriage=r.carriage + tone[:, :3], nozzle=r.nozzle + tone[:, 3:])

    return {}, real.read_by(read)


def notched_wheel(kind: Drawn, rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
    """Hide wheels out of round: a force by the carriage's position, whichever way it goes."""
    notch = size * kind.draw(rng, "notch", kind.motors) * kind.loads(real)
    return {}, real.having(notch=notch, notch_wave=2 * np.pi / rng.uniform(2e-3, 6e-3))


def soft_bracket(kind: Drawn, rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
    """Hide a motor's bracket that gives way and rings."""
    mass, hertz, ratio = rng.uniform(0.4, 0.8), rng.uniform(25.0, 70.0), rng.uniform(0.02, 0.06)
    omega = 2 * np.pi * hertz
    which = int(rng.integers(kind.motors)) if size > 0 else -1
    return {}, real.having(soft_motor=which, soft_mass=mass, soft_k=mass * omega**2, soft_b=2 * ratio * omega * mass)


def creeping_belt(kind: Drawn, rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
    """Hide a belt that is stiffer the faster it is pulled (with a spring and a dashpot in series, in parallel)."""
    added = size * rng.uniform(0.25, 0.5) * kind.springs(real)
    return {}, real.having(visco_k=added, visco_s=rng.uniform(4e-3, 1.2e-2))


def heavy_rotor(kind: Drawn, rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
    """Hide rotors with inertia between magnets and belts; at rest both give way together by the file's stiffness."""
    share, hertz = rng.uniform(3.0, 6.0), rng.uniform(70.0, 130.0)
    magnets = share * kind.springs(real)
    mass = size * magnets / (2 * np.pi * hertz) ** 2
    fields = {"rotor_k": magnets, "rotor_b": rng.uniform(0.02, 0.06) * 2 * np.sqrt(magnets * mass)}
    if size > 0:
        fields["belt_k"] = magnets / (share - 1.0)  # of the belt alone
    return {}, real.having(rotor=mass, **fields)


def one_sided_belt(kind: Drawn, rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
    """Hide belts that are stiffer pulled than pushed, because one side is slack."""
    return {}, real.having(lean=size * sign(rng) * kind.some(rng) * rng.uniform(0.25, 0.45))


def sluggish_sensor(_: Drawn, rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
    """Hide a slow accelerometer of the nozzle: a low-pass of second order."""
    return {}, real.read_by(slowed(rng.uniform(70.0, 130.0), size))


def clipping_sensor(_: Drawn, rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
    """Hide an accelerometer of the nozzle that clips at some m/s², well below the loudest that it feels."""
    most = rng.uniform(5.0, 9.0) if size > 0 else np.inf
    return {}, real.read_by(lambda r: replace(r, nozzle=np.clip(r.nozzle, -most, most)))


def _those(names: str) -> dict[str, Drawing]:
    return {name: globals()[name] for name in names.split()}


SHARED: Mapping[str, Drawing] = _those("""
    coulomb_friction stribeck_friction guide_damping belt_stiffness belt_hardening belt_position_stiffness belt_backlash
    command_delay cogging torque_angle frame_mode sensor_gain sensor_misalignment sensor_time_offset sensor_clock_drift
""")
OUTSIDE: Mapping[str, Drawing] = _those("""
    off_centre_pulley warming_belt slow_driver missed_steps swinging_cable fans_tone notched_wheel soft_bracket
    creeping_belt heavy_rotor one_sided_belt sluggish_sensor clipping_sensor
""")
