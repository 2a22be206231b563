"""The effects a machine file may hold, with their parameters: the fixed names that other tools write too."""

from __future__ import annotations

# None: the format fixes the effect's name but not its parameters.
EFFECT_PARAMETERS: dict[str, frozenset[str] | None] = {
    "coulomb_friction": frozenset({"force_n"}),
    "stribeck_friction": frozenset({"force_n", "extra_force_n", "velocity_mm_per_s"}),
    "guide_damping": frozenset({"added_n_s_per_m"}),
    "belt_stiffness": frozenset({"relative_change"}),
    "belt_hardening": frozenset({"cubic_n_per_m3"}),
    "belt_position_stiffness": frozenset({"slope_per_m", "q_centre_mm"}),
    "belt_backlash": frozenset({"width_mm"}),
    "command_delay": frozenset({"delay_s"}),
    "cogging": frozenset({"amplitude_mm", "pitch_mm"}),
    "torque_angle": frozenset({"amplitude_mm"}),
    "effector_mass": frozenset({"added_kg"}),
    "center_of_mass": frozenset({"offset_mm"}),
    "extruder_mount": frozenset({"relative_stiffness_change", "relative_damping_change"}),
    "joint_friction": frozenset({"force_n"}),
    "frame_mode": frozenset({"mass_kg", "frequency_hz", "damping_ratio", "direction"}),
    "arm_geometry": frozenset({"arm_length_mm", "delta_radius_mm"}),
    "force_map": None,
    "sensor_gain": None,
    "sensor_misalignment": None,
    "sensor_time_offset": None,
    "sensor_clock_drift": None,
}
