"""One axis by itself, driven by a position: the first axis of `straight`, the other one at rest.

Its sensors are an encoder and an accelerometer on the load, or on the only mass.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from validation.blind import straight
from validation.blind.effects import presliding
from validation.blind.real import FloatArray, Hide, Labels, Real, Rng, Tables, off_by, sign, slowed
from validation.blind.straight import masses
from validation.plants.shapes import BREAKS, DAHL, TANH

SMOOTH = ("coulomb_friction", "stribeck_friction")
SHARED = ("guide_damping", "belt_damping", "belt_hardening", "belt_backlash", "cogging")
# its catalogue has notches, a force along the axis, and slow sensors
_OUTSIDE = """
    off_centre_pulley warming_belt slow_driver swinging_cable fans_tone creeping_belt heavy_rotor one_sided_belt
    clipping_sensor loose_load
"""
OUTSIDE: Mapping[str, Hide] = {name: straight.OUTSIDE[name] for name in _OUTSIDE.split()}
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
    """Write its owner's file: every number is off by a normal error."""
    plant = machine["plant"]
    axis = {
        "mass_kg": plant["carriage"][0],
        "stiffness_n_per_m": plant["belt_k"][0],
        "damping_n_s_per_m": plant["guide_b"][0],
    }
    if plant["tool"][0] > 0:
        axis |= {
            "load_mass_kg": plant["tool"][0],
            "coupling_stiffness_n_per_m": plant["mount_k"][0],
            "coupling_damping_n_s_per_m": plant["mount_b"][0],
        }
    off = off_by(error, rng)
    numbers = {key: off(value) for key, value in axis.items()}
    written: Tables = {"kinematics": {"type": "axis"}, "axis": {"input": "position", **numbers}}
    return written | ({"uncertainty": {"default": error}} if error > 0.02 else {})


def restated(tables: Labels, real: Tables, file: Tables) -> Labels:
    """Return the effects in the file's terms: a spring's change counts from the file's number, which is off."""
    if "belt_stiffness" not in tables:
        return tables
    two = real["plant"]["tool"][0] > 0
    stiffness = file["axis"]["coupling_stiffness_n_per_m" if two else "stiffness_n_per_m"]
    change = real["plant"]["mount_k" if two else "belt_k"][0] / stiffness - 1
    return {**tables, "belt_stiffness": {"relative_change": change}}


def alone(name: str, hide: Hide) -> Hide:
    """Return a printer's effect with the table of one axis.

    Friction turns over as a tanh: friction that bends before it slides has a name of its own here.
    """

    def hidden(rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
        table, changed = hide(rng, size, real)
        own = {key: value[0] if isinstance(value, list) else value for key, value in table.items()}
        return own, changed.having(dry_kind=TANH) if name.endswith("_friction") else changed

    return hidden


def belt_stiffness(rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
    """Hide a drive that is stiffer or softer than the file says."""
    return stiffened(rng, size, real, "mount_k" if real.machine["plant"]["tool"][0] > 0 else "belt_k")


def stiffened(rng: Rng, size: float, real: Real, which: str) -> tuple[Tables, Real]:
    """Hide a spring that is stiffer or softer than the file says."""
    change = size * sign(rng) * rng.uniform(0.12, 0.25)
    stiff = [k * (1 + change) for k in real.machine["plant"][which]]
    return {"relative_change": change}, real.changed("plant", **{which: stiff})


def bristle_friction(rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
    """Hide dry friction that bends before it slides."""
    return presliding_friction(rng, real, size * rng.uniform(1.2, 4.0) * masses(real)[0], rng.uniform(1.5e-5, 6e-5))


def presliding_friction(rng: Rng, real: Real, force: float, length: float) -> tuple[Tables, Real]:
    """Hide a friction of one of three laws; the label has its length for Dahl's only."""
    kind = int(rng.integers(DAHL, BREAKS + 1))
    fields = presliding(rng, np.full(2, force), kind, length)
    table = {"force_n": force} | ({"presliding_mm": 1e3 * length} if kind == DAHL else {})
    return table, real.having(dry=[force, force], dry_kind=kind, **fields)


def sensor_lag(rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
    """Hide an accelerometer behind a low-pass of second order."""
    cutoff = rng.uniform(70.0, 130.0) / max(size, 0.05)
    lag = [0.0, 0.0, 1 / (2 * np.pi * cutoff)]
    return {"time_constant_s": lag, "damping_ratio": np.sqrt(0.5)}, real.read_by(slowed(cutoff, size))


def command_delay(rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
    """Hide a drive that is late."""
    delay = size * rng.uniform(4e-4, 2e-3)

    def late(t: FloatArray, command: FloatArray) -> FloatArray:
        return np.column_stack([np.interp(t - delay, t, command[:, i]) for i in range(2)])

    return {"delay_s": delay}, real.ordered(late)


_PRINTERS = straight.effects_of("cartesian")
EFFECTS: Mapping[str, Hide] = {
    **{name: alone(name, _PRINTERS[name]) for name in SMOOTH},
    "bristle_friction": bristle_friction,
    **{name: alone(name, _PRINTERS[name]) for name in SHARED},
    "belt_stiffness": belt_stiffness,
    "command_delay": command_delay,
    "sensor_lag": sensor_lag,
}
