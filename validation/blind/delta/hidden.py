"""The effects of the catalogue as a real printer has them: drawn sizes, and shapes that are not the machine files'.

`EFFECTS[name](rng, size, real)` → (the table a machine file would have to hold, the printer with the effect). The same
seed with another `size` is the same effect, larger or smaller; with size zero nothing is hidden. What printers of other
kinds can have too is in `printer.hidden`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from validation.blind.delta.drawn import TOWERS
from validation.blind.printer.drawn import told
from validation.blind.printer.hidden import SHARED, of_kind
from validation.blind.printer.real import Hide, Reading, Real, Rng, sign


def joint_friction(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide friction of the joints."""
    force = size * rng.uniform(0.8, 3.0)
    return {"force_n": force}, real.having(joint=force, joint_bristle=rng.uniform(1.5e-5, 5e-5))


# ---- belts and motors ----------------------------------------------------------------------------


def belt_stiffness(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide belts tighter or slacker than the file says."""
    change = size * TOWERS.each(rng, sign(rng) * rng.uniform(0.12, 0.25))
    stiffness = real.machine["carriage"]["belt_stiffness_n_per_m"] * (1 + change)
    return {"relative_change": told(change)}, real.changed("carriage", belt_stiffness_n_per_m=stiffness)


def belt_hardening(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """With a fifth power that comes to a tenth of the third at 0.3 mm, and always hardens."""
    soft = rng.random() < 0.3
    cubic = size * (-rng.uniform(1e11, 2.5e11) if soft else rng.uniform(4e11, 1.6e12)) * np.ones(3)
    return {"cubic_n_per_m3": told(cubic)}, real.having(cubic=cubic, quintic=0.1 * np.abs(cubic) / 9e-8)


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


def arm_inertia(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide arms whose mass lies along them: all of it, or the ends weigh something too."""
    along = size * rng.uniform(0.7, 1.0)
    return {"share_along": along}, real.having(rods=along * real.machine["carriage"]["arm_pair_mass_kg"] / 6)


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


_OWN = (
    belt_stiffness,
    belt_hardening,
    effector_mass,
    center_of_mass,
    extruder_mount,
    joint_friction,
    arm_geometry,
    arm_inertia,
    force_map,
    sensor_gain,
)
_KNOWN: Mapping[str, Hide] = {**of_kind(SHARED, TOWERS), **{hide.__name__: hide for hide in _OWN}}
EFFECTS: Mapping[str, Hide] = {  # in the order in which the bank draws them
    name: _KNOWN[name]
    for name in (
        "coulomb_friction",
        "stribeck_friction",
        "guide_damping",
        "belt_stiffness",
        "belt_hardening",
        "belt_position_stiffness",
        "belt_backlash",
        "command_delay",
        "cogging",
        "torque_angle",
        "effector_mass",
        "center_of_mass",
        "extruder_mount",
        "joint_friction",
        "frame_mode",
        "arm_geometry",
        "arm_inertia",
        "force_map",
        "sensor_gain",
        "sensor_misalignment",
        "sensor_time_offset",
        "sensor_clock_drift",
    )
}
