"""Every effect of a delta at a usual size: the problem of all tests that want some effect, or all of them."""

from __future__ import annotations

from typing import Any

TABLES: dict[str, dict[str, Any]] = {
    "coulomb_friction": {"force_n": [1.0, 2.0, 3.0]},
    "stribeck_friction": {"force_n": 0.5, "extra_force_n": 1.0, "velocity_mm_per_s": 10.0},
    "guide_damping": {"added_n_s_per_m": [1.0, 2.0, 3.0]},
    "belt_stiffness": {"relative_change": [0.1, 0.0, -0.1]},
    "belt_hardening": {"cubic_n_per_m3": 1e12},
    "belt_position_stiffness": {"slope_per_m": 0.3, "q_centre_mm": 350.0},
    "belt_backlash": {"width_mm": [0.02, 0.05, 0.03]},
    "command_delay": {"delay_s": [0.001, 0.002, 0.0013]},
    "cogging": {"amplitude_mm": [0.01, 0.02, 0.01], "pitch_mm": [0.8, 0.8, 0.2]},
    "torque_angle": {"amplitude_mm": 2.0},
    "effector_mass": {"added_kg": 0.1},
    "arm_inertia": {"share_along": 0.6},
    "center_of_mass": {"offset_mm": [5.0, 0.0, 0.0]},
    "extruder_mount": {"relative_stiffness_change": [-0.2, 0.1, 0.0], "relative_damping_change": [0.1, 0.2, 0.3]},
    "joint_friction": {"force_n": 1.0},
    "frame_mode": {"mass_kg": 20.0, "frequency_hz": 20.0, "damping_ratio": 0.03, "direction": "both"},
    "arm_geometry": {"arm_length_mm": [0.5, 0.0, 0.0], "delta_radius_mm": 0.3},
    "force_map": {},
}
