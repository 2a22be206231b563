"""The effects of the catalogue as a real printer with straight axes has them, in shapes that are not the files'.

`effects_of(kind)[name](rng, size, real)` → (the table a machine file would have to hold, the printer with the effect).
The same seed with another `size` is the same effect, larger or smaller; with size zero nothing is hidden.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from ffcomp.bank.real import FloatArray, Hide, Reading, Real, Rng, read_at, sign, turned
from ffcomp.bank.straight.numbers import turn_of


def each(rng: Rng, value: float) -> FloatArray:
    """Draw the same for both axes or belts, or as often as not two different ones: (2,)."""
    uneven = rng.uniform(0.4, 1.6, 2)
    return value * (uneven if rng.random() < 0.35 else np.ones(2))


def told(values: FloatArray) -> Any:
    """Return it as a machine file tells it: one number if both are equal, else a list of three."""
    return float(values[0]) if np.ptp(values) == 0 else [*(float(x) for x in values), 0.0]


def masses(real: Real) -> FloatArray:
    """Return all that each axis moves, (2,) kg."""
    return np.array(real.machine["plant"]["carriage"]) + np.array(real.machine["plant"]["tool"])


def of_mass(real: Real, **values: FloatArray) -> dict[str, Any]:
    """Return forces of the axes, (2,) each, by a file's keys: per kilogram where it states no masses."""
    if real.machine["masses"]:
        return {key: told(value) for key, value in values.items()}
    return {f"{key}_per_kg": told(value / masses(real)) for key, value in values.items()}


def _dry(rng: Rng) -> dict[str, Any]:
    """Hide it: a bristle that slides after some µm, or a tanh."""
    kind, length, speed = int(rng.integers(1, 3)), rng.uniform(1.2e-5, 4e-5), rng.uniform(1e-3, 2e-3)
    return {"dry_kind": kind, "bristle": length, "dry_v": speed}


def coulomb_friction(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Of the guides, in proportion to what they carry."""
    force = size * each(rng, rng.uniform(1.2, 4.0)) * masses(real)
    return of_mass(real, force_n=force), real.having(dry=force, **_dry(rng))


def stribeck_friction(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide it: the surplus falls as exp(-|v|/v_s), not as a bell."""
    force = size * rng.uniform(1.2, 3.0) * masses(real)
    extra, speed = rng.uniform(0.5, 1.2) * force, rng.uniform(6.0, 25.0)
    table = {**of_mass(real, force_n=force, extra_force_n=extra), "velocity_mm_per_s": speed}
    return table, real.having(dry=force, stick=extra, stick_v=speed / 1e3, stick_power=1.0, **_dry(rng))


def guide_damping(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Grease, which thins with speed."""
    added = size * each(rng, rng.uniform(12.0, 40.0)) * masses(real)
    return of_mass(real, added_n_s_per_m=added), real.having(grease=added)


def belt_stiffness(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Both belts; or one only, which on a CoreXY lets x and y exchange motion."""
    one = np.eye(2)[rng.integers(2)] if rng.random() < 0.5 else np.ones(2)
    change = size * one * sign(rng) * rng.uniform(0.12, 0.25)
    stiffness = np.array(real.machine["plant"]["belt_k"]) * (1 + change)
    return {"relative_change": told(change)}, real.changed("plant", belt_k=stiffness.tolist())


def _belts(real: Real) -> FloatArray:
    return np.array(real.machine["plant"]["belt_k"])


def belt_hardening(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """With a fifth power that comes to a tenth of the third where the force is a half more."""
    cubic = size * _belts(real) * (0.5 / rng.uniform(0.25e-3, 0.6e-3) ** 2)
    pulled = np.sum(turn_of(real.machine["kinematics"]["type"]) ** 2, axis=0)  # a file tells of axes, which both pull
    table = of_belts(real, cubic_n_per_m3=pulled * cubic)
    return table, real.having(cubic=cubic, quintic=0.1 * cubic / 1.6e-7)


def of_belts(real: Real, **values: FloatArray) -> dict[str, Any]:
    """Return forces of belts, (2,) each; those of a CoreXY's belts are told by the mean of both masses."""
    if real.machine["masses"] or real.machine["kinematics"]["type"] == "cartesian":
        return of_mass(real, **values)
    return {}


def belt_position_stiffness(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide it: the compliance is what grows evenly with the free length: k = k_0/(1 - r (q - q_c))."""
    slope, centre = size * sign(rng) * rng.uniform(1.0, 2.2) * np.ones(2), rng.uniform(70, 130)
    table = {"slope_per_m": told(slope), "q_centre_mm": centre}
    return table, real.having(slope=slope, slope_at=np.full(2, centre / 1e3))


def belt_backlash(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """With soft flanks and a damped landing."""
    width = size * each(rng, rng.uniform(0.06, 0.16))
    fields = {"play": width / 1e3, "flank": rng.uniform(1e-6, 4e-6), "landing": rng.uniform(0.1, 0.5)}
    return {"width_mm": told(width)}, real.having(**fields)


def torque_angle(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide a motor's sine, a tenth of the compliance the belt's in series. A smaller `size` is a stronger motor."""
    peak = rng.uniform(0.5, 1.0) / size if size > 0 else 0.0
    return {"amplitude_mm": peak}, real.having(stepper=np.full(2, peak / 1e3), stepper_share=0.9)


def command_delay(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """On both motors or on one; it wanders by some hundredths of itself."""
    motors = np.eye(2)[rng.integers(2)] if rng.random() < 0.5 else np.ones(2)
    delay = size * rng.uniform(4e-4, 2e-3) * motors
    pace, phase = rng.uniform(2, 7, 4), rng.uniform(0, 2 * np.pi, 4)

    def late(t: FloatArray, command: FloatArray) -> FloatArray:
        wander = 1 + 0.01 * np.sin(np.outer(t, 2 * np.pi * pace) + phase).sum(axis=1)
        at = np.clip(t[:, None] - delay * wander[:, None], 0.0, None)
        return np.column_stack([CubicSpline(t, command[:, i])(at[:, i]) for i in range(2)])

    return {"delay_s": told(delay)}, real.ordered(late)


def cogging(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Once a full step or once in four, with a second harmonic."""
    amplitude = size * each(rng, rng.uniform(0.005, 0.015))
    pitch = float(rng.choice([1.0, 4.0])) / real.machine["steps"]["full_steps_per_mm"]
    fields = {
        "ripple": amplitude / 1e3,
        "ripple_wave": np.full(2, 2e3 * np.pi / pitch),
        "ripple_second": rng.uniform(0.05, 0.2),
        "ripple_phase": rng.uniform(0, 2 * np.pi),
    }
    return {"amplitude_mm": told(amplitude), "pitch_mm": pitch}, real.having(**fields)


def frame_mode(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """One direction; or both, as two modes a few percent apart."""
    mass, hertz, ratio = rng.uniform(5.0, 15.0), rng.uniform(10.0, 30.0), rng.uniform(0.02, 0.07)
    angle, both = rng.uniform(0, np.pi), rng.random() < 0.4
    along = np.array([np.cos(angle), np.sin(angle)])
    swaying = mass / size if size > 0 else 1.0
    omega = 2 * np.pi * hertz * np.array([1.0, rng.uniform(0.97, 1.03) if both else 1.0])
    table: dict[str, Any] = {"frequency_hz": hertz, "damping_ratio": ratio}
    if real.machine["masses"]:
        table["mass_kg"] = swaying
    table["direction"] = "both" if both else along.tolist()
    return table, real.having(
        sway_dir=(np.eye(2) if both else np.stack([along, np.zeros(2)])) if size > 0 else np.zeros((2, 2)),
        sway_mass=np.full(2, swaying),
        sway_k=swaying * omega**2,
        sway_b=2 * ratio * omega * swaying,
    )


def sensor_gain(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """One of the two accelerometers' axes."""
    gain = size * np.append(np.eye(2)[rng.integers(2)], 0.0) * sign(rng) * rng.uniform(0.05, 0.15)
    return {"nozzle_relative_change": gain.tolist()}, real.read_by(lambda r: replace(r, nozzle=r.nozzle * (1 + gain)))


def sensor_misalignment(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide it: a chip on a CoreXY's head, turned by three angles, reads the same vector in its own axes."""
    angles = size * rng.uniform(1.5, 5.0, 3) * rng.choice([-1.0, 1.0], 3)
    axes = turned(np.radians(angles))

    def read(r: Reading) -> Reading:
        return replace(r, nozzle=r.nozzle @ axes)

    return {"angles_deg": angles.tolist()}, real.read_by(read)


def sensor_time_offset(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """All accelerometers late, or early."""
    offset = size * sign(rng) * rng.uniform(4e-4, 3e-3)
    return {"offset_s": offset}, real.read_by(lambda r: read_at(r, r.t - offset))


def sensor_clock_drift(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide it: a clock that is fast, or slow."""
    drift = size * sign(rng) * rng.uniform(7e-4, 6e-3)
    return {"relative_drift": drift}, real.read_by(lambda r: read_at(r, r.t / (1 + drift)))


EVERYWHERE = (
    coulomb_friction,
    stribeck_friction,
    guide_damping,
    belt_stiffness,
    belt_hardening,
    belt_position_stiffness,
    belt_backlash,
    command_delay,
    cogging,
    torque_angle,
    frame_mode,
    sensor_gain,
    sensor_time_offset,
    sensor_clock_drift,
)


def effects_of(kind: str) -> Mapping[str, Hide]:
    """Return the effects that a printer of this kind can have: one chip feels x and y of a CoreXY only."""
    more = (sensor_misalignment,) if kind == "corexy" else ()
    return {hide.__name__: hide for hide in (*EVERYWHERE, *more)}
