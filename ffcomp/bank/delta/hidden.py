"""The effects of the catalogue as a real printer has them: drawn sizes, and shapes that are not the machine files'.

`EFFECTS[name](rng, size, real)` → (the table a machine file would have to hold, the printer with the effect). The same
seed with another `size` is the same effect, larger or smaller; with size zero nothing is hidden.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from ffcomp.bank.delta.numbers import FloatArray
from ffcomp.bank.real import Hide, Reading, Real, Rng, read_at, sign, turned


def each(rng: Rng, value: float) -> FloatArray:
    """(3,): the same on every tower, or as often as not three different ones."""
    uneven = rng.uniform(0.3, 1.7, 3)
    return value * (uneven if rng.random() < 0.35 else np.ones(3))


def told(values: FloatArray) -> Any:
    """As a machine file tells it: one number if all are equal."""
    return float(values[0]) if np.ptp(values) == 0 else [float(x) for x in values]


# ---- friction ------------------------------------------------------------------------------------


def _dry(rng: Rng) -> dict[str, Any]:
    """Hide it: a bristle that slides after some µm, or a tanh."""
    kind, length, speed = int(rng.integers(1, 3)), rng.uniform(1.2e-5, 4e-5), rng.uniform(1e-3, 2e-3)
    return {"dry_kind": kind, "bristle": length, "dry_v": speed}


def coulomb_friction(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide dry friction of the guides."""
    force = size * each(rng, rng.uniform(1.0, 4.0))
    return {"force_n": told(force)}, real.having(dry=force, **_dry(rng))


def stribeck_friction(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide it: the surplus falls as exp(-|v|/v_s), not as a bell."""
    force = size * rng.uniform(0.8, 2.2) * np.ones(3)
    extra, speed = rng.uniform(0.5, 1.2) * force, rng.uniform(6.0, 25.0)
    table = {"force_n": told(force), "extra_force_n": told(extra), "velocity_mm_per_s": speed}
    return table, real.having(dry=force, stick=extra, stick_v=speed / 1e3, stick_power=1.0, **_dry(rng))


def guide_damping(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide grease that thins with speed."""
    added = size * each(rng, rng.uniform(8.0, 25.0))
    return {"added_n_s_per_m": told(added)}, real.having(grease=added)


def joint_friction(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide friction of the joints."""
    force = size * rng.uniform(0.8, 3.0)
    return {"force_n": force}, real.having(joint=force, joint_bristle=rng.uniform(1.5e-5, 5e-5))


# ---- belts and motors ----------------------------------------------------------------------------


def belt_stiffness(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide belts tighter or slacker than the file says."""
    change = size * each(rng, sign(rng) * rng.uniform(0.12, 0.25))
    stiffness = real.machine["carriage"]["belt_stiffness_n_per_m"] * (1 + change)
    return {"relative_change": told(change)}, real.changed("carriage", belt_stiffness_n_per_m=stiffness)


def belt_hardening(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """With a fifth power that comes to a tenth of the third at 0.3 mm, and always hardens."""
    soft = rng.random() < 0.3
    cubic = size * (-rng.uniform(1e11, 2.5e11) if soft else rng.uniform(4e11, 1.6e12)) * np.ones(3)
    return {"cubic_n_per_m3": told(cubic)}, real.having(cubic=cubic, quintic=0.1 * np.abs(cubic) / 9e-8)


def belt_position_stiffness(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide it: the compliance is what grows evenly with the free length: k = k_0/(1 - r (q - q_c))."""
    slope, centre = size * sign(rng) * rng.uniform(0.7, 1.8) * np.ones(3), rng.uniform(330, 430)
    table = {"slope_per_m": told(slope), "q_centre_mm": centre}
    return table, real.having(slope=slope, slope_at=np.full(3, centre / 1e3))


def belt_backlash(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide play with soft flanks and a damped landing."""
    width = size * each(rng, rng.uniform(0.04, 0.12))
    fields = {"play": width / 1e3, "flank": rng.uniform(1e-6, 4e-6), "landing": rng.uniform(0.1, 0.5)}
    return {"width_mm": told(width)}, real.having(**fields)


def torque_angle(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide a motor's sine, a tenth of the compliance the belt's in series. A smaller `size` is a stronger motor."""
    peak = rng.uniform(0.35, 0.8) / size if size > 0 else 0.0
    fields = {"stepper": np.full(3, peak / 1e3), "stepper_share": 0.9}
    return {"amplitude_mm": peak}, real.having(**fields)


def command_delay(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """On all towers or on one; it wanders by some hundredths of itself."""
    towers = np.eye(3)[rng.integers(3)] if rng.random() < 0.5 else np.ones(3)
    delay = size * rng.uniform(4e-4, 2e-3) * towers
    pace, phase = rng.uniform(2, 7, 4), rng.uniform(0, 2 * np.pi, 4)

    def late(t: FloatArray, command: FloatArray) -> FloatArray:
        wander = 1 + 0.01 * np.sin(np.outer(t, 2 * np.pi * pace) + phase).sum(axis=1)
        at = np.clip(t[:, None] - delay * wander[:, None], 0.0, None)
        return np.column_stack([CubicSpline(t, command[:, i])(at[:, i]) for i in range(3)])

    return {"delay_s": told(delay)}, real.ordered(late)


def cogging(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Once a full step or once in four, with a second harmonic."""
    amplitude = size * each(rng, rng.uniform(0.004, 0.014))
    pitch = float(rng.choice([1.0, 4.0])) / real.machine["steps"]["full_steps_per_mm"]
    fields = {
        "ripple": amplitude / 1e3,
        "ripple_wave": np.full(3, 2e3 * np.pi / pitch),
        "ripple_second": rng.uniform(0.05, 0.2),
        "ripple_phase": rng.uniform(0, 2 * np.pi),
    }
    return {"amplitude_mm": told(amplitude), "pitch_mm": pitch}, real.having(**fields)


# ---- effector, frame, geometry -------------------------------------------------------------------


def effector_mass(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide a mass on the nozzle holder."""
    added = size * rng.uniform(0.05, 0.14)
    return {"added_kg": added}, real.changed(
        "effector", nozzle_mass_kg=real.machine["effector"]["nozzle_mass_kg"] + added
    )


def center_of_mass(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Felt only where the loads go by Eqs. 22-27: the bank hides it in such printers."""
    offset = size * rng.uniform(6.0, 18.0, 3) * rng.choice([-1.0, 1.0], 3)
    before = np.asarray(real.machine["effector"]["center_of_mass_mm"])
    return {"offset_mm": offset.tolist()}, real.changed("effector", center_of_mass_mm=(before + offset).tolist())


def extruder_mount(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide another mount of the extruder."""
    touched = np.array([1.0, 1.0, 0.0]) if rng.random() < 0.5 else np.eye(3)[rng.integers(2)]
    stiffer = size * touched * sign(rng) * rng.uniform(0.2, 0.4, 3)
    damper = size * touched * rng.uniform(0.3, 0.9, 3)
    effector = real.machine["effector"]
    table = {"relative_stiffness_change": stiffer.tolist(), "relative_damping_change": damper.tolist()}
    return table, real.changed(
        "effector",
        extruder_stiffness_n_per_m=(effector["extruder_stiffness_n_per_m"] * (1 + stiffer)).tolist(),
        extruder_damping_n_s_per_m=(effector["extruder_damping_n_s_per_m"] * (1 + damper)).tolist(),
    )


def frame_mode(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """One direction; or both, as two modes a few percent apart."""
    mass, hertz, ratio = rng.uniform(4.0, 14.0), rng.uniform(10.0, 45.0), rng.uniform(0.02, 0.07)
    angle, both = rng.uniform(0, np.pi), rng.random() < 0.4
    along = np.array([np.cos(angle), np.sin(angle)])
    directions = np.eye(2) if both else np.stack([along, np.zeros(2)])
    apart = rng.uniform(0.97, 1.03) if both else 1.0
    swaying = mass / size if size > 0 else 1.0
    omega = 2 * np.pi * hertz * np.array([1.0, apart])
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


def arm_geometry(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide other arms and another radius."""
    arm, radius = size * sign(rng) * rng.uniform(1.0, 3.0), size * sign(rng) * rng.uniform(1.0, 3.0)
    geometry = real.machine["kinematics"]
    longer = real.changed(
        "kinematics",
        arm_length_mm=geometry["arm_length_mm"] + arm,
        delta_radius_mm=geometry["delta_radius_mm"] + radius,
    )
    return {"arm_length_mm": arm, "delta_radius_mm": radius}, longer


def force_map(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """There or not: the printer's loads go the way its file does not say."""
    other = {"virtual_work": "paper", "paper": "virtual_work"}
    said = real.machine["effector"]["force_map"]
    return {}, real.changed("effector", force_map=other[said] if size > 0 else said)


# ---- the measurement -----------------------------------------------------------------------------


def sensor_gain(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide two channels that read too much or too little."""
    wrong = rng.permutation(6) < 2
    gain = size * wrong * rng.choice([-1.0, 1.0], 6) * rng.uniform(0.05, 0.15, 6)

    def read(r: Reading) -> Reading:
        return replace(r, carriage=r.carriage * (1 + gain[:3]), nozzle=r.nozzle * (1 + gain[3:]))

    table = {"carriage_relative_change": gain[:3].tolist(), "nozzle_relative_change": gain[3:].tolist()}
    return table, real.read_by(read)


def sensor_misalignment(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide it: a sensor turned by three angles reads the same vector in its own axes."""
    angles = size * rng.uniform(1.5, 5.0, 3) * rng.choice([-1.0, 1.0], 3)
    axes = turned(np.radians(angles))

    def read(r: Reading) -> Reading:
        return replace(r, nozzle=r.nozzle @ axes)

    return {"angles_deg": angles.tolist()}, real.read_by(read)


def sensor_time_offset(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide accelerometers that are late, or early."""
    offset = size * sign(rng) * rng.uniform(4e-4, 3e-3)
    return {"offset_s": offset}, real.read_by(lambda r: read_at(r, r.t - offset))


def sensor_clock_drift(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide a clock that is fast, or slow."""
    drift = size * sign(rng) * rng.uniform(7e-4, 6e-3)
    return {"relative_drift": drift}, real.read_by(lambda r: read_at(r, r.t / (1 + drift)))


EFFECTS: Mapping[str, Hide] = {
    hide.__name__: hide
    for hide in (
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
        effector_mass,
        center_of_mass,
        extruder_mount,
        joint_friction,
        frame_mode,
        arm_geometry,
        force_map,
        sensor_gain,
        sensor_misalignment,
        sensor_time_offset,
        sensor_clock_drift,
    )
}
