"""One axis by itself: the first axis of `straight`, the other one at rest, driven by a position.

Its sensors are an encoder and an accelerometer on the load, or on the only mass. `servo` has those that a force drives.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from validation.blind import effects, straight
from validation.blind.effects import by_name, of_kind, presliding
from validation.blind.real import Drawn, FloatArray, Hide, Labels, Real, Rng, Tables, off_by, slowed
from validation.blind.straight import belt_damping, masses
from validation.plants.shapes import BREAKS, DAHL

OF_PRINTERS = (
    "belt_position_stiffness torque_angle frame_mode sensor_gain sensor_misalignment sensor_time_offset "
    "sensor_clock_drift"
)
NAMED = "missed_steps notched_wheel soft_bracket sluggish_sensor"  # by the catalogue of an axis, or of a printer only
played, probes = straight.played, straight.probes


def draw_machine(rng: Rng, names: object = ()) -> Tables:
    """Draw an axis: one mass on its drive, or two with a coupling between them."""
    mass, hertz, two = rng.uniform(0.4, 6.0), rng.uniform(25.0, 60.0), rng.random() < 0.4
    load = mass * rng.uniform(0.2, 0.5) if two else 0.0
    omega = 2 * np.pi * hertz
    coupling = load * (omega * rng.uniform(1.6, 2.4)) ** 2 if two else 1.0
    plant = {
        "carriage": mass - load,
        "tool": load,
        "belt_k": mass * omega**2,
        "guide_b": 2 * rng.uniform(0.04, 0.1) * mass * omega,
        "mount_k": coupling,
        "mount_b": 2 * rng.uniform(0.02, 0.05) * np.sqrt(coupling * load),
    }
    both = {key: [float(value)] * 2 for key, value in plant.items()}
    return {
        "kinematics": {"type": "axis"},
        "plant": {**both, "ground": [0.0, 0.0], "tool_ground": [0.0, 0.0]},
        "masses": True,
        "steps": {"full_steps_per_mm": 5.0},
    }


def file_of(machine: Tables, error: float, rng: Rng) -> Tables:
    """Write its owner's file."""
    plant = machine["plant"]
    numbers = {"stiffness_n_per_m": plant["belt_k"][0], "damping_n_s_per_m": plant["guide_b"][0]}
    return written(plant, "position", numbers, ("mount_k", "mount_b"), error, rng)


def written(
    plant: Tables, driven_by: str, numbers: Mapping[str, float], coupling: Sequence[str], error: float, rng: Rng
) -> Tables:
    """Return a machine file of an axis, every number of which is off by a normal error.

    coupling : names of the plant's stiffness and damping between two masses.
    """
    axis = {"mass_kg": plant["carriage"][0], **numbers}
    if plant["tool"][0] > 0:
        stiffness, damping = (plant[name][0] for name in coupling)
        axis |= {"load_mass_kg": plant["tool"][0]}
        axis |= {"coupling_stiffness_n_per_m": stiffness, "coupling_damping_n_s_per_m": damping}
    off = off_by(error, rng)
    told = {"input": driven_by, **{key: off(value) for key, value in axis.items()}}
    found: Tables = {"kinematics": {"type": "axis"}, "axis": told}
    return found | ({"uncertainty": {"default": error}} if error > 0.02 else {})


def restated(tables: Labels, real: Tables, file: Tables) -> Labels:
    """Return the effects in the file's terms: a spring's change counts from the file's number, which is off."""
    if "belt_stiffness" not in tables:
        return tables
    key = "coupling_stiffness_n_per_m" if real["plant"]["tool"][0] > 0 else "stiffness_n_per_m"
    change = real["plant"][spring_of(real)][0] / file["axis"][key] - 1
    return {**tables, "belt_stiffness": {"relative_change": change}}


def spring_of(machine: Tables) -> str:
    """Return the plant's name of the spring that decides how the load swings."""
    return "mount_k" if machine["plant"]["tool"][0] > 0 and "servo" not in machine else "belt_k"


def _stiffened(real: Real, by: FloatArray) -> Real:
    which = spring_of(real.machine)
    return real.changed("plant", **{which: (np.array(real.machine["plant"][which]) * (1 + by)).tolist()})


AXIS = replace(straight.AXES, motors=1, stiffened=_stiffened, bends=False)


def bristle_friction(kind: Drawn, rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
    """Hide a dry friction of one of three laws, that bends before it slides; the label has its length for Dahl's."""
    force, length = size * rng.uniform(*kind.friction) * masses(real), rng.uniform(1.5e-5, 1.2e-4)
    law = int(rng.integers(DAHL, BREAKS + 1))
    table = {"force_n": float(force[0])} | ({"presliding_mm": 1e3 * length} if law == DAHL else {})
    return table, real.having(dry=force, dry_kind=law, **presliding(rng, force, law, length))


def sensor_lag(rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
    """Hide an accelerometer behind a low-pass of second order."""
    cutoff = rng.uniform(70.0, 130.0) / max(size, 0.05)
    lag = [0.0, 0.0, 1 / (2 * np.pi * cutoff)]
    return {"time_constant_s": lag, "damping_ratio": np.sqrt(0.5)}, real.read_by(slowed(cutoff, size))


SHARED = {**effects.SHARED, **by_name(bristle_friction)}
EFFECTS: Mapping[str, Hide] = of_kind(SHARED, AXIS, OF_PRINTERS) | by_name(belt_damping, sensor_lag)
OUTSIDE: Mapping[str, Hide] = of_kind(effects.OUTSIDE, AXIS, NAMED) | by_name(straight.loose_load)
