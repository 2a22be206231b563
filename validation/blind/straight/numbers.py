"""The numbers of one printer with straight axes and of all that it may hide, as compiled code wants them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from validation.blind.printer.real import FloatArray

COREXY = np.array([[1.0, 1.0], [1.0, -1.0]])
EACH = (
    "carriage tool belt_k belt_c guide_b ground tool_ground mount_k mount_b dry stick grease cubic quintic slope "
    "slope_at lean play stepper ripple ripple_wave notch visco_k sway_mass sway_k sway_b loose rotor rotor_k rotor_b"
)
ONE = (
    "stick_v stick_power dry_v bristle micro breaks flank landing stepper_share ripple_second ripple_phase warm_share "
    "warm_s pulley_share pulley_wave cable_mass cable_k cable_b notch_wave soft_mass soft_k soft_b stop_gap stop_k "
    "visco_s loose_grip beam beam_at beam_half yaw yaw_k yaw_b yaw_at yaw_arm head"
)
PRINTER = np.dtype(
    [
        *((name, "f8", 2) for name in EACH.split()),  # of axes x, y, or of motors A, B; SI
        *((name, "f8") for name in ONE.split()),
        ("turn", "f8", (2, 2)),  # from axes to motors
        ("sway_dir", "f8", (2, 2)),
        ("dry_kind", "i8"),  # 0 none, else of `shapes`
        ("soft_motor", "i8"),  # -1 for none
    ]
)
NEUTRAL: Mapping[str, Any] = {
    "stick_v": 1.0,
    "stick_power": 1.0,
    "dry_v": 1e-3,
    "bristle": 1e-5,
    "flank": 1e-6,
    "stepper_share": 1.0,
    "sway_mass": 1.0,
    "warm_s": 1.0,
    "cable_mass": 1.0,
    "soft_motor": -1,
    "soft_mass": 1.0,
    "visco_s": 1.0,
    "beam_half": 1.0,
}


def turn_of(kind: str) -> FloatArray:
    """Return how motors move, (2, 2), of the axes' moves."""
    return COREXY if kind == "corexy" else np.eye(2)


def printer_of(machine: Mapping[str, Any], hidden: Mapping[str, Any]) -> Any:
    """Return the tables of a printer as numbers, with fields of PRINTER set by what is hidden."""
    numbers = {**NEUTRAL, **machine["plant"], "turn": turn_of(machine["kinematics"]["type"]), **hidden}
    record = np.zeros(1, dtype=PRINTER)
    for name, value in numbers.items():
        record[name][0] = value
    return record.view(np.recarray)[0]


def modes_of(machine: Mapping[str, Any], axis: int) -> dict[str, list[float]]:
    """Return frequencies, damping ratios and shares of an axis, as a machine file has them, by its masses and springs.

    The dampers are proportional (`machines.draw_machine`), so that the modes are those of the undamped axis.
    `belt_damping_share` is of the first mode.
    """
    plant = machine["plant"]
    turn = turn_of(machine["kinematics"]["type"])
    belt, tool = float(turn[:, axis] ** 2 @ plant["belt_k"]), plant["tool"][axis]
    if tool == 0.0:
        mass, stiff, damp = np.array([plant["carriage"][axis]]), np.array([[belt]]), np.zeros((1, 1))
    else:
        mount, damper = plant["mount_k"][axis], plant["mount_b"][axis]
        mass = np.array([plant["carriage"][axis], tool])
        stiff = np.array([[belt + mount, -mount], [-mount, mount]])
        damp = damper * np.array([[1.0, -1.0], [-1.0, 1.0]]) + np.diag([0.0, plant["tool_ground"][axis]])
    belts = float(turn[:, axis] ** 2 @ plant.get("belt_c", np.zeros(2)))
    damp[0, 0] += plant["guide_b"][axis] + plant["ground"][axis] + belts
    square, shape = np.linalg.eigh(stiff / np.sqrt(np.outer(mass, mass)))
    shape = shape / np.sqrt(mass)[:, None]
    omega = np.sqrt(square)
    ratio = np.einsum("im,ij,jm->m", shape, damp, shape) / (2 * omega)
    share = belt * shape[0] * shape[-1] / square
    return {
        "frequency_hz": (omega / (2 * np.pi)).tolist(),
        "damping_ratio": ratio.tolist(),
        "share": share.tolist(),
        "belt_damping_share": [float(belts * shape[0, 0] ** 2 / (2 * omega[0] * ratio[0]))],
    }
