"""The numbers of one printer and of all that it may hide, as compiled code wants them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

PRINTER = np.dtype(
    [
        ("towers", "f8", (3, 2)),  # m
        ("arms", "f8", 3),  # m
        ("height", "f8"),  # m
        ("carriage", "f8", 3),  # kg, with half an arm pair
        ("holder", "f8"),  # kg, with three halves
        ("rods", "f8"),  # kg, by how much mass along the arms is less than at their ends
        ("extruder", "f8"),  # kg
        ("belt_k", "f8", 3),  # N/m
        ("belt_c", "f8", 3),  # N s/m
        ("guide_b", "f8", 3),  # N s/m
        ("mount_k", "f8", 3),  # N/m
        ("mount_b", "f8", 3),  # N s/m
        ("shares", "f8", (3, 3, 3)),  # P_i; unit matrices for virtual work
        ("ideal", "?"),
        ("drive", "f8", 3),
        ("rotor", "f8", 3),  # kg, of a motor that stands between its magnets and its belt; 0: it goes where it is sent
        ("rotor_k", "f8", 3),
        ("rotor_b", "f8", 3),
        # friction of the guides: kind 0 none, else of `shapes`
        ("dry_kind", "i8"),
        ("dry", "f8", 3),  # N
        ("stick", "f8", 3),  # N, more at rest
        ("stick_v", "f8"),  # m/s
        ("stick_power", "f8"),
        ("dry_v", "f8"),  # m/s, of the tanh
        ("bristle", "f8"),  # m, deflection that slides
        ("micro", "f8"),  # N s/m, while it bends
        ("breaks", "f8"),  # share of the deflection up to which nothing slides
        ("grease", "f8", 3),  # N s/m, shear-thinning
        ("joint", "f8"),  # N
        ("joint_bristle", "f8"),  # m
        # belts
        ("cubic", "f8", 3),  # N/m³
        ("quintic", "f8", 3),  # N/m⁵
        ("slope", "f8", 3),  # 1/m
        ("lean", "f8", 3),  # share by which it is stiffer pulled, and softer pushed
        ("slope_at", "f8", 3),  # m
        ("play", "f8", 3),  # m, whole width
        ("flank", "f8"),  # m, softness of its edges
        ("landing", "f8"),  # s/m, damping while it closes
        ("stepper", "f8", 3),  # m, F_peak/k; 0 for none
        ("stepper_share", "f8"),  # of the compliance that is the stepper's
        # motors
        ("ripple", "f8", 3),  # m
        ("ripple_wave", "f8", 3),  # rad/m
        ("ripple_second", "f8"),  # share of the second harmonic
        ("ripple_phase", "f8"),
        # frame
        ("sway_dir", "f8", (2, 2)),
        ("sway_mass", "f8", 2),  # kg
        ("sway_k", "f8", 2),
        ("sway_b", "f8", 2),
        # outside the catalogue
        ("warm_share", "f8"),  # of k, lost in the end
        ("warm_s", "f8"),
        ("pulley_share", "f8"),  # of k, once a turn
        ("pulley_wave", "f8"),  # rad/m
        ("cable_mass", "f8"),
        ("cable_k", "f8"),
        ("cable_b", "f8"),
        ("notch", "f8", 3),  # N
        ("notch_wave", "f8"),  # rad/m
        ("soft_tower", "i8"),  # -1 for none
        ("soft_mass", "f8"),
        ("soft_k", "f8"),
        ("soft_b", "f8"),
        ("stop_gap", "f8"),  # m
        ("stop_k", "f8"),  # N/m
        ("visco_k", "f8", 3),  # N/m
        ("visco_s", "f8"),  # s
    ]
)
Printer: TypeAlias = np.record
NEUTRAL: Mapping[str, Any] = {
    "stick_v": 1.0,
    "stick_power": 1.0,
    "dry_v": 1e-3,
    "bristle": 1e-5,
    "joint_bristle": 1e-5,
    "flank": 1e-6,
    "stepper_share": 1.0,
    "sway_mass": 1.0,
    "warm_s": 1.0,
    "cable_mass": 1.0,
    "soft_tower": -1,
    "soft_mass": 1.0,
    "visco_s": 1.0,
}


def printer_of(machine: Mapping[str, Any], hidden: Mapping[str, Any]) -> Printer:
    """Return the tables of a machine file as numbers, with fields of PRINTER set by what is hidden."""
    geometry, carriage, effector = machine["kinematics"], machine["carriage"], machine["effector"]
    drive = carriage.get("drive")
    angles = np.radians(np.asarray(geometry["tower_angles_deg"], dtype=float))
    round_about = np.column_stack([np.cos(angles), np.sin(angles)])
    half = carriage["arm_pair_mass_kg"] / 2
    numbers = {
        **NEUTRAL,
        "towers": np.reshape(geometry["delta_radius_mm"], (-1, 1)) / 1e3 * round_about,
        "arms": np.asarray(geometry["arm_length_mm"]) / 1e3,
        "height": geometry["effector_height_mm"] / 1e3,
        "carriage": np.asarray(carriage["mass_kg"]) + half,
        "holder": effector["nozzle_mass_kg"] + 3 * half,
        "extruder": effector["extruder_mass_kg"],
        "belt_k": carriage["belt_stiffness_n_per_m"],
        "belt_c": carriage["belt_damping_n_s_per_m"],
        "guide_b": carriage["guide_damping_n_s_per_m"],
        "mount_k": effector["extruder_stiffness_n_per_m"],
        "mount_b": effector["extruder_damping_n_s_per_m"],
        "shares": _shares(effector, round_about),
        "ideal": drive is None,
        "drive": np.zeros(3) if drive is None else [drive[key] for key in ("d0_per_s2", "d1_per_s", "d2_per_s")],
        **hidden,
    }
    record = np.zeros(1, dtype=PRINTER)
    for name, value in numbers.items():
        record[name][0] = value
    return record.view(np.recarray)[0]


def _shares(effector: Mapping[str, Any], round_about: FloatArray) -> FloatArray:
    """P_i : (3, 3, 3). Six balances, nine unknown components, the smallest norm (Eqs. 20-22)."""
    if effector["force_map"] == "virtual_work":
        return np.stack([np.eye(3)] * 3)
    joints = np.column_stack([effector["joint_radius_mm"] * round_about, np.zeros(3)])
    levers = joints - np.asarray(effector["center_of_mass_mm"])
    balance = np.zeros((6, 9))
    for i, lever in enumerate(levers):
        for n, unit in enumerate(np.eye(3)):
            balance[:3, 3 * i + n], balance[3:, 3 * i + n] = unit, np.cross(lever, unit)
    force_only = np.vstack([np.eye(3), np.zeros((3, 3))])
    found, *_ = np.linalg.lstsq(balance, force_only, rcond=None)
    return np.ascontiguousarray(found.reshape(3, 3, 3))


def carriages_of(geometry: Mapping[str, Any], xyz_mm: FloatArray) -> FloatArray:
    """(n, 3) mm, columns A B C: where firmware of this geometry sends the carriages for nozzles : (n, 3) mm."""
    angles = np.radians(np.asarray(geometry["tower_angles_deg"], dtype=float))
    towers = geometry["delta_radius_mm"] * np.column_stack([np.cos(angles), np.sin(angles)])
    away = np.sum((xyz_mm[:, None, :2] - towers) ** 2, axis=-1)
    return xyz_mm[:, 2:] + geometry["effector_height_mm"] + np.sqrt(geometry["arm_length_mm"] ** 2 - away)
