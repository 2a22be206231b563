"""The effects of the catalogue as a real printer with straight axes has them, in shapes that are not the files'.

`effects_of(kind)[name](rng, size, real)` → (the table a machine file would have to hold, the printer with the effect).
The same seed with another `size` is the same effect, larger or smaller; with size zero nothing is hidden.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from validation.blind.printer.drawn import told
from validation.blind.printer.hidden import SHARED, of_kind
from validation.blind.printer.real import FloatArray, Hide, Real, Rng, Tables, sign
from validation.blind.straight.drawn import AXES, of_mass, springs
from validation.blind.straight.numbers import modes_of, turn_of


def belt_stiffness(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Both belts; or one only, which on a CoreXY lets x and y exchange motion."""
    one = np.eye(2)[rng.integers(2)] if rng.random() < 0.5 else np.ones(2)
    change = size * one * sign(rng) * rng.uniform(0.12, 0.25)
    stiffness = springs(real) * (1 + change)
    return {"relative_change": told(change)}, real.changed("plant", belt_k=stiffness.tolist())


def belt_damping(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide it: belts, alike, that hold a part of what damps the axes."""
    machine, table = damped_by_belts(real.machine, size * rng.uniform(0.4, 1.0))
    return table, replace(real, machine=machine)


def damped_by_belts(machine: Tables, share: float) -> tuple[Tables, dict[str, Any]]:
    """Return the printer with so much of its carriages' damping in its belts, and the table of it.

    The two belts of a CoreXY, which are alike, damp both axes: the axis that is damped less decides.
    """
    plant, turn = copy.deepcopy(machine["plant"]), turn_of(machine["kinematics"]["type"])
    held = np.array(plant["guide_b"]) + plant["ground"]
    belts = share * (np.full(2, held.min() / 2) if machine["kinematics"]["type"] == "corexy" else held)
    left = 1.0 - np.sum(turn**2 * belts[:, None], axis=0) / held
    plant |= {"belt_c": belts.tolist(), "guide_b": (left * plant["guide_b"]).tolist()}
    plant["ground"] = (left * plant["ground"]).tolist()
    changed = {**machine, "plant": plant}
    if machine["kinematics"]["type"] == "axis":  # its file tells of dampers, not of modes
        return changed, {"share": share}
    return changed, {"share": [*(modes_of(changed, axis)["belt_damping_share"][0] for axis in range(2)), 0.0]}


def belt_hardening(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """With a fifth power that comes to a tenth of the third where the force is a half more."""
    cubic = size * springs(real) * (0.5 / rng.uniform(0.25e-3, 0.6e-3) ** 2)
    pulled = np.sum(turn_of(real.machine["kinematics"]["type"]) ** 2, axis=0)  # a file tells of axes, which both pull
    table = of_belts(real, cubic_n_per_m3=pulled * cubic)
    return table, real.having(cubic=cubic, quintic=0.1 * cubic / 1.6e-7)


def of_belts(real: Real, **values: FloatArray) -> dict[str, Any]:
    """Return forces of belts, (2,) each; those of a CoreXY's belts are told by the mean of both masses."""
    if real.machine["masses"] or real.machine["kinematics"]["type"] == "cartesian":
        return of_mass(real, **values)
    return {}


def sensor_gain(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """One of the two accelerometers' axes."""
    gain = size * np.append(np.eye(2)[rng.integers(2)], 0.0) * sign(rng) * rng.uniform(0.05, 0.15)
    return {"nozzle_relative_change": gain.tolist()}, real.read_by(lambda r: replace(r, nozzle=r.nozzle * (1 + gain)))


_SHARED = of_kind(SHARED, AXES)


def frame_mode(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """As everywhere; a file without masses does not tell the frame's either."""
    table, changed = _SHARED["frame_mode"](rng, size, real)
    keys = ("frequency_hz", "damping_ratio", *(["mass_kg"] if real.machine["masses"] else []), "direction")
    return {key: table[key] for key in keys}, changed


def growing_bed(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide a print that tapers, or widens: its mass is not quite in proportion to its height."""
    growth, taper = size * rng.uniform(0.8, 2.5), rng.uniform(-0.1, 0.1)
    machine = copy.deepcopy(real.machine)
    machine["print"] = {"growth_per_m": growth, "taper": taper, "high_m": 0.08}
    return {"growth_per_m": told(np.array([0.0, growth]))}, replace(real, machine=machine)


def toolhead_mode(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide a beam that gives way most in its middle; how ω² goes with x is told by no number of a file."""
    middle = _middle_mm(real) + rng.uniform(-15.0, 15.0)
    half = 0.5e-3 * real.machine["kinematics"]["x_range_mm"][1] + 0.02
    return {}, real.having(beam=size * rng.uniform(0.5, 1.2), beam_at=middle / 1e3, beam_half=half)


def gantry_racking(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide a gantry that yaws; as often as not its belts turn it too when they pull along x."""
    plant = real.machine["plant"]
    head, along = plant["carriage"][0] + plant["tool"][0], plant["carriage"][1]
    radius, hertz, ratio = rng.uniform(0.12, 0.3), rng.uniform(30.0, 80.0), rng.uniform(0.03, 0.08)
    arm, middle = rng.uniform(-0.03, 0.03) * (rng.random() < 0.5), _middle_mm(real) + rng.uniform(-15.0, 15.0)
    inertia, omega = head * radius**2 / max(size, 1e-9), 2 * np.pi * hertz
    table = {
        "radius_mm": float(1e3 * radius / np.sqrt(max(size, 1e-9))),
        "frequency_hz": hertz,
        "damping_ratio": ratio,
        "x_centre_mm": middle,
        "tool_share": head / along,
        "arm_mm": 1e3 * arm,
    }
    yaw = {"yaw": inertia, "yaw_k": inertia * omega**2, "yaw_b": 2 * ratio * omega * inertia}
    where = {"yaw_at": middle / 1e3, "yaw_arm": arm, "head": head}
    return table, real.having(**(yaw if size > 0 else {}), **where)


def _middle_mm(real: Real) -> float:
    return 0.5 * float(real.machine["kinematics"]["x_range_mm"][1])


_OWN = (
    belt_stiffness,
    belt_damping,
    belt_hardening,
    frame_mode,
    sensor_gain,
    growing_bed,
    toolhead_mode,
    gantry_racking,
)
_KNOWN: Mapping[str, Hide] = {**_SHARED, **{hide.__name__: hide for hide in _OWN}}
EVERYWHERE = (  # in the order in which the bank draws them
    "coulomb_friction",
    "stribeck_friction",
    "guide_damping",
    "belt_stiffness",
    "belt_damping",
    "belt_hardening",
    "belt_position_stiffness",
    "belt_backlash",
    "command_delay",
    "cogging",
    "torque_angle",
    "frame_mode",
    "sensor_gain",
    "sensor_time_offset",
    "sensor_clock_drift",
)


def effects_of(kind: str) -> Mapping[str, Hide]:
    """Return the effects that a printer of this kind can have: one chip feels x and y of a CoreXY only."""
    own = {"corexy": ("sensor_misalignment", "gantry_racking", "toolhead_mode"), "cartesian": ("growing_bed",)}
    more = own.get(kind, ())
    return {name: _KNOWN[name] for name in (*EVERYWHERE, *more)}
