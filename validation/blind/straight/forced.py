"""One axis by itself that a force drives, inside its servo: how it is drawn, its file, and its runs.

Its encoders are on the mass that is pushed and, of two masses, on both; an axis of one mass may have an accelerometer.
"""

from __future__ import annotations

import copy
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from validation.blind.printer.motions import Motion, points
from validation.blind.printer.real import FloatArray, Labels, Reading, Real, Rng, Tables
from validation.blind.straight.pushed import axis_of, follow, pushed, servo_of

STEP_S, KEPT_EVERY = 1 / 12800, 2
SHOT_S = 0.05  # in which what is hidden is looked for: longer, and a missing force would have moved the axis far away
PROBED = ("carriage", "ground", "belt_k", "belt_c", "tool")
OFFSET_N_PER_KG = 0.15  # by which the zero of a force may be off
OF_COUPLING = ("belt_stiffness", "belt_hardening", "belt_backlash")


def draw_machine(rng: Rng, names: Sequence[str] = ()) -> Tables:
    """Draw an axis and its servo: one mass, or two, as it must be where a coupling hides something."""
    moved, share = float(np.exp(rng.uniform(np.log(1.5), np.log(60.0)))), rng.uniform(0.25, 0.5)
    two = rng.random() < 0.4 or bool(set(names) & set(OF_COUPLING))
    load, omega = share * moved if two else 0.0, 2 * np.pi * rng.uniform(18.0, 45.0)
    stiff = load * omega**2 if two else 0.0
    plant = {
        "carriage": moved - load,
        "tool": load,
        "belt_k": stiff,
        "belt_c": 2 * rng.uniform(0.02, 0.06) * load * omega,
        "ground": rng.uniform(1.0, 5.0) * moved,
    }
    bandwidth, count = 2 * np.pi * rng.uniform(6.0, 13.0), float(rng.choice([5e-7, 1e-6, 2e-6]))
    servo = {
        "stiff": moved * bandwidth**2,
        "damp": 2 * rng.uniform(0.6, 0.9) * moved * bandwidth,
        "slow": rng.uniform(0.05, 0.2) * moved * bandwidth**3,
        "ahead": rng.uniform(0.8, 1.0) * moved,
        "filter_s": 1 / (2 * np.pi * rng.uniform(120.0, 250.0)),
        "lag_s": 1 / (2 * np.pi * rng.uniform(200.0, 400.0)),
        "pace_s": float(rng.choice([1 / 3200, 1 / 6400])),
        "count_m": count,
        "noise": rng.uniform(5e-4, 2e-3),  # of the force that is recorded, as a share
    }
    found = {key: [float(value)] * 2 for key, value in plant.items()}
    chip = not two and rng.random() < 0.3
    return {
        "kinematics": {"type": "axis"},
        "plant": {**found, "offset": float(rng.uniform(-0.1, 0.1) * moved)},
        "servo": servo,
        "sensors": "two-encoders" if two else "encoder-and-chip" if chip else "encoder",
        "masses": True,
        "steps": {"full_steps_per_mm": 5.0},
    }


def file_of(machine: Tables, error: float, rng: Rng) -> Tables:
    """Write what its owner's file says: every number off by a normal error."""
    plant = machine["plant"]
    axis = {"mass_kg": plant["carriage"][0], "damping_n_s_per_m": plant["ground"][0]}
    if plant["tool"][0] > 0:
        axis |= {
            "load_mass_kg": plant["tool"][0],
            "coupling_stiffness_n_per_m": plant["belt_k"][0],
            "coupling_damping_n_s_per_m": plant["belt_c"][0],
        }
    told = {key: value * (1 + error * float(np.clip(rng.standard_normal(), -2.0, 2.0))) for key, value in axis.items()}
    if error == 0.0:  # else nobody has looked at the zero of the force's sensor
        told["offset_n"] = plant["offset"]
    written: Tables = {
        "kinematics": {"type": "axis"},
        "axis": {"input": "force", "stiffness_n_per_m": 0.0, **told},
    }
    return written | ({"uncertainty": {"default": error}} if error > 0.02 else {})


def restated(tables: Labels, real: Tables, file: Tables) -> Labels:
    """Return the effects in the file's terms: a coupling's change counts from what the file says, which is off."""
    if "belt_stiffness" not in tables:
        return tables
    change = real["plant"]["belt_k"][0] / file["axis"]["coupling_stiffness_n_per_m"] - 1
    return {**tables, "belt_stiffness": {"relative_change": change}}


def probes(machine: Tables, by: float) -> Iterator[Tables]:
    """Yield the axis with one number larger by a share, one after the other; and with another zero of its force."""
    for key in PROBED:
        if machine["plant"][key][0] == 0.0:
            continue
        probed = copy.deepcopy(machine)
        probed["plant"][key][0] *= 1 + by
        yield probed
    probed = copy.deepcopy(machine)
    moved = machine["plant"]["carriage"][0] + machine["plant"]["tool"][0]
    probed["plant"]["offset"] += by * OFFSET_N_PER_KG * moved / 0.02
    yield probed


# ---- runs ----------------------------------------------------------------------------------------


def played(real: Real, firmware: Mapping[str, Any], motion: Motion, coarse: bool = False) -> Reading:
    """Return what the sensors say of a motion that the servo makes, before their noise; 6400 samples a second."""
    path = np.ascontiguousarray(points(motion, 1 / STEP_S)[:, 0]) / 1e3
    push = np.gradient(np.gradient(path, STEP_S), STEP_S)
    servo = servo_of(real.machine)
    rng = np.random.default_rng([zlib.crc32(motion.name.encode()), len(path)])
    noise = 0.3 * servo.count_m * rng.standard_normal(len(path))
    out = follow(path, push, noise, STEP_S, KEPT_EVERY, axis_of(real.machine, real.fields), servo)
    if not np.all(np.isfinite(out)):
        raise ValueError(f"The axis has come apart in the motion {motion.name}.")
    t = STEP_S * KEPT_EVERY * np.arange(len(out), dtype=np.float64)
    return _reading(t, out, out[:, 3])


def _reading(t: FloatArray, out: FloatArray, force: FloatArray) -> Reading:
    """Return a reading of columns first mass, end, m, and the end's acceleration."""
    places = np.zeros((2, len(t), 3))
    places[0, :, 0], places[1, :, 0] = 1e3 * out[:, 0], 1e3 * out[:, 1]
    felt = np.zeros((len(t), 3))
    felt[:, 0] = out[:, 2]
    return Reading(t, np.zeros((len(t), 3)), felt, places[0], places[1], force)


def replayed(real: Real | None, reading: Reading) -> Reading:
    """Return what another axis would do under the same forces, begun anew at every shot where the axis really was.

    Of each shot's places the line that fits them best is taken away, for nobody knows so well where it began. Without
    another axis the reading itself is told so.
    """
    t, shot = reading.t, round(SHOT_S / (reading.t[1] - reading.t[0]))
    h, found = float(t[1] - t[0]), reading
    assert reading.force is not None
    if real is not None:
        first, end = reading.carriage_mm[:, 0] / 1e3, reading.nozzle_mm[:, 0] / 1e3
        begin = np.column_stack([first, np.gradient(first, h), end, np.gradient(end, h)])
        out = pushed(reading.force, begin, shot, h, axis_of(real.machine, real.fields))
        found = _reading(t, out, reading.force)
    return replace(found, carriage_mm=_bent(found.carriage_mm, shot), nozzle_mm=_bent(found.nozzle_mm, shot))


def _bent(places: FloatArray, shot: int) -> FloatArray:
    """Return places, (n, 3), without the line of each shot; what is left of a shot at the end counts nothing."""
    out = np.zeros_like(places)
    k = np.arange(shot) - (shot - 1) / 2
    whole = places[: len(places) // shot * shot].reshape(-1, shot, 3)
    slope = np.einsum("k,nkc->nc", k, whole) / (k @ k)
    bent = whole - whole.mean(axis=1, keepdims=True) - slope[:, None, :] * k[:, None]
    out[: bent.shape[0] * shot] = bent.reshape(-1, 3)
    return out


def given(machine: Tables, times: FloatArray, reading: Reading, rng: Rng) -> dict[str, FloatArray]:
    """Return the column of the force as it is recorded, with its own noise."""
    assert reading.force is not None
    force = reading.force[:: round((len(reading.t) - 1) / (len(times) - 1))]
    noise = machine["servo"]["noise"] * float(np.std(force))
    return {"force_n": force + noise * rng.standard_normal(len(force))}
