"""One axis by itself that a force drives, inside its servo: it moves along, or turns about its middle.

Its encoders are on the mass that is pushed and, of two masses, on both; an axis of one mass may have an accelerometer.
An axis that turns is pushed at its rim, `rim_m` from the middle: a torque is a force times the rim, an angle a distance
over the rim; its file and its runs are in rad, N m and kg m². Every other one is driven by a current whose torque
constant the file states. `EFFECTS[name]`, `TURNING[name]` and `OUTSIDE[name]` are as in `effects`.
"""

from __future__ import annotations

import copy
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from validation.blind import effects
from validation.blind.effects import by_name, of_kind
from validation.blind.motions import Motion, points
from validation.blind.real import FloatArray, Hide, Labels, Range, Reading, Real, Rng, Tables, larger, sign
from validation.blind.straight import AXIS, OF_PRINTERS, SHARED_BY_AXES, loose_load, masses, written
from validation.blind.straight import restated_axis as restated
from validation.plants.forced_axis import axis_of, follow, pushed, servo_of

STEP_S, KEPT_EVERY = 1 / 12800, 2
SHOT_S = 0.05  # spans over which a hidden effect is compared: in longer ones, a missing force moves the axis far away
PROBED = ("carriage", "ground", "belt_k", "belt_c", "tool")
OFFSET_N_PER_KG = 0.15  # error of a force's zero
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
    """Write its owner's file."""
    numbers = {"damping_n_s_per_m": machine["plant"]["ground"][0]}
    found = written(machine["plant"], "force", numbers, ("belt_k", "belt_c"), error, rng)
    zero = {} if error else {"offset_n": machine["plant"]["offset"]}  # of the force's sensor: usually unknown
    return {**found, "axis": {**found["axis"], "stiffness_n_per_m": 0.0, **zero}}


def probes(machine: Tables, by: float) -> Iterator[Tables]:
    """Yield the axis with one number larger by a share, one after the other; and with another zero of its force."""
    for key in PROBED:
        if machine["plant"][key][0] != 0.0:
            yield larger(machine, f"plant.{key}", by, 0)
    probed = copy.deepcopy(machine)
    moved = machine["plant"]["carriage"][0] + machine["plant"]["tool"][0]
    probed["plant"]["offset"] += by * OFFSET_N_PER_KG * moved / 0.02
    yield probed


# ---- runs ----------------------------------------------------------------------------------------


def played(real: Real, firmware: Mapping[str, Any], motion: Motion) -> Reading:
    """Return what perfect sensors read of a motion that the servo makes; 6400 samples a second."""
    path = np.ascontiguousarray(points(motion, 1 / STEP_S)[:, 0]) / 1e3
    push = np.gradient(np.gradient(path, STEP_S), STEP_S)
    servo = servo_of(real.machine)
    rng = np.random.default_rng([zlib.crc32(motion.name.encode()), len(path)])
    noise = 0.3 * servo.count_m * rng.standard_normal(len(path))
    out = follow(path, push, noise, STEP_S, KEPT_EVERY, axis_of(real.machine, real.fields), servo)
    t = STEP_S * KEPT_EVERY * np.arange(len(out), dtype=np.float64)
    return real.read(_reading(t, out, out[:, 3]), motion.name)


def _reading(t: FloatArray, out: FloatArray, force: FloatArray) -> Reading:
    """Return a reading of columns first mass, end, m, and the end's acceleration."""
    places = np.zeros((2, len(t), 3))
    places[0, :, 0], places[1, :, 0] = 1e3 * out[:, 0], 1e3 * out[:, 1]
    felt = np.zeros((len(t), 3))
    felt[:, 0] = out[:, 2]
    return Reading(t, np.zeros((len(t), 3)), felt, places[0], places[1], force)


def replayed(real: Real | None, reading: Reading) -> Reading:
    """Return what another axis would do under the same forces, each shot of which begins where the axis really was.

    The best line through each shot's places is taken away, because its beginning is not known so well. Without another
    axis the reading itself is returned in this form.
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
    """Return places, (n, 3), without the line of each shot; a part of a shot at the end counts nothing."""
    out = np.zeros_like(places)
    k = np.arange(shot) - (shot - 1) / 2
    whole = places[: len(places) // shot * shot].reshape(-1, shot, 3)
    slope = np.einsum("k,nkc->nc", k, whole) / (k @ k)
    bent = whole - whole.mean(axis=1, keepdims=True) - slope[:, None, :] * k[:, None]
    out[: bent.shape[0] * shot] = bent.reshape(-1, 3)
    return out


def given(machine: Tables, times: FloatArray, reading: Reading, rng: Rng) -> dict[str, FloatArray]:
    """Return the column of the recorded force, with its own noise."""
    assert reading.force is not None
    force = reading.force[:: round((len(reading.t) - 1) / (len(times) - 1))]
    noise = machine["servo"]["noise"] * float(np.std(force))
    return {"force_n": force + noise * rng.standard_normal(len(force))}


# ---- an axis that turns --------------------------------------------------------------------------

# ending of a key, that of an axis that turns, and the power of the rim that numbers are multiplied by
ENDINGS = (
    ("_n_s2_per_m2", "_n_m_s2_per_rad2", 3),
    ("_n_s_per_m", "_n_m_s_per_rad", 2),
    ("_n_per_m3", "_n_m_per_rad3", 4),
    ("_n_per_m", "_n_m_per_rad", 2),
    ("_kg", "_kg_m2", 2),
    ("_mm_per_s", "_rad_per_s", -1),
    ("_mm", "_rad", -1),
    ("_n", "_n_m", 1),
)


def turned(key: str, value: float, rim_m: float) -> tuple[str, float]:
    """Return a key and its number at the rim as those of the angle."""
    for ending, other, power in ENDINGS:
        if key.endswith(ending):
            stem = key.removesuffix(ending).replace("force", "torque").replace("mass", "inertia")
            return f"{stem}{other}", value * rim_m**power * (1e-3 if ending.startswith("_mm") else 1.0)
    return key, value


def turning_draw_machine(rng: Rng, names: Sequence[str] = ()) -> Tables:
    """Draw an axis, its rim, and its motor."""
    machine = draw_machine(rng, names)
    machine["rim_m"] = float(rng.uniform(0.02, 0.04))
    machine["n_m_per_a"] = float(rng.uniform(0.05, 0.5)) if rng.random() < 0.5 else 0.0  # 0: the torque is recorded
    return machine


def turning_file_of(machine: Tables, error: float, rng: Rng) -> Tables:
    """Write its owner's file: every number is off by a normal error."""
    written, constant = file_of(machine, error, rng), machine["n_m_per_a"]
    numbers = {key: value for key, value in written["axis"].items() if key != "input"}
    axis: Tables = {"input": "current" if constant else "force", "unit": "rad"}
    axis |= dict(turned(key, value, machine["rim_m"]) for key, value in numbers.items())
    if constant:
        axis["drive"] = {"torque_constant_n_m_per_a": constant}
    return {**written, "axis": axis}


def turning_restated(tables: Labels, real: Tables, file: Tables) -> Labels:
    """Return the effects in the file's terms."""
    said = {"axis": {"coupling_stiffness_n_per_m": _at_rim(file, real["rim_m"])}}
    found = restated(tables, real, said)
    return {name: dict(turned(key, x, real["rim_m"]) for key, x in table.items()) for name, table in found.items()}


def _at_rim(file: Tables, rim_m: float) -> float:
    return float(file["axis"].get("coupling_stiffness_n_m_per_rad", 0.0)) / rim_m**2


def turning_given(machine: Tables, times: FloatArray, reading: Reading, rng: Rng) -> dict[str, FloatArray]:
    """Return the column of the recorded torque, or of the current that makes it."""
    torque = machine["rim_m"] * given(machine, times, reading, rng)["force_n"]
    return {"current_a": torque / machine["n_m_per_a"]} if machine["n_m_per_a"] else {"torque_n_m": torque}


def turning_columns(machine: Tables, measured: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Return readings at the rim, mm and m/s², by the columns of an axis that turns."""
    units = {"pos": ("rad", 1e-3), "acc": ("rad_per_s2", 1.0)}
    return {f"{c}_{units[c[:3]][0]}": x * units[c[:3]][1] / machine["rim_m"] for c, x in measured.items()}


# ---- what they hide ------------------------------------------------------------------------------

LOUD_M_PER_S2 = 4.0  # under which a coupling that hardens has its usual stretch


def _stretched(real: Real) -> float:
    """Return the usual stretch of a coupling, m."""
    plant = real.machine["plant"]
    return LOUD_M_PER_S2 * (float(plant["tool"][0] / max(plant["belt_k"][0], 1e-9)) or 1.0)


FORCED = replace(AXIS, column=2, stretched=_stretched)


def _hides(
    field: str, low: float, high: float, key: str = "", by_mass: bool = True, signed: bool = False, **others: Range
) -> Hide:
    """Return what hides one number, for each kilogram that moves or as it is, and draws other fields with it."""

    def hide(rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
        value = size * (sign(rng) if signed else 1.0) * rng.uniform(low, high) * (masses(real)[0] if by_mass else 1.0)
        drawn = {name: rng.uniform(*between) for name, between in others.items()}
        return ({key: value} if key else {}), real.having(**{field: value, **drawn})

    return hide


TURN = (0.0, 2 * np.pi)


def cogging_force(rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
    """Hide the pull of magnets or teeth, with a second harmonic."""
    force, phase = size * rng.uniform(0.25, 1.0) * masses(real)[0], rng.uniform(0.0, 2 * np.pi)
    pitch = float(rng.choice([4.0, 5.0, 10.0, 16.0]))
    table = {"sine_n": force * np.cos(phase), "cosine_n": force * np.sin(phase), "pitch_mm": pitch}
    second = rng.uniform(0.03, 0.1)
    fields = {"tooth_wave": 2e3 * np.pi / pitch, "tooth_phase": phase, "tooth_second": second}
    return table, real.having(tooth=force, **fields)


EFFECTS: Mapping[str, Hide] = {
    **of_kind(SHARED_BY_AXES, FORCED, f"{OF_PRINTERS} cogging"),
    # a force that acts later than it is recorded; the delay wanders by a hundredth
    "command_delay": _hides("delay", 4e-4, 2e-3, "delay_s", by_mass=False, delay_pace=(15.0, 40.0), delay_phase=TURN),
    # viscous friction that is larger one way; it turns over within some mm/s
    "friction_by_direction": _hides("direction", 1.5, 6.0, "damping_difference_n_s_per_m", signed=True),
    "quadratic_drag": _hides("drag", 20.0, 80.0, "force_n_s2_per_m2"),
    # a hose that pulls to one place, by some thousandths more the farther it is bent
    "ground_spring": _hides("hose", 10.0, 50.0, "stiffness_n_per_m", hose_at=(0.3, 0.6)),
    **by_name(cogging_force),
}


def pendulum_gravity(rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
    """Hide an arm, not balanced, that hangs down somewhere near where the axis begins."""
    force, angle = size * rng.uniform(0.3, 1.5) * masses(real)[0], rng.uniform(-90.0, 90.0)
    wave = {"weight_wave": 1 / real.machine["rim_m"], "weight_at": np.radians(angle)}
    return {"force_n": force, "angle_deg": angle}, real.having(weight=force, **wave)


TURNING: Mapping[str, Hide] = {
    **EFFECTS,
    **by_name(pendulum_gravity),
    "friction_by_load": _hides("load", 0.05, 0.25, "share", by_mass=False),  # teeth rub as much as they pass on
}


# ---- outside the catalogue -----------------------------------------------------------------------


def weak_amplifier(rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
    """Hide an amplifier that gives less than it says the more is asked of it."""
    return {}, real.having(limit=rng.uniform(4.0, 8.0) * masses(real)[0] / size if size > 0 else 0.0)


def commutation(rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
    """Hide a motor whose force for one ampere goes up and down from magnet to magnet."""
    pitch = rng.uniform(8e-3, 16e-3)
    wave = {"commute_wave": 2 * np.pi / pitch, "commute_phase": rng.uniform(0.0, 2 * np.pi)}
    return {}, real.having(commute=size * rng.uniform(0.1, 0.25), **wave)


OUTSIDE: Mapping[str, Hide] = {
    "swinging_cable": partial(effects.swinging_cable, FORCED),
    **by_name(loose_load),
    # magnets that weaken while the motor works; before the next run they cool
    "warming_motor": _hides("fade", 0.12, 0.25, by_mass=False, fade_s=(0.5, 1.5)),
    **by_name(weak_amplifier, commutation),
    # a place where the rail pinches: dry friction there and nowhere else
    "bent_rail": _hides("bump", 1.0, 2.5, bump_at=(-8e-3, 8e-3), bump_wide=(3e-3, 8e-3)),
    # a spindle on the axis whose unbalance pushes it to and fro
    "unbalanced_spindle": _hides("spin", 0.3, 1.0, spin_wave=(40 * np.pi, 120 * np.pi)),
}
