"""Hidden deltas: how a printer and its owner's file are drawn, what it can hide, and how it moves.

The printer is `plants.delta_plant`; loads go as its `force_map` has it. `EFFECTS[name]` and `OUTSIDE[name]` are as in
`effects`.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from validation.blind import effects
from validation.blind.effects import SHARED, Drawn, by_name, of_kind
from validation.blind.motions import Motion, Place, points
from validation.blind.real import FloatArray, Hide, Labels, Reading, Real, Rng, Tables, larger, off_by, sign, told
from validation.plants.delta_plant import carriages_of, paper_shares, simulate

STEP_S, KEPT_EVERY = 1 / 12800, 2  # 6400 samples a second: what a sensor's clock then picks from
_SIZES: Mapping[str, tuple[float, float, float]] = {  # arm mm, effective radius mm, joint radius mm
    "middling": (300.0, 140.0, 39.9),
    "small": (230.0, 105.0, 30.0),
    "large": (340.0, 165.0, 42.0),
}
_MOUNT = ("extruder_stiffness_n_per_m", "extruder_damping_n_s_per_m")
DYNAMIC = {
    "carriage": (
        "mass_kg",
        "arm_pair_mass_kg",
        "belt_stiffness_n_per_m",
        "belt_damping_n_s_per_m",
        "guide_damping_n_s_per_m",
    ),
    "effector": ("nozzle_mass_kg", "extruder_mass_kg", *_MOUNT),
}
DAMPERS = ("carriage.belt_damping_n_s_per_m", "carriage.guide_damping_n_s_per_m")


def draw_machine(rng: Rng, names: Sequence[str] = ()) -> Tables:
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
    if "center_of_mass" in names or ("force_map" in names and rng.random() < 0.5):
        machine["effector"]["force_map"] = "paper"
    if "arm_inertia" in names:  # of steel tubes: the inertia of the lightest arms cannot be seen
        machine["carriage"]["arm_pair_mass_kg"] = float(rng.uniform(0.08, 0.15))
    return machine


def places(machine: Tables, rng: Rng) -> list[Place]:
    """Draw where the motions are made: in the middle, and round about."""
    reach, turn = 0.62 * machine["kinematics"]["print_radius_mm"], rng.uniform(0, 2 * np.pi)
    found: list[Place] = [(0.0, 0.0, 30.0)]
    for n in range(5):
        angle = turn + 2 * np.pi * n / 5 + rng.uniform(-0.3, 0.3)
        height = rng.uniform(15, 60) if n % 2 == 0 else rng.uniform(90, 160)
        found.append((reach * np.cos(angle), reach * np.sin(angle), height))
    return found


def file_of(machine: Tables, error: float, rng: Rng) -> Tables:
    """Return the owner's file: every dynamic number is off by a normal error."""
    written, off = copy.deepcopy(machine), off_by(error, rng)
    for table, keys in DYNAMIC.items():
        for key in keys:
            value = written[table][key]
            written[table][key] = [off(x) for x in value] if isinstance(value, list) else off(value)
    drive = written["carriage"].get("drive", {})
    drive.update({key: off(value) for key, value in drive.items()})
    if error > 0.02:
        written["uncertainty"] = {"default": error}
    return written


def restated(tables: Labels, real: Tables, file: Tables) -> Labels:
    """Return the effects in the file's terms: a change of one of its numbers counts from what it says, which is off."""
    found = {name: dict(table) for name, table in tables.items()}

    def off(table: str, key: str) -> FloatArray:
        return np.asarray(real[table][key]) / np.asarray(file[table][key]) - 1

    if "belt_stiffness" in found:
        change = off("carriage", "belt_stiffness_n_per_m")
        found["belt_stiffness"]["relative_change"] = told(np.broadcast_to(change, 3))
    if "effector_mass" in found:
        found["effector_mass"]["added_kg"] = real["effector"]["nozzle_mass_kg"] - file["effector"]["nozzle_mass_kg"]
    mount = found.get("extruder_mount", {})
    for of, key in zip(_MOUNT, ("relative_stiffness_change", "relative_damping_change"), strict=True):
        if key in mount:
            mount[key] = np.where(np.array(mount[key]) != 0, off("effector", of), 0.0).tolist()
    return found


def probes(machine: Tables, by: float) -> Iterator[Tables]:
    """Yield the machine with one dynamic number larger by a share, one after the other."""
    for table, names in {**DYNAMIC, "carriage.drive": tuple(machine["carriage"].get("drive", {}))}.items():
        for name in names:
            several = table == "effector" and isinstance(machine[table][name], list)
            for n in range(3) if several else (None,):
                yield larger(machine, f"{table}.{name}", by, n)


def damped_by_belts(machine: Tables, share: float) -> tuple[Tables, dict[str, Any]]:
    """Return the printer with such a share of its carriages' damping in its belts; a file has a number for each."""
    share = min(max(share, 0.01), 0.99)  # no number of a file is zero
    belt, guide = (key.partition(".")[2] for key in DAMPERS)
    damping = machine["carriage"][belt] + machine["carriage"][guide]
    return {**machine, "carriage": machine["carriage"] | {belt: share * damping, guide: (1 - share) * damping}}, {}


def played(real: Real, firmware: Mapping[str, Any], motion: Motion) -> Reading:
    """Return what perfect sensors read of a motion; 6400 samples a second."""
    command = real.order(carriages_of(firmware, points(motion, 2 / STEP_S)), STEP_S / 2)
    effector, angles = real.machine["effector"], real.machine["kinematics"]["tower_angles_deg"]
    by_paper = {"shares": paper_shares(effector, angles)} if effector["force_map"] == "paper" else {}
    hidden = {**by_paper, **real.fields}
    out = simulate(real.machine, command, STEP_S, gravity=True, keep_every=KEPT_EVERY, hidden=hidden)
    felt = (out["carriage_acc_m_per_s2"], out["nozzle_acc_m_per_s2"])
    return real.read(Reading(out["t"], *felt, out["carriage_mm"], out["nozzle_mm"]), motion.name)


# ---- what it hides -------------------------------------------------------------------------------


def _springs(real: Real) -> FloatArray:
    return np.ones(3) * real.machine["carriage"]["belt_stiffness_n_per_m"]


def _forces(_: Real, **values: FloatArray) -> Tables:
    return {key: told(value) for key, value in values.items()}


TOWERS = Drawn(
    column=0,
    motors=3,
    loads=lambda real: np.ones(3),
    forces=_forces,
    springs=_springs,
    stiffened=lambda real, by: real.changed("carriage", belt_stiffness_n_per_m=_springs(real) * (1 + by)),
    of_belts=_forces,
    felt=(1.0,) * 6,
    softens=0.3,
)


def joint_friction(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide friction of the joints."""
    force = size * rng.uniform(0.8, 3.0)
    return {"force_n": force}, real.having(joint=force, joint_bristle=rng.uniform(1.5e-5, 5e-5))


# ---- effector, frame, geometry -------------------------------------------------------------------


def effector_mass(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide a mass on the nozzle holder."""
    added = size * rng.uniform(0.05, 0.14)
    return {"added_kg": added}, real.changed(
        "effector", nozzle_mass_kg=real.machine["effector"]["nozzle_mass_kg"] + added
    )


def center_of_mass(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Felt only where the loads go by Eqs. 22-27: the bank hides it in such printers."""
    offset = size * rng.uniform(6.0, 18.0, 3) * rng.choice([-1.0, 1.0], 3)
    before = np.asarray(real.machine["effector"]["center_of_mass_mm"])
    return {"offset_mm": offset.tolist()}, real.changed("effector", center_of_mass_mm=(before + offset).tolist())


def extruder_mount(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide another mount of the extruder."""
    touched = np.array([1.0, 1.0, 0.0]) if rng.random() < 0.5 else np.eye(3)[rng.integers(2)]
    stiffer = size * touched * sign(rng) * rng.uniform(0.2, 0.4, 3)
    damper = size * touched * rng.uniform(0.3, 0.9, 3)
    effector = real.machine["effector"]
    table = {"relative_stiffness_change": stiffer.tolist(), "relative_damping_change": damper.tolist()}
    return table, real.changed(
        "effector",
        extruder_stiffness_n_per_m=(effector["extruder_stiffness_n_per_m"] * (1 + stiffer)).tolist(),
        extruder_damping_n_s_per_m=(effector["extruder_damping_n_s_per_m"] * (1 + damper)).tolist(),
    )


def arm_geometry(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide other arms and another radius."""
    arm, radius = size * sign(rng) * rng.uniform(1.0, 3.0), size * sign(rng) * rng.uniform(1.0, 3.0)
    geometry = real.machine["kinematics"]
    longer = real.changed(
        "kinematics",
        arm_length_mm=geometry["arm_length_mm"] + arm,
        delta_radius_mm=geometry["delta_radius_mm"] + radius,
    )
    return {"arm_length_mm": arm, "delta_radius_mm": radius}, longer


def arm_inertia(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide arms whose mass lies along them: all of it, or the ends weigh something too."""
    along = size * rng.uniform(0.7, 1.0)
    return {"share_along": along}, real.having(rods=along * real.machine["carriage"]["arm_pair_mass_kg"] / 6)


def force_map(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """There or not: the printer's loads go the way its file does not say."""
    other = {"virtual_work": "paper", "paper": "virtual_work"}
    said = real.machine["effector"]["force_map"]
    return {}, real.changed("effector", force_map=other[said] if size > 0 else said)


EFFECTS: Mapping[str, Hide] = {
    **of_kind(SHARED, TOWERS),
    **by_name(effector_mass, center_of_mass, extruder_mount, joint_friction, arm_geometry, arm_inertia, force_map),
}


def loose_extruder(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide it: the extruder swings against a stop: beyond a gap its mount is several times stiffer."""
    stiffness = min(real.machine["effector"]["extruder_stiffness_n_per_m"])
    return {}, real.having(stop_gap=rng.uniform(0.1e-3, 0.3e-3), stop_k=size * rng.uniform(4.0, 9.0) * stiffness)


OUTSIDE: Mapping[str, Hide] = of_kind(effects.OUTSIDE, TOWERS, "one_sided_belt") | by_name(loose_extruder)
