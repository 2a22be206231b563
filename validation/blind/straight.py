"""Hidden printers with straight axes: how they and their owners' files are drawn, what they can hide, how they move.

The printer is `plants.straight_plant`. `effects_of(kind)[name]` and `OUTSIDE[name]` are as in `effects`. One axis by
itself is the first of two, the other one at rest, driven by a position, with an encoder and an accelerometer on the
load, or on the only mass; `servo` has those that a force drives.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from validation.blind import effects
from validation.blind.effects import SHARED, Drawn, by_name, of_kind, presliding
from validation.blind.motions import Motion, Place, points
from validation.blind.real import FloatArray, Hide, Labels, Reading, Real, Rng, Tables, larger, off_by, slowed, told
from validation.plants import straight_plant as plant
from validation.plants.shapes import BREAKS, DAHL
from validation.plants.straight_plant import turn_of

STEP_S, KEPT_EVERY = 1 / 12800, 2
ONE_BODY = ("gantry_racking", "toolhead_mode", "growing_bed")
PROBED = ("belt_k", "guide_b", "mount_k", "tool")


def modes_of(machine: Tables, axis: int) -> dict[str, list[float]]:
    """Return the modes of an axis as a machine file has them; `draw_machine` makes the dampers proportional."""
    return plant.modes_of(machine["plant"], turn_of(machine["kinematics"]["type"]), axis)


def draw_machine(rng: Rng, kind: str, names: Sequence[str] = ()) -> Tables:
    """Draw a printer: the tables of a machine file, and `plant`, its masses, springs and dampers.

    The dampers are αM + βK, so that its modes stay real and a file with modes can state all of it. Where a gantry will
    rack, its beam give way, or a print ride on the bed, one body moves along y, because the catalogue is exact for it;
    the head of a racking gantry is its lighter part.
    """
    slinger, turn = kind == "cartesian", turn_of(kind)
    mass = np.array([rng.uniform(0.3, 0.6), rng.uniform(0.5, 1.2)])
    if "gantry_racking" in names:
        mass[1] = max(mass[1], rng.uniform(1.3, 2.0) * mass[0])
    hertz = np.array([rng.uniform(38, 65), rng.uniform(26, 45)])
    if not slinger:  # both belts pull along both axes
        hertz[1] = hertz[0] * np.sqrt(mass[0] / mass[1])
    two = rng.random(2) < ([0.5, 0.25] if slinger else [0.5, 0.5])
    two[1] = two[1] and not set(ONE_BODY) & set(names)
    tool = np.where(two, mass * rng.uniform(0.12, 0.3, 2), 0.0)
    stiff = mass * (2 * np.pi * hertz) ** 2
    mount = np.where(two, tool * (2 * np.pi * hertz * rng.uniform(1.8, 2.6, 2)) ** 2, 1.0)
    alpha, beta = rng.uniform(6.0, 18.0), rng.uniform(1e-4, 3e-4)
    plant = {
        "carriage": mass - tool,
        "tool": tool,
        "belt_k": stiff / np.sum(turn**2, axis=0),
        "mount_k": mount,
        "mount_b": np.where(two, beta * mount, 0.0),
        "guide_b": beta * stiff,
        "ground": alpha * (mass - tool),
        "tool_ground": alpha * tool,
    }
    machine: Tables = {"kinematics": {"type": kind}, "plant": {key: value.tolist() for key, value in plant.items()}}
    for axis, size in zip("xyz", rng.choice([180.0, 220.0, 250.0, 300.0], 3), strict=True):
        machine["kinematics"][f"{axis}_range_mm"] = [0.0, float(size)]
    machine["masses"] = bool(rng.random() < 0.5)
    machine["limits"] = {"velocity_mm_per_s": 300.0, "acceleration_mm_per_s2": 10000.0}
    full = float(rng.choice([5.0, 6.25]))
    machine["steps"] = {"steps_per_mm": 80.0, "full_steps_per_mm": full}
    return machine


def places(machine: Tables, rng: Rng) -> list[Place]:
    """Draw where the motions are made: in the middle of the bed, and about it."""
    size = [machine["kinematics"][f"{axis}_range_mm"][1] for axis in "xy"]
    middle: Place = (size[0] / 2, size[1] / 2, 30.0)
    shares = [(0.25, 0.7), (0.75, 0.3), (0.3, 0.25), (0.7, 0.72), (0.5, 0.25)]
    moved = [(x + rng.uniform(-0.05, 0.05), y + rng.uniform(-0.05, 0.05)) for x, y in shares]
    return [middle, *((size[0] * x, size[1] * y, float(rng.uniform(15, 140))) for x, y in moved)]


def file_of(machine: Tables, error: float, rng: Rng) -> Tables:
    """Write what the owner's file says: frequencies, damping ratios and masses off by a normal error."""
    off, axes = off_by(error, rng), dict[str, Any]()
    for axis in range(2):
        modes = modes_of(machine, axis)
        told = {key: [off(x) for x in modes[key]] for key in ("frequency_hz", "damping_ratio")}
        axes["xy"[axis]] = {**told, "share": modes["share"]}
        if machine["masses"]:
            axes["xy"[axis]]["mass_kg"] = machine["plant"]["carriage"][axis] + machine["plant"]["tool"][axis]
    written = {key: copy.deepcopy(machine[key]) for key in ("kinematics", "limits", "steps")} | {"axes": axes}
    return written | ({"uncertainty": {"default": error}} if error > 0.02 else {})


def restated(tables: Labels, real: Tables, file: Tables) -> Labels:
    """Return the effects in the file's terms: a belt's change counts from the file's axis, which is off.

    Each belt of a CoreXY pulls along both axes, and the file may be wrong in opposite ways: there it stays.
    """
    change = tables.get("belt_stiffness", {}).get("relative_change")
    if change is None or real["kinematics"]["type"] == "corexy":
        return tables
    found = [
        (modes_of(real, axis)["frequency_hz"][0] / file["axes"]["xy"[axis]]["frequency_hz"][0]) ** 2 - 1
        for axis in range(2)
    ]
    touched = np.broadcast_to(change, 3)[:2] != 0
    return {**tables, "belt_stiffness": {"relative_change": told(np.where(touched, found, 0.0))}}


def probes(machine: Tables, by: float) -> Iterator[Tables]:
    """Yield the machine with one number larger by a share, one after the other."""
    for key in PROBED:
        for n in range(2):
            if machine["plant"][key][n] == 0.0:
                continue
            probed = larger(machine, f"plant.{key}", by, n)
            if key == "tool":
                probed["plant"]["carriage"][n] -= by * machine["plant"]["tool"][n]
            yield probed


def _printed(machine: Tables, height_mm: float) -> Tables:
    """Return the printer with a print of this height on its bed."""
    if "print" not in machine:
        return machine
    plant, z = copy.deepcopy(machine["plant"]), height_mm / 1e3
    tapered = 1 + machine["print"]["taper"] * (1 - z / machine["print"]["high_m"])
    plant["carriage"][1] *= 1 + machine["print"]["growth_per_m"] * z * tapered
    return {**machine, "plant": plant}


def played(real: Real, firmware: Mapping[str, Any], motion: Motion) -> Reading:
    """Return what perfect sensors read of a motion; 6400 samples a second."""
    path = points(motion, 2 / STEP_S)
    command = np.ascontiguousarray(real.order(path[:, :2] @ turn_of(firmware["type"]).T, STEP_S / 2) / 1e3)
    p = plant.printer_of(_printed(real.machine, path[0, 2]), real.fields)
    speed = np.gradient(command, STEP_S / 2, axis=0)
    out = plant.run(command, speed, STEP_S, KEPT_EVERY, p, plant.at_rest(command[0], p), 0.0)
    still, rigid = np.zeros((len(out), 3)), np.zeros((len(out), 1))
    felt, there = np.hstack([out[:, 1], rigid]), np.hstack([1e3 * out[:, 0], rigid])
    t = STEP_S * KEPT_EVERY * np.arange(len(out), dtype=np.float64)
    return real.read(Reading(t, still, felt, still, there), motion.name)


# ---- what they hide ------------------------------------------------------------------------------


def masses(real: Real) -> FloatArray:
    """Return all that each axis moves, (2,) kg."""
    return np.array(real.machine["plant"]["carriage"]) + np.array(real.machine["plant"]["tool"])


def springs(real: Real) -> FloatArray:
    """Return the stiffness of each belt, (2,) N/m."""
    return np.array(real.machine["plant"]["belt_k"])


def of_mass(real: Real, **values: FloatArray) -> Tables:
    """Return forces of the axes, (2,) each, by a file's keys: per kilogram where it states no masses."""
    if real.machine["masses"]:
        return {key: told(value) for key, value in values.items()}
    return {f"{key}_per_kg": told(value / masses(real)) for key, value in values.items()}


def of_belts(real: Real, **values: FloatArray) -> Tables:
    """Return forces of belts, (2,) each; those of a CoreXY's belts, which pull both axes, are not stated per mass."""
    if real.machine["masses"] or real.machine["kinematics"]["type"] == "cartesian":
        pulled = np.sum(turn_of(real.machine["kinematics"]["type"]) ** 2, axis=0)  # a file states axes
        return of_mass(real, **{key: pulled * value for key, value in values.items()})
    return {}


AXES = Drawn(
    column=1,
    motors=2,
    loads=masses,
    forces=of_mass,
    springs=springs,
    stiffened=lambda real, by: real.changed("plant", belt_k=(springs(real) * (1 + by)).tolist()),
    of_belts=of_belts,
    felt=(0.0, 0.0, 0.0, 1.0, 1.0, 0.0),
)


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
    if machine["kinematics"]["type"] == "axis":  # its file states dampers, not modes
        return changed, {"share": share}
    return changed, {"share": [*(modes_of(changed, axis)["belt_damping_share"][0] for axis in range(2)), 0.0]}


def frame_mode(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """As everywhere; a file without masses has no frame's mass either."""
    table, changed = effects.frame_mode(AXES, rng, size, real)
    keys = ("frequency_hz", "damping_ratio", *(["mass_kg"] if real.machine["masses"] else []), "direction")
    return {key: table[key] for key in keys}, changed


def growing_bed(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide a print that tapers, or widens: its mass is not quite in proportion to its height."""
    growth, taper = size * rng.uniform(0.8, 2.5), rng.uniform(-0.1, 0.1)
    machine = copy.deepcopy(real.machine)
    machine["print"] = {"growth_per_m": growth, "taper": taper, "high_m": 0.08}
    return {"growth_per_m": told(np.array([0.0, growth]))}, replace(real, machine=machine)


def toolhead_mode(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide a beam that gives way most in its middle; no number of a file states how ω² goes with x."""
    middle = _middle_mm(real) + rng.uniform(-15.0, 15.0)
    half, beam = 0.5e-3 * real.machine["kinematics"]["x_range_mm"][1] + 0.02, size * rng.uniform(0.5, 1.2)
    return {}, real.having(beam=beam, beam_gain=1 + beam, beam_at=middle / 1e3, beam_half=half)


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


def effects_of(kind: str) -> Mapping[str, Hide]:
    """Return the effects that a printer of this kind can have: one chip feels x and y of a CoreXY only."""
    of_one = {"corexy": by_name(gantry_racking, toolhead_mode), "cartesian": by_name(growing_bed)}
    lacking = "" if kind == "corexy" else "sensor_misalignment"
    return of_kind(SHARED, AXES, lacking) | by_name(belt_damping, frame_mode) | of_one[kind]


def loose_load(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide a loose tray, spool or load on what moves: it slides where it is pushed harder than friction holds it."""
    plant = real.machine["plant"]
    carries = plant["tool"] if "servo" in real.machine and plant["tool"][0] else plant["carriage"]
    share, grip = size * rng.uniform(0.15, 0.3), rng.uniform(0.8, 2.5)
    return {}, real.having(loose=share * np.array(carries), loose_grip=grip)


OUTSIDE: Mapping[str, Hide] = of_kind(effects.OUTSIDE, AXES) | by_name(loose_load)


# ---- one axis by itself, driven by a position ---------------------------------------------------

OF_PRINTERS = (
    "belt_position_stiffness torque_angle frame_mode sensor_gain sensor_misalignment sensor_time_offset "
    "sensor_clock_drift"
)
NAMED = "missed_steps notched_wheel soft_bracket sluggish_sensor"  # by the catalogue of an axis, or of a printer only


def draw_axis(rng: Rng, names: object = ()) -> Tables:
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


def file_of_axis(machine: Tables, error: float, rng: Rng) -> Tables:
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


def restated_axis(tables: Labels, real: Tables, file: Tables) -> Labels:
    """Return the effects in the file's terms: a spring's change counts from the file's number, which is off."""
    if "belt_stiffness" not in tables:
        return tables
    key = "coupling_stiffness_n_per_m" if real["plant"]["tool"][0] > 0 else "stiffness_n_per_m"
    change = real["plant"][spring_of(real)][0] / file["axis"][key] - 1
    return {**tables, "belt_stiffness": {"relative_change": change}}


def spring_of(machine: Tables) -> str:
    """Return the plant's name of the spring that decides how the load swings."""
    return "mount_k" if machine["plant"]["tool"][0] > 0 and "servo" not in machine else "belt_k"


def _stiffened_axis(real: Real, by: FloatArray) -> Real:
    which = spring_of(real.machine)
    return real.changed("plant", **{which: (np.array(real.machine["plant"][which]) * (1 + by)).tolist()})


AXIS = replace(AXES, motors=1, stiffened=_stiffened_axis, bends=False)


def bristle_friction(kind: Drawn, rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
    """Hide a dry friction of one of three laws, that bends before it slides; the label has its length for Dahl's."""
    force, length = size * kind.draw(rng, "friction") * masses(real), rng.uniform(1.5e-5, 1.2e-4)
    law = int(rng.integers(DAHL, BREAKS + 1))
    table = {"force_n": float(force[0])} | ({"presliding_mm": 1e3 * length} if law == DAHL else {})
    return table, real.having(dry=force, dry_kind=law, **presliding(rng, force, law, length))


def sensor_lag(rng: Rng, size: float, real: Real) -> tuple[Tables, Real]:
    """Hide an accelerometer behind a low-pass of second order."""
    cutoff = rng.uniform(70.0, 130.0) / max(size, 0.05)
    lag = [0.0, 0.0, 1 / (2 * np.pi * cutoff)]
    return {"time_constant_s": lag, "damping_ratio": np.sqrt(0.5)}, real.read_by(slowed(cutoff, size))


SHARED_BY_AXES = {**SHARED, **by_name(bristle_friction)}
EFFECTS_OF_AXIS: Mapping[str, Hide] = of_kind(SHARED_BY_AXES, AXIS, OF_PRINTERS) | by_name(belt_damping, sensor_lag)
OUTSIDE_OF_AXIS: Mapping[str, Hide] = of_kind(effects.OUTSIDE, AXIS, NAMED) | by_name(loose_load)
