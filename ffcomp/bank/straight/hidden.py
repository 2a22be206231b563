"""The effects of the catalogue as a real printer with straight axes has them, in shapes that are not the files'.

`effects_of(kind)[name](rng, size, real)` → (the table a machine file would have to hold, the printer with the effect).
The same seed with another `size` is the same effect, larger or smaller; with size zero nothing is hidden.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from ffcomp.bank.printer.drawn import told
from ffcomp.bank.printer.hidden import SHARED, of_kind
from ffcomp.bank.printer.real import FloatArray, Hide, Real, Rng, sign
from ffcomp.bank.straight.drawn import AXES, of_mass, springs
from ffcomp.bank.straight.numbers import turn_of


def belt_stiffness(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Both belts; or one only, which on a CoreXY lets x and y exchange motion."""
    one = np.eye(2)[rng.integers(2)] if rng.random() < 0.5 else np.ones(2)
    change = size * one * sign(rng) * rng.uniform(0.12, 0.25)
    stiffness = springs(real) * (1 + change)
    return {"relative_change": told(change)}, real.changed("plant", belt_k=stiffness.tolist())


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


_OWN = (belt_stiffness, belt_hardening, frame_mode, sensor_gain)
_KNOWN: Mapping[str, Hide] = {**_SHARED, **{hide.__name__: hide for hide in _OWN}}
EVERYWHERE = (  # in the order in which the bank draws them
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
    "frame_mode",
    "sensor_gain",
    "sensor_time_offset",
    "sensor_clock_drift",
)


def effects_of(kind: str) -> Mapping[str, Hide]:
    """Return the effects that a printer of this kind can have: one chip feels x and y of a CoreXY only."""
    more = ("sensor_misalignment",) if kind == "corexy" else ()
    return {name: _KNOWN[name] for name in (*EVERYWHERE, *more)}
