"""Parts of a delta that differ from the machine file: effector, extruder mount, arms, load map."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from models.arrays import constant
from models.effects.effect import EACH, Effect, Values, amplitude
from models.kinds import delta_vibration
from models.machine import Machine
from models.vibration.base import number_at, with_numbers

_part = partial(Effect, of=("carriages",))


Law = Callable[[Any, Values], Any]  # from a number of the file and the effect's values to the number that holds


def _with(laws: Mapping[str, Law]) -> Callable[[Machine, Values], Machine]:
    """Return the fold that changes numbers of a delta, each by its law."""

    def fold(machine: Machine, values: Values) -> Machine:
        model = delta_vibration(machine)
        changed = {name: law(number_at(model, name), values) for name, law in laws.items()}
        return replace(machine, vibration=with_numbers(model, changed))

    return fold


EFFECTOR_MASS = _part(
    name="effector_mass",
    title="More mass on the nozzle holder",
    physics="A fan, a duct, a probe or a bundle of cables moves with the nozzle holder.",
    equation="m₁ → m₁ + Δm",
    parameters=(amplitude("added_kg", "Δm", (-1, 10), (-0.1, 0.3), 0.01),),
    in_data="Lower resonances, all towers alike; the belts sag a little more.",
    confounded_with={
        "arm_inertia": "Up and down at the centre: there only mass on the holder changes the resonance.",
        "belt_stiffness": "Two places on the bed: stiffness shifts all modes by the same factor, mass does not.",
        "effector.extruder_mass_kg": "The mode of the extruder on its mount: mass on the holder raises it.",
    },
    fold=_with({"effector.nozzle_mass_kg": lambda mass, v: mass + float(v["added_kg"])}),
    remedy="Weigh the effector with everything that moves with it (fan, cables, camera) and write it in the file.",
    corrects_file=True,
)


CENTER_OF_MASS = _part(
    name="center_of_mass",
    title="An effector with its mass off centre",
    physics=(
        "An off-centre mass loads the rods unevenly. Ideal rods balance that among themselves, so by virtual work the "
        "carriages do not feel it; by the map of Eqs. 22-27 they do."
    ),
    equation="δ → δ + Δδ   (Eq. 20)",
    parameters=(amplitude("offset_mm", "Δδ, along x, y, z", (-200, 200), (-20, 20), 1.0, "vector3"),),
    in_data="With force_map 'paper': towers differ. With 'virtual_work': nothing at all.",
    confounded_with={"force_map": "Which tower differs: a change of map shows with a centred mass too."},
    fold=_with({"effector.center_of_mass_mm": lambda centre, v: constant(centre + v["offset_mm"])}),
    remedy="Find the effector's balance point, or move parts on one side nearer to the middle.",
    corrects_file=True,
)


EXTRUDER_MOUNT = _part(
    name="extruder_mount",
    title="A loose or stiff extruder mount",
    physics="Screws and printed brackets hold the extruder; they loosen, or are tightened.",
    equation="K → K (1 + r_k), B → B (1 + r_b), per axis",
    parameters=(
        amplitude("relative_stiffness_change", "r_k, of x, y, z", (-0.95, 20), (-0.5, 0.5), 0.02, "vector3"),
        amplitude("relative_damping_change", "r_b, of x, y, z", (-1, 50), (-0.5, 1), 0.05, "vector3"),
    ),
    in_data="The resonance of one axis of the nozzle shifts or broadens; the carriages hardly notice.",
    confounded_with={
        "effector.extruder_mass_kg": "Antiresonance and mode together: mass shifts both, stiffness only one."
    },
    fold=_with(
        {
            "effector.extruder_stiffness_n_per_m": lambda k, v: constant(k * (1 + v["relative_stiffness_change"])),
            "effector.extruder_damping_n_s_per_m": lambda b, v: constant(b * (1 + v["relative_damping_change"])),
        }
    ),
    remedy="Tighten the extruder's mount, its screws and dampers; print a stiffer bracket.",
    corrects_file=True,
)


ARM_INERTIA = _part(
    name="arm_inertia",
    title="Arms with mass along their length",
    physics=(
        "By default half of an arm's mass is at either end. Mass along the arm moves less than the ends when these "
        "move differently: uniform rods have 1, carbon tubes with heavy ends less."
    ),
    equation="T → T − σ m_f/12 Σ |Ẋ − ẑ q̇_i|²",
    parameters=(
        amplitude("share_along", "σ: fraction of the arms' mass in addition to the file's", (-1, 1), (0, 1), 0.1),
    ),
    in_data="Higher resonances sideways, more so near the rim; up and down at the centre nothing changes.",
    confounded_with={
        "effector_mass": "Up and down at the centre: mass on the holder lowers that too, mass along the arms does not.",
        "belt_stiffness": "Up and down at the centre: there only stiffer belts raise the resonance.",
    },
    fold=_with({"carriage.arm_mass_share_at_ends": lambda share, v: share - float(v["share_along"])}),
    remedy="Weigh an arm's tube and its ends apart, and write the ends' share in the file.",
    corrects_file=True,
)


def _other_geometry(machine: Machine, values: Values) -> Machine:
    nominal = delta_vibration(machine).kinematics
    return replace(machine, kinematics=nominal.recalibrated(values["arm_length_mm"], values["delta_radius_mm"]))


ARM_GEOMETRY = _part(
    name="arm_geometry",
    title="Arms and towers off their nominal sizes",
    physics="The firmware commands the carriages with the nominal geometry; the nozzle moves with the true one.",
    equation="L → L + ΔL, R → R + ΔR",
    parameters=(
        amplitude("arm_length_mm", "ΔL", (-50, 50), (-2, 2), 0.2, EACH),
        amplitude("delta_radius_mm", "ΔR", (-50, 50), (-2, 2), 0.2, EACH),
    ),
    in_data="Wrong sizes and a bowed first layer; accelerations change by parts in a thousand.",
    confounded_with={"sensor_misalignment": "Measure a print: accelerations can hardly separate the two."},
    fold=_other_geometry,
    remedy="Measure the arms and calibrate the delta (radius, arm length) in the firmware.",
)


def _other_map(machine: Machine, values: Values) -> Machine:
    model = delta_vibration(machine)
    other = "paper" if model.effector.force_map == "virtual_work" else "virtual_work"
    return replace(machine, vibration=with_numbers(model, {"effector.force_map": other}))


FORCE_MAP = _part(
    name="force_map",
    title="The other force map",
    physics=(
        "By virtual work the carriages feel the effector's whole load; by Eqs. 22-27 about a third of it. With this "
        "effect the machine follows the map that its file does not name. It has no parameters."
    ),
    equation="F_q = Jᵀ W X against F_qi = J_iᵀ P_i W X   (Eq. 25)",
    parameters=(),
    in_data="The lowest modes are off by a factor near 1.5, differently over the bed.",
    confounded_with={"effector_mass": "Three places on the bed: no single mass fits all of them."},
    fold=_other_map,
    remedy="Nothing to repair: the machine file uses the other force map, which is a modelling choice.",
)
