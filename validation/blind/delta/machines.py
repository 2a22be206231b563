"""Printers drawn around several real ones, and what their owner's file says of them."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from validation.blind.printer.drawn import told
from validation.blind.printer.real import Labels, Tables

_SIZES: Mapping[str, tuple[float, float, float]] = {  # arm mm, effective radius mm, joint radius mm
    "middling": (300.0, 140.0, 39.9),
    "small": (230.0, 105.0, 30.0),
    "large": (340.0, 165.0, 42.0),
}
DYNAMIC = {
    "carriage": (
        "mass_kg",
        "arm_pair_mass_kg",
        "belt_stiffness_n_per_m",
        "belt_damping_n_s_per_m",
        "guide_damping_n_s_per_m",
    ),
    "effector": (
        "nozzle_mass_kg",
        "extruder_mass_kg",
        "extruder_stiffness_n_per_m",
        "extruder_damping_n_s_per_m",
    ),
}
DAMPERS = ("carriage.belt_damping_n_s_per_m", "carriage.guide_damping_n_s_per_m")


def draw_machine(rng: np.random.Generator) -> Tables:
    """Return a printer as it really is, in the tables of a machine file; lengths as the firmware has them."""
    arm, radius, joint = _SIZES[str(rng.choice(list(_SIZES)))]
    stretch, first_deg = rng.uniform(0.95, 1.06), float(rng.choice([0.0, 30.0, 90.0, 210.0]))

    def about(value: float, spread: float = 0.2) -> float:
        return float(value * np.exp(rng.uniform(-spread, spread)))

    machine: Tables = {
        "kinematics": {
            "type": "delta",
            "arm_length_mm": round(arm * stretch, 3),
            "delta_radius_mm": round(radius * stretch * rng.uniform(0.98, 1.02), 3),
            "tower_angles_deg": [(first_deg + 120.0 * i) % 360.0 for i in range(3)],
            "effector_height_mm": 50.0,
            "print_radius_mm": round(0.8 * radius, 1),
            "print_height_mm": 250.0,
        },
        "carriage": {
            "mass_kg": about(0.18),
            "arm_pair_mass_kg": about(0.032),
            "belt_stiffness_n_per_m": about(1.2e5),
            "belt_damping_n_s_per_m": about(5.3),
            "guide_damping_n_s_per_m": about(14.0),
        },
        "effector": {
            "nozzle_mass_kg": about(0.45),
            "extruder_mass_kg": about(0.108),
            "extruder_stiffness_n_per_m": [about(x) for x in (4.0e3, 7.0e3, 1.3e5)],
            "extruder_damping_n_s_per_m": [about(x) for x in (20.0, 40.0, 20.0)],
            "joint_radius_mm": joint,
            "center_of_mass_mm": [0.0, 0.0, 0.0],
            "force_map": "virtual_work",
        },
        "steps": {"steps_per_mm": 80.0, "full_steps_per_mm": float(rng.choice([5.0, 6.25]))},
        "limits": {"velocity_mm_per_s": 300.0, "acceleration_mm_per_s2": 10000.0},
    }
    if rng.random() < 0.8:  # the others follow their command without a filter
        machine["carriage"]["drive"] = {
            "d0_per_s2": about(1.5e5),
            "d1_per_s": about(-130.0, 0.4),
            "d2_per_s": about(55.0, 0.4),
        }
    return machine


def file_of(machine: Tables, error: float, rng: np.random.Generator) -> Tables:
    """Return what the owner's file says: every dynamic number off by a normal error, within two deviations."""
    written = copy.deepcopy(machine)

    def off(value: Any) -> Any:
        if isinstance(value, list):
            return [off(x) for x in value]
        return value * (1 + error * float(np.clip(rng.standard_normal(), -2.0, 2.0)))

    for table, keys in DYNAMIC.items():
        for key in keys:
            written[table][key] = off(written[table][key])
    drive = written["carriage"].get("drive", {})
    for key in drive:
        drive[key] = off(drive[key])
    if error > 0.02:
        written["uncertainty"] = {"default": error}
    return written


def restated(tables: Labels, real: Tables, file: Tables) -> Labels:
    """Return the effects in the file's terms: a change of one of its numbers counts from what it says, which is off."""
    found = {name: dict(table) for name, table in tables.items()}
    stiff, light, damped = (
        np.asarray(real[table][key]) / np.asarray(file[table][key]) - 1
        for table, key in (
            ("carriage", "belt_stiffness_n_per_m"),
            ("effector", "extruder_stiffness_n_per_m"),
            ("effector", "extruder_damping_n_s_per_m"),
        )
    )
    if "belt_stiffness" in found:
        found["belt_stiffness"]["relative_change"] = told(np.broadcast_to(stiff, 3))
    if "effector_mass" in found:
        found["effector_mass"]["added_kg"] = real["effector"]["nozzle_mass_kg"] - file["effector"]["nozzle_mass_kg"]
    for key, changed in (("relative_stiffness_change", light), ("relative_damping_change", damped)):
        if key in found.get("extruder_mount", {}):
            touched = np.array(found["extruder_mount"][key]) != 0
            found["extruder_mount"][key] = np.where(touched, changed, 0.0).tolist()
    return found


def probes(machine: Tables, by: float) -> Iterator[Tables]:
    """Yield the machine with one dynamic number larger by a share, one after the other."""
    keys = [(table, key) for table, names in DYNAMIC.items() for key in names]
    for table, key in keys:
        for n in range(np.size(machine[table][key]) if table == "effector" else 1):
            probed = copy.deepcopy(machine)
            grown = np.array(probed[table][key], dtype=float)
            grown[n if grown.ndim and table == "effector" else ...] *= 1 + by
            probed[table][key] = grown.tolist()
            yield probed
    for key in machine["carriage"].get("drive", {}):
        probed = copy.deepcopy(machine)
        probed["carriage"]["drive"][key] *= 1 + by
        yield probed


def damped_by_belts(machine: Tables, share: float) -> tuple[Tables, dict[str, Any]]:
    """Return the printer with so much of its carriages' damping in its belts; a file has a number for each."""
    share = min(max(share, 0.01), 0.99)  # no number of a file is zero
    belt, guide = (key.partition(".")[2] for key in DAMPERS)
    damping = machine["carriage"][belt] + machine["carriage"][guide]
    return {**machine, "carriage": machine["carriage"] | {belt: share * damping, guide: (1 - share) * damping}}, {}
