"""Convert a machine and its effects to the parameters of the nonlinear kernels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from models.arrays import FloatArray
from models.effects.catalogue import effect_named, effective_machine, values_of
from models.kinematics.base import Kinematics
from models.machine import Machine
from models.printer.kernels.record import PARAMETERS, PrinterParameters
from models.vibration.base import PrinterFields

GRAVITY_M_PER_S2 = 9.80665


def printer_parameters(machine: Machine, *, gravity: bool = True) -> PrinterParameters:
    """Convert the machine and its effects to the kernels' record, in SI units.

    Raises
    ------
    ValueError
        If an effect is unknown or incomplete.
    """
    return _record_of(_folded(machine), gravity)


def _folded(machine: Machine) -> Machine:
    """Return the machine with the effects on its parameters; a ValueError if one is unknown."""
    for name in machine.effects:
        effect_named(name)
    return effective_machine(machine)


def _record_of(effective: Machine, gravity: bool) -> PrinterParameters:
    model = effective.vibration.printer_parameters(GRAVITY_M_PER_S2 if gravity else 0.0)
    geometry = effective.kinematics.printer_parameters()
    motor_k = np.asarray(geometry.get("axis_matrix", np.eye(3))).T ** 2 @ np.broadcast_to(model["belt_k"], 3)
    parts = {
        **geometry,
        **model,
        "motor_k": motor_k,
        **_belt_effects(effective, motor_k),
        **_motor_effects(effective),
        **_friction_effects(effective),
        **_frame_effect(effective, float(model["holder_mass"])),
        **_racking_effect(effective),
        **_place_effects(effective),
    }
    record = np.zeros(1, dtype=PARAMETERS)
    for name, value in parts.items():
        record[name][0] = value
    return record.view(np.recarray)[0]


def printer_modes(machine: Machine) -> FloatArray:
    """Return the modes of a machine with straight axes and its effects, (n, 7, 3) SI; none of a delta."""
    return effective_machine(machine).vibration.printer_modes()


class ConvertedPrinter(NamedTuple):
    """A machine with its effects as the kernels take it."""

    parameters: PrinterParameters
    modes: FloatArray  # (n, 7, 3)
    kinematics: Kinematics  # with the effects on it


def converted_printer(machine: Machine, *, gravity: bool = True) -> ConvertedPrinter:
    """Convert a machine: see `printer_parameters` and `printer_modes`."""
    effective = _folded(machine)
    return ConvertedPrinter(_record_of(effective, gravity), effective.vibration.printer_modes(), effective.kinematics)


def _belt_effects(machine: Machine, stiffness: FloatArray) -> PrinterFields:
    part: PrinterFields = {"peak_stretch": np.inf}
    if (values := values_of(machine, "belt_hardening")) is not None:
        cubic, quintic = values["cubic_n_per_m3"], values["quintic_n_per_m5"]
        peak = _peak_stretch(stiffness, cubic, quintic)
        part |= {"cubic": cubic, "quintic": quintic, "peak_stretch": peak}
    if (values := values_of(machine, "belt_position_stiffness")) is not None:
        part |= {"slope": values["slope_per_m"], "centre": values["q_centre_mm"] / 1e3}
    if (values := values_of(machine, "belt_backlash")) is not None:
        part |= {"half_backlash": values["width_mm"] / 2e3, "landing": values["landing_s_per_m"]}
    if (values := values_of(machine, "torque_angle")) is not None:
        part |= {"inverse_amplitude": 1e3 / values["amplitude_mm"], "belt_share": values["belt_share"]}
    return part


def _peak_stretch(stiffness: FloatArray, cubic: FloatArray, quintic: FloatArray) -> FloatArray:
    """Return the least stretch s > 0 with k + 3 k₃ s² + 5 k₅ s⁴ = 0 : (3,) m; infinite where the force has no peak."""
    inside = 9 * cubic**2 - 20 * stiffness * quintic
    # 2 k/(−3 k₃ + √…) is the smaller root s², and holds for k₅ = 0 too
    below = -3 * cubic + np.sqrt(np.maximum(inside, 0.0))
    softens = (inside >= 0) & (below > 0)
    return np.where(softens, np.sqrt(2 * stiffness / np.where(softens, below, 1.0)), np.inf)


def _motor_effects(machine: Machine) -> PrinterFields:
    part: PrinterFields = {}
    if (values := values_of(machine, "command_delay")) is not None:
        part["delay"] = values["delay_s"]
    if (values := values_of(machine, "cogging")) is not None:
        part |= {"ripple": values["amplitude_mm"] / 1e3, "wave": 2e3 * np.pi / values["pitch_mm"]}
        part |= {"second_sine": values["second_sine"], "second_cosine": values["second_cosine"]}
        part["phase"] = np.radians(values["phase_deg"])
    return part


def _friction_effects(machine: Machine) -> PrinterFields:
    part: PrinterFields = {"creep": np.ones(3), "joint_creep": 1.0}
    frictions = [values_of(machine, name) for name in ("coulomb_friction", "stribeck_friction")]
    guides = [values for values in frictions if values is not None]
    if guides:
        part |= {"dry": sum(values["force_n"] for values in guides), **_reversal(guides)}
        part["bristles"] = _bristles(guides)
    if (values := frictions[1]) is not None:
        part |= {"sticking": values["extra_force_n"], "fading": 1e3 / values["velocity_mm_per_s"]}
        part["fading_power"] = values["exponent"] / 2
    if (values := values_of(machine, "joint_friction")) is not None:
        creep, hold = float(values["creep_mm_per_s"]) / 1e3, float(values["hold_per_s"])
        part |= {"joint_dry": float(values["force_n"]), "joint_creep": creep, "joint_hold": hold}
    return part


def _reversal(guides: Sequence[Mapping[str, FloatArray]]) -> PrinterFields:
    """Return v₀ and κ of the guides; of two kinds of friction, the mean weighted by their forces."""
    share = np.array([np.maximum(values["force_n"] + values.get("extra_force_n", 0.0), 1e-12) for values in guides])
    creep, hold = (
        np.sum(share * [values[key] for values in guides], axis=0) / share.sum(axis=0)
        for key in ("creep_mm_per_s", "hold_per_s")
    )
    return {"creep": creep / 1e3, "hold": hold}


def _bristles(guides: Sequence[Mapping[str, FloatArray]]) -> FloatArray:
    """Return 1/s₀ (3,) 1/m; of two kinds of friction that bend, that of the longer way."""
    way = np.max([values["presliding_mm"] for values in guides], axis=0) / 1e3
    return np.divide(1.0, way, out=np.zeros(3), where=way > 0.0)


def _frame_effect(machine: Machine, holder_mass_kg: float) -> PrinterFields:
    values = values_of(machine, "frame_mode")
    if values is None:
        return {}
    omega = 2 * np.pi * float(values["frequency_hz"])
    directions = np.zeros((2, 2))
    directions[: len(values["direction"])] = values["direction"]
    return {
        "frame_directions": directions,
        "frame_mass_ratio": holder_mass_kg / (float(values["mass_kg"]) + holder_mass_kg),
        "frame_k": omega**2,
        "frame_b": 2 * float(values["damping_ratio"]) * omega,
        "frame_inverse_mass": 1 / float(values["mass_kg"]),
    }


def _racking_effect(machine: Machine) -> PrinterFields:
    values = values_of(machine, "gantry_racking")
    if values is None or not np.isfinite(values["radius_mm"]):
        return {}
    omega = 2 * np.pi * float(values["frequency_hz"])
    return {
        "yaw_k": omega**2,
        "yaw_b": 2 * float(values["damping_ratio"]) * omega,
        "yaw_inertia": (float(values["radius_mm"]) / 1e3) ** 2,
        "yaw_share": float(values["tool_share"]),
        "yaw_centre": float(values["x_centre_mm"]) / 1e3,
        "yaw_arm": float(values["arm_mm"]) / 1e3,
    }


def _place_effects(machine: Machine) -> PrinterFields:
    """Return what depends on where the nozzle is, beyond the belts' free length."""
    part: PrinterFields = {}
    if (values := values_of(machine, "growing_bed")) is not None:
        part["growth"] = values["growth_per_m"]
    if (values := values_of(machine, "toolhead_mode")) is not None:
        part |= {"by_x": values["slope_per_m"], "by_x_squared": values["curve_per_m2"]}
        part["by_x_centre"] = float(values["x_centre_mm"]) / 1e3
    return part
