"""Resistance: viscous, dry, static and presliding friction, and drag."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from models.effects.effect import (
    EACH,
    Effect,
    EffectParameter,
    MotionScales,
    Size,
    Terms,
    Values,
    amplitude,
    shape,
)

LEAST_FORCE_N = 1e-12  # of a weight
FORCES, OF_PRINTERS = (0, 1e5), (0, 200)  # N: the joint of a robot may have hundreds
PRESLIDING = shape(
    "presliding_mm",
    "s₀: presliding distance, in place of creep and hold; 0: use those",
    (0, 10),
    (0.005, 0.05),
    0.005,
    EACH,
    default=0.0,
    logarithmic=True,
)


def _creeping(s: MotionScales) -> list[float]:
    return [1e3 * s.speed_m_per_s * share for share in (0.001, 0.01, 0.03)]  # near that speed, friction is viscous


def reversal_parameters(size: Size) -> tuple[EffectParameter, EffectParameter]:
    """Declare v₀ and κ of F = ℓ tanh(v/v₀ + φ) (`models/printer/kernels`), optional in a machine file."""
    creep, hold = "v₀: well below this, friction falls with speed", "κ: how quickly friction locks at rest; 0: never"
    optional = partial(shape, size=size, logarithmic=True)
    return (
        optional(
            "creep_mm_per_s", creep, (0.05, 1e5), (0.2, 5), 0.05, default=0.5, on_printers=(0.05, 50), tried=_creeping
        ),
        optional("hold_per_s", f"{hold}, all loads creep", (0, 1e6), (0, 1000), 5.0, default=50.0),
    )


GUIDE_DAMPING = Effect(
    name="guide_damping",
    title="More viscous friction",
    family="viscous friction",
    physics="Grease shears between carriage and rail: a force proportional to speed.",
    equation="b → b + Δb",
    parameters=(
        amplitude(
            "added_n_s_per_m",
            "Δb",
            (-1e6, 1e6),
            (-10, 50),
            1.0,
            EACH,
            on_printers=(-1000, 10000),
            usual=lambda s: s.force_n / s.speed_m_per_s,
        ),
    ),
    in_data="Lower, broader resonances, and a lag proportional to speed.",
    confounded_with={
        "command_delay": "Several speeds and frequencies: a delay keeps the resonance's height.",
        "coulomb_friction": "Two speeds: dry friction does not grow with speed.",
        "carriage.belt_damping_n_s_per_m": "Long moves at constant speed: the belt's damper is not stretched there.",
    },
    fold=lambda machine, v: replace(machine, vibration=machine.vibration.with_guide_damping(v["added_n_s_per_m"])),
    of=("carriages", "axes", "axis"),
    remedy="Check rails and bearings{where} for stiff grease, tight seals or carriages; warm grease has less friction.",
    corrects_file=True,
)


def _dry_force(meaning: str) -> EffectParameter:
    """Return the size of a dry friction: one for each guideway."""
    return amplitude(
        "force_n", meaning, FORCES, (0.5, 10), 0.5, EACH, on_printers=OF_PRINTERS, usual=lambda s: s.force_n
    )


def _dry_terms(values: Values, printer: Terms) -> Terms:
    """Return the guides' dry friction added to the printer's terms. Two kinds share v₀ and κ, weighted by their forces.

    Of two presliding distances s₀, the longer counts.
    """
    force, extra = values["force_n"], values.get("extra_force_n", 0.0)
    share = np.maximum(force + extra, LEAST_FORCE_N)
    before = np.maximum(printer["dry"] + printer.get("sticking", 0.0), LEAST_FORCE_N) if "dry" in printer else 0.0
    means = {
        key: (before * printer.get(key, 0.0) * scale + share * values[name]) / (before + share) / scale
        for key, name, scale in (("creep", "creep_mm_per_s", 1e3), ("hold", "hold_per_s", 1.0))
    }
    way = values["presliding_mm"] / 1e3
    bristles = np.divide(1.0, way, out=np.zeros_like(way), where=way > 0.0)
    if "dry" in printer:
        other = printer["bristles"]
        bristles = np.where((bristles > 0.0) & (other > 0.0), np.minimum(bristles, other), np.maximum(bristles, other))
    return {"dry": printer.get("dry", 0.0) + force, **means, "bristles": bristles}


COULOMB_FRICTION = Effect(
    name="coulomb_friction",
    title="Dry friction",
    family="dry friction",
    law_of="dry friction",
    physics="The guide resists with the same force at every speed, and locks the carriage at rest.",
    equation="F = F_C sgn(q̇); at rest any |F| ≤ F_C",
    parameters=(
        _dry_force("F_C, of each guideway"),
        *reversal_parameters(EACH),
    ),
    in_data="Acceleration jumps by up to 2 F_C/m when a carriage reverses, in slow moves as much as in fast ones.",
    confounded_with={
        "stribeck_friction": "Slow moves: only Stribeck friction falls with speed.",
        "guide_damping": "Two speeds: viscous friction grows with speed, dry friction does not.",
        "belt_backlash": "Backlash needs the drive's force to change sign, friction the speed.",
        "joint_friction": "One tower at a time near the centre: the effector moves, two carriages rest.",
    },
    of=("carriages", "axes", "axis"),
    of_printers=(PRESLIDING,),
    terms=_dry_terms,
    remedy="Clean and oil rails, bearings and gears{where}; check that no belt or seal rubs and no carriage is tight.",
)


STRIBECK_FRICTION = Effect(
    name="stribeck_friction",
    title="More dry friction at rest",
    family="dry friction that falls with speed",
    law_of="dry friction",
    physics="Grease and seals stick at rest; the excess over dry friction fades as the lubricant is drawn in.",
    equation="F = (F_C + F_extra exp(−|q̇/v_s|^δ)) sgn(q̇)   (Armstrong-Hélouvry, Dupont & Canudas de Wit, 1994)",
    parameters=(
        _dry_force("friction at speed"),
        amplitude(
            "extra_force_n",
            "excess at rest",
            FORCES,
            (0.2, 5),
            0.5,
            EACH,
            on_printers=OF_PRINTERS,
            usual=lambda s: s.force_n / 2,
        ),
        shape(
            "velocity_mm_per_s",
            "speed where the excess falls to a third",
            (0.1, 1e5),
            (2, 50),
            2.0,
            EACH,
            on_printers=(0.1, 500),
            tried=lambda s: [1e3 * s.speed_m_per_s * share for share in (0.03, 0.1, 0.3)],
        ),
        shape("exponent", "δ: how sharply it fades", (0.3, 6), (0.5, 2), 0.1, EACH, default=2.0),
        *reversal_parameters(EACH),
    ),
    in_data="As dry friction, with a spike at each start; very slow moves stick and slip.",
    confounded_with={"coulomb_friction": "Moves slower than v_s: only here the friction rises towards rest."},
    of=("carriages", "axes", "axis"),
    of_printers=(PRESLIDING,),
    terms=lambda values, printer: {
        **_dry_terms(values, printer),
        "sticking": values["extra_force_n"],
        "fading": 1e3 / values["velocity_mm_per_s"],
        "fading_power": values["exponent"] / 2,
    },
    remedy="Clean and oil rails, bearings and gears{where}: they stick at rest; thinner oil or new bearings help.",
)


BRISTLE_FRICTION = Effect(
    name="bristle_friction",
    title="Presliding: friction that acts like a spring before it slides",
    family="dry friction",
    law_of="dry friction",
    physics="Contacts bend like bristles before they slide, which causes hysteresis.",
    equation="F = F_C z,  ż = (q̇ − |q̇| z)/s₀   (Dahl, 1968)",
    parameters=(
        amplitude("force_n", "F_C: once it slides", FORCES, (0.5, 10), 0.5, usual=lambda s: s.force_n),
        shape(
            "presliding_mm",
            "s₀: presliding distance",
            (1e-6, 1000),
            (0.001, 0.1),
            0.005,
            tried=lambda s: [1e3 * s.way_m * share for share in (0.003, 0.03, 0.3)],
        ),
    ),
    in_data="Small motions show hysteresis; large ones look like dry friction.",
    confounded_with={
        "coulomb_friction": "Small motions: only bristles spring back.",
        "belt_backlash": "The size of motion: backlash has a fixed width, bristles bend at any size.",
    },
    of=("axis",),
    terms=lambda values, _: {"bristle_force": values["force_n"], "presliding": values["presliding_mm"] / 1e3},
    remedy="Nothing to repair: contacts bend before they slide, seals and wipers most.",
)


JOINT_FRICTION = Effect(
    name="joint_friction",
    title="Dry friction in the arms' ball joints",
    family="dry friction",
    physics="Tight or dirty joints resist the effector's motion with the same force at every speed.",
    equation="F = −f Ẋ/|Ẋ|; at rest any |F| ≤ f",
    parameters=(amplitude("force_n", "f, on the effector", (0, 200), (0.2, 5), 0.5), *reversal_parameters("scalar")),
    in_data="Jumps of the nozzle's acceleration at reversals of the path, shared by all three towers.",
    confounded_with={"coulomb_friction": "One tower at a time: guide friction stays on the tower that reverses."},
    of=("carriages",),
    terms=lambda values, _: {
        "joint_dry": float(values["force_n"]),
        "joint_creep": float(values["creep_mm_per_s"]) / 1e3,
        "joint_hold": float(values["hold_per_s"]),
    },
    remedy="Clean and oil the arms' joints; use weaker springs.",
)


FRICTION_BY_DIRECTION = Effect(
    name="friction_by_direction",
    title="Viscous friction that differs by direction",
    family="friction that differs by direction",
    physics="A screw's preload, a cable chain or a seal's lip resists more in one direction than in the other.",
    equation="F = (b + Δb/2 sgn q̇) q̇",
    parameters=(
        amplitude(
            "damping_difference_n_s_per_m",
            "Δb: forward minus backward",
            (-1e5, 1e5),
            (-50, 50),
            2.0,
            usual=lambda s: s.force_n / s.speed_m_per_s,
        ),
    ),
    in_data="The two directions need different forces at the same speed; the difference grows with speed.",
    confounded_with={
        "quadratic_drag": "Both directions: drag is the same in both.",
        "coulomb_friction": "Two speeds: dry friction does not grow with speed.",
    },
    of=("axis",),
    terms=lambda values, _: {"by_direction": values["damping_difference_n_s_per_m"]},
    remedy="Look for parts that resist in one direction: a cable chain, a wiper's lip, a preload, a slope.",
)


def _load_terms(values: Values, printer: Terms) -> Terms:
    none = {"force_n": np.zeros(3), "presliding_mm": np.zeros(3)}
    shape = {} if "dry" in printer else _dry_terms({**values, **none}, printer)
    return {**shape, "load_share": values["share"], "held_share": values["held_share"]}


FRICTION_BY_LOAD = Effect(
    name="friction_by_load",
    title="Dry friction that grows with the load on the drive",
    family="dry friction that grows with load",
    physics="The transmitted force presses teeth and screws together, and friction is proportional to it.",
    equation="F = (μ |F_d| + μ ν |F_g|) sgn(q̇),  F_d = drive's force less back EMF,  F_g = pull of gravity and springs",
    parameters=(
        amplitude("share", "μ: of the drive's force", (0, 0.99), (0.02, 0.4), 0.05, usual=lambda s: 1.0),
        shape(
            "held_share", "ν: additional part from the pull of gravity and springs", (0, 10), (0, 1), 0.1, default=0.0
        ),
        *reversal_parameters("scalar"),
    ),
    in_data="The difference between the forces for lifting and lowering grows with the load.",
    confounded_with={
        "coulomb_friction": "Two loads at one speed: dry friction is the same for both.",
        "friction_by_direction": "The other side of a pendulum: there its load pulls the other way.",
    },
    of=("axis",),
    terms=_load_terms,
    remedy="Look at the gear or screw: the right grease, worn teeth; a higher ratio lowers its load.",
)


QUADRATIC_DRAG = Effect(
    name="quadratic_drag",
    title="Drag that grows with the square of speed",
    family="friction that grows with the square of the speed",
    physics="Displaced air, oil or coolant resists with the square of the speed.",
    equation="F = d q̇ |q̇|",
    parameters=(
        amplitude(
            "force_n_s2_per_m2",
            "d",
            (-1e7, 1e7),
            (-100, 1000),
            20.0,
            # negative drag would absorb a damping that falls with speed
            usual=lambda s: s.force_n / s.speed_m_per_s**2,
            lowest=0.0,
        ),
    ),
    in_data="Fast moves take more force than viscous friction explains.",
    confounded_with={"guide_damping": "Two speeds: viscous friction is proportional to speed."},
    of=("axis",),
    terms=lambda values, _: {"drag": values["force_n_s2_per_m2"]},
    remedy="Look for what the motion displaces: air in a closed space, oil, coolant.",
)
