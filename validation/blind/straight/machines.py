"""Printers with straight axes as they really are, what their owner's file says of them, and how they move."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from validation.blind.printer.drawn import told
from validation.blind.printer.motions import Motion, points
from validation.blind.printer.real import FloatArray, Labels, Reading, Real, Tables
from validation.blind.straight.equations import run
from validation.blind.straight.numbers import modes_of, printer_of, turn_of

STEP_S = 1 / 12800
KEPT_EVERY = 2
COARSE_STEP_S = 1 / 6400
ONE_BODY = ("gantry_racking", "toolhead_mode", "growing_bed")
PROBED = ("belt_k", "guide_b", "mount_k", "tool")


def draw_machine(rng: np.random.Generator, kind: str, names: Sequence[str] = ()) -> Tables:
    """Draw a printer: the tables of a machine file, and `plant`, its masses, springs and dampers.

    The dampers are αM + βK, so that its modes stay real: a file with modes can then tell all of it. Where a gantry will
    rack, its beam give way, or a print ride on the bed, what moves along y is one body, for which the catalogue is
    exact; the head of a racking one is its lighter part.
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


def file_of(machine: Tables, error: float, rng: np.random.Generator) -> Tables:
    """Write what the owner's file says: frequencies, damping ratios and masses off by a normal error."""

    def off(value: float) -> float:
        return value * (1 + error * float(np.clip(rng.standard_normal(), -2.0, 2.0)))

    axes: dict[str, Any] = {}
    for axis in range(2):
        modes = modes_of(machine, axis)
        told = {key: [off(x) for x in modes[key]] for key in ("frequency_hz", "damping_ratio")}
        axes["xy"[axis]] = {**told, "share": modes["share"]}
        if machine["masses"]:
            axes["xy"[axis]]["mass_kg"] = machine["plant"]["carriage"][axis] + machine["plant"]["tool"][axis]
    written = {key: copy.deepcopy(machine[key]) for key in ("kinematics", "limits", "steps")} | {"axes": axes}
    return written | ({"uncertainty": {"default": error}} if error > 0.02 else {})


def restated(tables: Labels, real: Tables, file: Tables) -> Labels:
    """Return the effects in the file's terms: a belt's change counts from what the file says of its axis, which is off.

    Each belt of a CoreXY pulls along both axes, of which the file may be wrong in opposite ways: there it stays.
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
            probed = copy.deepcopy(machine)
            probed["plant"][key][n] *= 1 + by
            if key == "tool":
                probed["plant"]["carriage"][n] -= by * machine["plant"]["tool"][n]
            yield probed


def order_of(firmware: Mapping[str, Any], path: FloatArray) -> FloatArray:
    """Return where firmware sends the motors, (n, 2) mm, for nozzle paths (n, 3) mm."""
    return path[:, :2] @ turn_of(firmware["type"]).T


def _printed(machine: Tables, height_mm: float) -> Tables:
    """Return the printer with a print of this height on its bed."""
    if "print" not in machine:
        return machine
    plant, z = copy.deepcopy(machine["plant"]), height_mm / 1e3
    tapered = 1 + machine["print"]["taper"] * (1 - z / machine["print"]["high_m"])
    plant["carriage"][1] *= 1 + machine["print"]["growth_per_m"] * z * tapered
    return {**machine, "plant": plant}


def played(real: Real, firmware: Mapping[str, Any], motion: Motion, coarse: bool = False) -> Reading:
    """Return what the real printer's sensors say of a motion, before their noise; 6400 samples a second."""
    step = COARSE_STEP_S if coarse else STEP_S
    path = points(motion, 2 / step)
    command = order_of(firmware, path)
    for order in real.orders:
        command = order(step / 2 * np.arange(len(command), dtype=np.float64), command)
    command = np.ascontiguousarray(command / 1e3)
    every = 1 if coarse else KEPT_EVERY
    out = run(
        command,
        np.gradient(command, step / 2, axis=0),
        step,
        every,
        printer_of(_printed(real.machine, path[0, 2]), real.fields),
    )
    if not np.all(np.isfinite(out)):
        raise ValueError(f"The printer has come apart in the motion {motion.name}.")
    t = step * every * np.arange(len(out), dtype=np.float64)
    rigid = np.zeros((len(out), 1))
    reading = Reading(t, np.zeros((len(out), 3)), np.hstack([out[:, 1], rigid]), np.zeros((len(out), 3)),
                      np.hstack([1e3 * out[:, 0], rigid]))  # fmt: skip
    for reader in real.readers:
        reading = reader(reading)
    return reading
