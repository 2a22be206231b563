"""What resists motion: viscous, dry, sticking and elastic friction, and drag."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.effects.effect import USUAL_SHARE, AxisWords, Effect, OnAxis, Parameter, Size, Terms, Values

LEAST_FORCE_N = 1e-12  # of a weight
USUAL_DAMPING = OnAxis(size=lambda s: USUAL_SHARE * s.force_n / s.speed_m_per_s)
USUAL_FORCE = OnAxis(size=lambda s: USUAL_SHARE * s.force_n)
PRESLIDING = Parameter(
    "presliding_mm",
    "mm",
    "s₀: way in which contacts bend before they slide, in place of creep and hold; 0: those",
    (0, 10),
    (0.005, 0.05),
    0.005,
    size="per_tower",
    role="shape",
    default=0.0,
    logarithmic=True,
    instead_of=("creep_mm_per_s", "hold_per_s"),
)


def reversal_parameters(size: Size) -> tuple[Parameter, Parameter]:
    """Declare v₀ and κ of F = ℓ tanh(v/v₀ + φ) (`models/printer/kernels`), optional in a machine file."""
    return (
        Parameter(
            "creep_mm_per_s",
            "mm/s",
            "v₀: much slower than this, friction falls with speed",
            (0.05, 1000),
            (0.2, 5),
            0.05,
            size,
            "shape",
            default=0.5,
            logarithmic=True,
        ),
        Parameter(
            "hold_per_s",
            "1/s",
            "κ: how quickly it takes hold of what rests; 0: never, all loads creep",
            (0, 1e6),
            (0, 1000),
            5.0,
            size,
            "shape",
            default=50.0,
            logarithmic=True,
        ),
    )


GUIDE_DAMPING = Effect(
    name="guide_damping",
    title="Guides with more viscous friction",
    kind="parameter",
    physics="Grease shears between carriage and rail: a force in proportion to speed.",
    equation="b → b + Δb",
    parameters=(
        Parameter(
            "added_n_s_per_m", "N s/m", "Δb", (-1000, 10000), (-10, 50), 1.0, size="per_tower", on_axis=USUAL_DAMPING
        ),
    ),
    in_data="Lower, broader resonances, and a carriage that lags in proportion to its speed.",
    confounded_with={
        "command_delay": "Several speeds and frequencies: a delay keeps the resonance's height.",
        "coulomb_friction": "Two speeds: dry friction does not grow with speed.",
        "carriage.belt_damping_n_s_per_m": "Long moves at constant speed: the belt's damper is not stretched there.",
    },
    fold=lambda machine, values: replace(
        machine, vibration=machine.vibration.with_guide_damping(values["added_n_s_per_m"])
    ),
    of=("carriages", "axes", "axis"),
    remedy="Check the rails{where} for stiff grease and tight carriages; warm grease damps less.",
    corrects_file=True,
    axis_words=AxisWords(
        title="More viscous friction",
        physics="Grease and seals shear: a resistance in proportion to speed.",
        remedy="Check bearings and gear for stiff grease or tight seals; warm grease damps less.",
        confounded_with={
            "command_delay": "Several speeds and frequencies: a delay keeps a resonance's height.",
            "coulomb_friction": "Two speeds: dry friction does not grow with speed.",
            "quadratic_drag": "Two speeds: viscous friction is in proportion to them.",
        },
    ),
)


def _dry_terms(values: Values, printer: Terms) -> Terms:
    """Return the guides' dry friction, added to what there is: two kinds share v₀ and κ, weighted by their forces.

    Of two that bend, the longer way s₀ counts.
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
    title="Dry friction of the carriages on their guides",
    kind="force",
    physics="The guide holds a carriage back with the same force at every speed, and holds it fast at rest.",
    equation="F = F_C sgn(q̇); at rest any |F| ≤ F_C",
    parameters=(
        Parameter(
            "force_n", "N", "friction of each guideway", (0, 200), (0.5, 10), 0.5, size="per_tower", on_axis=USUAL_FORCE
        ),
        *reversal_parameters("per_tower"),
    ),
    in_data="Acceleration jumps by up to 2 F_C/m when a carriage turns back; slow moves suffer as much as fast ones.",
    confounded_with={
        "stribeck_friction": "Slow moves: only Stribeck friction falls with speed.",
        "guide_damping": "Two speeds: viscous friction grows with speed, dry friction does not.",
        "belt_backlash": "Play needs the belt's force to change sign, friction the carriage's speed.",
        "joint_friction": "One tower at a time near the centre: the effector moves, two carriages rest.",
    },
    of=("carriages", "axes", "axis"),
    of_printers=(PRESLIDING,),
    terms=_dry_terms,
    remedy="Clean and oil the rails{where}; check that no belt rubs and no carriage is over-tightened.",
    axis_words=AxisWords(
        title="Dry friction",
        physics="Bearings, seals and gears hold back alike at every speed, and hold fast at rest.",
        remedy="Check bearings, seals and gear: their oil and preload.",
        confounded_with={
            "stribeck_friction": "Slow motions: only Stribeck friction falls with speed.",
            "guide_damping": "Two speeds: viscous friction grows with speed, dry friction does not.",
            "belt_backlash": "Play needs the drive's force to change sign, friction the speed.",
            "friction_by_load": "Two loads at one speed: dry friction is the same for both.",
        },
        meanings={"force_n": "F_C: at any speed"},
    ),
)


STRIBECK_FRICTION = Effect(
    name="stribeck_friction",
    title="Sticking guides: dry friction with a surplus at rest",
    kind="force",
    physics="Grease and seals stick at rest; the surplus over dry friction fades as the lubricant is drawn in.",
    equation="F = (F_C + F_extra exp(−|q̇/v_s|^δ)) sgn(q̇)   (Armstrong-Hélouvry, Dupont & Canudas de Wit, 1994)",
    parameters=(
        Parameter("force_n", "N", "friction at speed", (0, 200), (0.5, 10), 0.5, size="per_tower", on_axis=USUAL_FORCE),
        Parameter(
            "extra_force_n",
            "N",
            "surplus at rest",
            (0, 200),
            (0.2, 5),
            0.5,
            size="per_tower",
            on_axis=OnAxis(size=lambda s: USUAL_SHARE * s.force_n / 2),
        ),
        Parameter(
            "velocity_mm_per_s",
            "mm/s",
            "speed at which a third of the surplus is left",
            (0.1, 500),
            (2, 50),
            2.0,
            size="per_tower",
            role="shape",
            on_axis=OnAxis(starts=lambda s: [1e3 * s.speed_m_per_s * share for share in (0.03, 0.1, 0.3)]),
        ),
        Parameter(
            "exponent", "", "δ: how suddenly it fades", (0.3, 6), (0.5, 2), 0.1, "per_tower", "shape", default=2.0
        ),
        *reversal_parameters("per_tower"),
    ),
    in_data="As dry friction, with a spike at each start; very slow moves go in jerks.",
    confounded_with={"coulomb_friction": "Moves slower than v_s: only here the friction rises towards rest."},
    of=("carriages", "axes", "axis"),
    of_printers=(PRESLIDING,),
    terms=lambda values, printer: {
        **_dry_terms(values, printer),
        "sticking": values["extra_force_n"],
        "fading": 1e3 / values["velocity_mm_per_s"],
        "fading_power": values["exponent"] / 2,
    },
    contains="coulomb_friction",
    remedy="Clean and oil the rails{where}: they stick at rest; a thinner oil, or fresh bearings, help.",
    axis_words=AxisWords(
        title="Dry friction with a surplus at rest",
        physics="Grease and seals stick at rest; the surplus over dry friction fades as the lubricant is drawn in.",
        remedy="Check bearings, seals and gear: they stick at rest; a thinner oil, or fresh bearings, help.",
        confounded_with={"coulomb_friction": "Motions slower than v_s: only here the friction rises towards rest."},
    ),
)


BRISTLE_FRICTION = Effect(
    name="bristle_friction",
    title="Friction that gives like a spring before it slides",
    kind="force",
    physics="Contacts bend as bristles do before they slide, and what is bent remembers: hysteresis.",
    equation="F = F_C z,  ż = (q̇ − |q̇| z)/s₀   (Dahl, 1968)",
    parameters=(
        Parameter("force_n", "N", "F_C: once it slides", (0, 1e5), (0.5, 10), 0.5, on_axis=USUAL_FORCE),
        Parameter(
            "presliding_mm",
            "mm",
            "s₀: way in which it bends",
            (1e-6, 1000),
            (0.001, 0.1),
            0.005,
            role="shape",
            on_axis=OnAxis(starts=lambda s: [1e3 * s.way_m * share for share in (0.003, 0.03, 0.3)]),
        ),
    ),
    in_data="Small motions return on another path than they went; large ones look like dry friction.",
    confounded_with={
        "coulomb_friction": "Small motions: only bristles spring back.",
        "belt_backlash": "The size of motion: play has a width of its own, bristles bend at any.",
    },
    of=("axis",),
    terms=lambda values, _: {"bristle_force": values["force_n"], "presliding": values["presliding_mm"] / 1e3},
    remedy="Nothing to mend: contacts bend before they slide. Seals and wipers bend most.",
)


def _joint_terms(values: Values, printer: Terms) -> Terms:
    creep, hold = float(values["creep_mm_per_s"]) / 1e3, float(values["hold_per_s"])
    return {"joint_dry": float(values["force_n"]), "joint_creep": creep, "joint_hold": hold}


JOINT_FRICTION = Effect(
    name="joint_friction",
    title="Dry friction of the arms' ball joints",
    kind="force",
    physics="Tight or dirty joints hold the effector back with the same force at every speed, against its direction.",
    equation="F = −f Ẋ/|Ẋ|; at rest any |F| ≤ f",
    parameters=(
        Parameter("force_n", "N", "f, on the effector", (0, 200), (0.2, 5), 0.5),
        *reversal_parameters("scalar"),
    ),
    in_data="Jumps of the nozzle's acceleration at reversals of the path, shared by all three towers.",
    confounded_with={"coulomb_friction": "One tower at a time: guide friction stays on the tower that turns back."},
    of=("carriages",),
    terms=_joint_terms,
    remedy="Clean and oil the arms' joints; let their springs pull less.",
)


FRICTION_BY_DIRECTION = Effect(
    name="friction_by_direction",
    title="Viscous friction that differs by direction",
    kind="force",
    physics="A screw's preload, a cable chain or a seal's lip resists more in one direction than in the other.",
    equation="F = (b + Δb/2 sgn q̇) q̇",
    parameters=(
        Parameter(
            "damping_difference_n_s_per_m",
            "N s/m",
            "Δb: forwards less backwards",
            (-1e5, 1e5),
            (-50, 50),
            2.0,
            on_axis=USUAL_DAMPING,
        ),
    ),
    in_data="Forwards and backwards the same speed takes other forces, by more the faster it is.",
    confounded_with={
        "quadratic_drag": "Both directions: drag is the same in both.",
        "coulomb_friction": "Two speeds: dry friction does not grow with speed.",
    },
    of=("axis",),
    terms=lambda values, _: {"by_direction": values["damping_difference_n_s_per_m"]},
    remedy="Look for what resists one way only: a cable chain, a wiper's lip, a preload, a slope.",
)


def _load_terms(values: Values, printer: Terms) -> Terms:
    none = {"force_n": np.zeros(3), "presliding_mm": np.zeros(3)}
    shape = {} if "dry" in printer else _dry_terms({**values, **none}, printer)
    return {**shape, "load_share": values["share"], "held_share": values["held_share"]}


FRICTION_BY_LOAD = Effect(
    name="friction_by_load",
    title="Dry friction that grows with the load on the drive",
    kind="force",
    physics="Teeth and screws are pressed together by the force that they pass on, and rub in proportion to it.",
    equation="F = (μ |F_d| + μ ν |F_g|) sgn(q̇),  F_d = force of the drive,  F_g = what gravity and springs pull",
    parameters=(
        Parameter(
            "share",
            "",
            "μ: of the drive's force",
            (0, 0.99),
            (0.02, 0.4),
            0.05,
            on_axis=OnAxis(size=lambda s: USUAL_SHARE),
        ),
        Parameter(
            "held_share",
            "",
            "ν: how much of it what gravity and springs pull makes, beside",
            (0, 10),
            (0, 1),
            0.1,
            role="shape",
            default=0.0,
        ),
        *reversal_parameters("scalar"),
    ),
    in_data="The heavier the load, the more force it takes to lift it beyond what it gives back on its way down.",
    confounded_with={
        "coulomb_friction": "Two loads at one speed: dry friction is the same for both.",
        "friction_by_direction": "The other side of a pendulum: there its load pulls the other way.",
    },
    of=("axis",),
    terms=_load_terms,
    remedy="Look at the gear or screw: grease for its load, wear of its teeth; a higher ratio loads it less.",
)


QUADRATIC_DRAG = Effect(
    name="quadratic_drag",
    title="Drag that grows with the speed's square",
    kind="force",
    physics="Air, oil or coolant that is pushed aside resists with the square of the speed.",
    equation="F = d q̇ |q̇|",
    parameters=(
        Parameter(
            "force_n_s2_per_m2",
            "N s²/m²",
            "d",
            (-1e7, 1e7),
            (-100, 1000),
            20.0,
            on_axis=OnAxis(
                size=lambda s: USUAL_SHARE * s.force_n / s.speed_m_per_s**2, lowest=0.0
            ),  # what pushes would mop up how a damping thins with speed
        ),
    ),
    in_data="Fast moves take more force than friction in proportion to the speed explains.",
    confounded_with={"guide_damping": "Two speeds: viscous friction is in proportion to them."},
    of=("axis",),
    terms=lambda values, _: {"drag": values["force_n_s2_per_m2"]},
    remedy="Look for what is pushed aside at speed: air in a closed space, oil, coolant.",
)

EFFECTS = (
    GUIDE_DAMPING,
    COULOMB_FRICTION,
    STRIBECK_FRICTION,
    BRISTLE_FRICTION,
    JOINT_FRICTION,
    FRICTION_BY_DIRECTION,
    FRICTION_BY_LOAD,
    QUADRATIC_DRAG,
)
