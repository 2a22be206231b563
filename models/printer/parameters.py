"""Convert a machine and its effects to the parameters of the nonlinear kernels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from models.arrays import FloatArray
from models.effects.catalogue import effect_named, effective_machine, values_of
from models.machine import Drive, Machine
from models.printer.kernels.record import PARAMETERS, PrinterParameters
from models.vibration.effector import load_distribution, load_map

GRAVITY_M_PER_S2 = 9.80665


def printer_parameters(machine: Machine, *, gravity: bool = True) -> PrinterParameters:
    """Convert the machine and its effects to the kernels' record, in SI units.

    Raises
    ------
    ValueError
        If an effect is unknown or incomplete.
    """
    for name in machine.effects:
        effect_named(name)  # raises if it is unknown
    effective = effective_machine(machine)
    # the weight of cartesian and CoreXY axes rests on the frame, not on what vibrates
    g = GRAVITY_M_PER_S2 if gravity and not effective.has_straight_axes else 0.0
    parts = {
        **_geometry(effective),
        **_carriages(effective, g),
        **_effector(effective),
        **_belt_effects(effective),
        **_motor_effects(effective),
        **_friction_effects(effective),
        **_frame_effect(effective),
        "gravity": g,
    }
    record = np.zeros(1, dtype=PARAMETERS)
    for name, value in parts.items():
        record[name][0] = value
    return record.view(np.recarray)[0]


Part = dict[str, FloatArray | float | bool]


def _geometry(machine: Machine) -> Part:
    if machine.first_share is not None:
        return {"first_share": machine.first_share}  # no arms: the axes move the nozzle directly
    return {**machine.kinematics.printer_parameters()}


def _carriages(machine: Machine, gravity: float) -> Part:
    carriage = machine.carriage
    return {
        "carriage_mass": carriage.moving_mass_kg,
        "weight": carriage.moving_mass_kg * gravity,
        "belt_k": carriage.belt_stiffness_n_per_m,
        "belt_c": carriage.belt_damping_n_s_per_m,
        "guide_b": carriage.guide_damping_n_s_per_m,
        **(_drive(carriage.drive) if carriage.drive else {"ideal_drive": True}),
    }


def _drive(drive: Drive) -> Part:
    return {"d0": drive.d0_per_s2, "lead": drive.d1_per_s / drive.d0_per_s2, "d2": drive.d2_per_s}


def _effector(machine: Machine) -> Part:
    effector = machine.effector
    paper = effector.force_map == "paper"
    return {
        "shares": load_distribution(machine.delta, effector) if paper else np.stack([np.eye(3)] * 3),
        "holder_mass": machine.nozzle_side_mass_kg,
        "extruder_mass": effector.extruder_mass_kg,
        "mount_k": effector.extruder_stiffness_n_per_m,
        "mount_b": effector.extruder_damping_n_s_per_m,
    }


def _belt_effects(machine: Machine) -> Part:
    part: Part = {"peak_stretch": np.inf}
    if (values := values_of(machine, "belt_hardening")) is not None:
        cubic, quintic = values["cubic_n_per_m3"], values["quintic_n_per_m5"]
        peak = _peak_stretch(machine.carriage.belt_stiffness_n_per_m, cubic, quintic)
        part |= {"cubic": cubic, "quintic": quintic, "peak_stretch": peak}
    if (values := values_of(machine, "belt_position_stiffness")) is not None:
        part |= {"slope": values["slope_per_m"], "centre": values["q_centre_mm"] / 1e3}
    if (values := values_of(machine, "belt_backlash")) is not None:
        part |= {"half_backlash": values["width_mm"] / 2e3, "landing": values["landing_s_per_m"]}
    if (values := values_of(machine, "torque_angle")) is not None:
        part["inverse_amplitude"] = 1e3 / values["amplitude_mm"]
    return part


def _peak_stretch(stiffness: FloatArray | float, cubic: FloatArray, quintic: FloatArray) -> FloatArray:
    """Return the least stretch s > 0 with k + 3 k₃ s² + 5 k₅ s⁴ = 0 : (3,) m; infinite where the force has no peak."""
    inside = 9 * cubic**2 - 20 * stiffness * quintic
    # 2 k/(−3 k₃ + √…) is the smaller root s², and holds for k₅ = 0 too
    below = -3 * cubic + np.sqrt(np.maximum(inside, 0.0))
    softens = (inside >= 0) & (below > 0)
    return np.where(softens, np.sqrt(2 * stiffness / np.where(softens, below, 1.0)), np.inf)


def _motor_effects(machine: Machine) -> Part:
    part: Part = {}
    if (values := values_of(machine, "command_delay")) is not None:
        part["delay"] = values["delay_s"]
    if (values := values_of(machine, "cogging")) is not None:
        part |= {"ripple": values["amplitude_mm"] / 1e3, "wave": 2e3 * np.pi / values["pitch_mm"]}
        part |= {"second_sine": values["second_sine"], "second_cosine": values["second_cosine"]}
        part["phase"] = np.radians(values["phase_deg"])
    return part


def _friction_effects(machine: Machine) -> Part:
    part: Part = {"least_inertia": _least_inertia(machine), "creep": np.ones(3), "joint_creep": 1.0}
    frictions = [values_of(machine, name) for name in ("coulomb_friction", "stribeck_friction")]
    guides = [values for values in frictions if values is not None]
    if guides:
        part |= {"dry": sum(values["force_n"] for values in guides), **_reversal(guides)}
    if (values := frictions[1]) is not None:
        part |= {"sticking": values["extra_force_n"], "fading": 1e3 / values["velocity_mm_per_s"]}
        part["fading_power"] = values["exponent"] / 2
    if (values := values_of(machine, "joint_friction")) is not None:
        creep, hold = float(values["creep_mm_per_s"]) / 1e3, float(values["hold_per_s"])
        part |= {"joint_dry": float(values["force_n"]), "joint_creep": creep, "joint_hold": hold}
    return part


def _reversal(guides: Sequence[Mapping[str, FloatArray]]) -> Part:
    """Return v₀ and κ of the guides; of two kinds of friction, the mean weighted by their forces."""
    share = np.array([np.maximum(values["force_n"] + values.get("extra_force_n", 0.0), 1e-12) for values in guides])
    creep, hold = (
        np.sum(share * [values[key] for values in guides], axis=0) / share.sum(axis=0)
        for key in ("creep_mm_per_s", "hold_per_s")
    )
    return {"creep": creep / 1e3, "hold": hold}


def _least_inertia(machine: Machine) -> float:
    """Return the smallest effective inertia of the carriages, kg, at the centre and on the rim."""
    reach = machine.kinematics.model_reach_mm
    angles = np.arange(0, 2 * np.pi, np.pi / 6)
    positions = np.vstack([np.zeros((1, 2)), reach * np.column_stack([np.cos(angles), np.sin(angles)])])
    load = machine.nozzle_side_mass_kg * load_map(machine, positions) @ machine.kinematics.jacobian(positions)
    return float(np.linalg.eigvals(machine.carriage.moving_mass_kg * np.eye(3) + load).real.min())


def _frame_effect(machine: Machine) -> Part:
    values = values_of(machine, "frame_mode")
    if values is None:
        return {}
    omega = 2 * np.pi * float(values["frequency_hz"])
    directions = np.zeros((2, 2))
    directions[: len(values["direction"])] = values["direction"]
    return {
        "frame_directions": directions,
        "frame_mass_ratio": machine.nozzle_side_mass_kg / (float(values["mass_kg"]) + machine.nozzle_side_mass_kg),
        "frame_k": omega**2,
        "frame_b": 2 * float(values["damping_ratio"]) * omega,
    }
