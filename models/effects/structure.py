"""Effects of position and of moving structure: frame, gantry, bed, and forces along an axis."""

from __future__ import annotations

import numpy as np

from models.effects.effect import EACH, Effect, MotionScales, Terms, Values, amplitude, shape


def _frame_terms(values: Values, printer: Terms) -> Terms:
    omega, mass = 2 * np.pi * float(values["frequency_hz"]), float(values["mass_kg"])
    directions = np.zeros((2, 2))
    directions[: len(values["direction"])] = values["direction"]
    return {
        "frame_directions": directions,
        "frame_mass_ratio": float(printer["holder_mass"]) / (mass + float(printer["holder_mass"])),
        "frame_k": omega**2,
        "frame_b": 2 * float(values["damping_ratio"]) * omega,
        "frame_inverse_mass": 1 / mass,
    }


FRAME_MODE = Effect(
    name="frame_mode",
    title="A frame that sways",
    acts_on="frame",
    physics=(
        "The reaction to the effector's acceleration pushes the frame with towers, carriages and bed, which stands on "
        "a soft base. Accelerometers feel the sway; the print, made on a bed that sways along, feels what it does to "
        "the arms."
    ),
    equation="M_f (d̈ + 2 ζ ω ḋ + ω² d) = −F,  F = force of the arms on the effector along d",
    parameters=(
        amplitude("mass_kg", "M_f: everything that sways except the effector", (0.1, 1e4), (3, 100), 50.0, power=-1),
        shape("frequency_hz", "ω/2π, with the effector off", (0.5, 500), (5, 60), 1.0),
        shape("damping_ratio", "ζ", (0, 1), (0.01, 0.1), 0.01),
        shape("direction", "'x', 'y', 'both' alike, or a unit vector", (-1, 1), (-1, 1), 0.1, "direction"),
    ),
    in_data="A peak and a dip in one horizontal direction, at the same frequency all over the bed.",
    confounded_with={
        "extruder_mount": "The carriages: a frame shakes the whole effector, the mount only the extruder."
    },
    terms=_frame_terms,
    remedy="Stiffen the frame: tighten its corners, brace it, and put it on something heavy.",
)


def _racking_terms(values: Values, printer: Terms) -> Terms:
    if not np.isfinite(values["radius_mm"]):
        return {}
    omega = 2 * np.pi * float(values["frequency_hz"])
    return {
        "yaw_k": omega**2,
        "yaw_b": 2 * float(values["damping_ratio"]) * omega,
        "yaw_inertia": (float(values["radius_mm"]) / 1e3) ** 2,
        "yaw_share": float(values["tool_share"]),
        "yaw_centre": float(values["x_centre_mm"]) / 1e3,
        "yaw_arm": float(values["arm_mm"]) / 1e3,
    }


GANTRY_RACKING = Effect(
    name="gantry_racking",
    title="Gantry racking (yaw)",
    acts_on="frame",
    physics=(
        "A toolhead off the gantry's middle lags behind when the gantry accelerates along y, and turns it; belts that "
        "pull the toolhead along x at unequal distances (an H-frame; a CoreXY whose belts do not lie over each "
        "other) turn it too. The toolhead swings along y, the more the farther from the middle "
        "(Edoimioya, Ramani & Okwudire, arXiv 2105.09878)."
    ),
    equation="(λ² + (1 − μ) ξ²) θ̈ = −λ² (ω² θ + 2 ζ ω θ̇) − ξ f_y + a f_x,  ξ = x − x_c,  y = y₀ + ξ θ",
    parameters=(
        amplitude(
            "radius_mm",
            "λ: λ² is the gantry's moment of inertia divided by the toolhead's mass",
            (1, 1e5),
            (80, 400),
            400.0,
            power=-2,
        ),
        shape(
            "frequency_hz",
            "ω/2π, with the toolhead in the middle",
            (1, 1000),
            (20, 120),
            2.0,
            starts=(60.0, 22.0, 30.0, 41.0, 80.0, 110.0),
        ),
        shape("damping_ratio", "ζ", (0, 1), (0.02, 0.12), 0.01),
        shape("x_centre_mm", "x_c: the gantry's middle", (-1000, 1000), (0, 300), 5.0),
        shape(
            "tool_share",
            "μ: the toolhead's fraction of the mass that moves along y",
            (0, 1),
            (0.2, 0.8),
            0.05,
            default=0.5,
        ),
        shape(
            "arm_mm",
            "a: lever arm of the belts' force along x on the gantry",
            (-500, 500),
            (-40, 40),
            5.0,
            default=0.0,
            starts=(0.0, 20.0),
        ),
    ),
    in_data="Off the middle, y rings at a second frequency, with opposite sign on the two sides; x moves show in y.",
    confounded_with={
        "belt_stiffness": "Several x: unequal belts of a CoreXY have the same effect everywhere.",
        "toolhead_mode": "The middle of the gantry: there racking does not affect y.",
        "sensor_misalignment": "Several x: a misaligned sensor has the same error everywhere.",
        "frame_mode": "Several x: a frame sways the same wherever the toolhead is.",
    },
    of=("axes",),
    spread_mm=(40.0, 0.0, 0.0),
    terms=_racking_terms,
    remedy="Square and tension the gantry: equal belts, tight carriages at both ends of its beam.",
)


def _toolhead_terms(values: Values, printer: Terms) -> Terms:
    by_x, centre = (values["slope_per_m"], values["curve_per_m2"]), float(values["x_centre_mm"]) / 1e3
    return {"by_x": by_x[0], "by_x_squared": by_x[1], "by_x_centre": centre}


TOOLHEAD_MODE = Effect(
    name="toolhead_mode",
    title="A toolhead mode that depends on X",
    physics=(
        "The beam that carries the toolhead is softest in its middle, and twists more the farther the toolhead is from "
        "a guide. On an axis with several modes, this changes the one with the highest frequency."
    ),
    equation="ω² → ω² (1 + r (x − x_c) + h (x − x_c)²)",
    parameters=(
        amplitude("slope_per_m", "r, of ω² of the axis' highest mode", (-10, 10), (-2, 2), 0.05, EACH),
        amplitude("curve_per_m2", "h", (-200, 200), (-20, 20), 0.5, EACH, unit="1/m²"),
        shape("x_centre_mm", "x_c: where ω is the file's", (-1000, 1000), (0, 300), 5.0),
    ),
    in_data="The frequency of a resonance along x or y depends on x.",
    confounded_with={
        "belt_position_stiffness": "Excite y at several x: the belts of y do not depend on x.",
        "gantry_racking": "The middle of the gantry: racking changes sign there.",
    },
    of=("axes",),
    spread_mm=(40.0, 0.0, 0.0),
    terms=_toolhead_terms,
    remedy="Check the screws of the toolhead and its beam; a stiffer beam varies less.",
)


GROWING_BED = Effect(
    name="growing_bed",
    title="A bed that gets heavier as it prints",
    physics=(
        "On a bed slinger the print rides on the bed, so the belt moves more mass as the print grows. The file's "
        "numbers are those of the empty bed. Every mode of the axis slows by the same factor, exact for one mode."
    ),
    equation="M → M (1 + g z),  z = height of the nozzle over the bed",
    parameters=(amplitude("growth_per_m", "g, of the mass that an axis moves", (0, 100), (0.2, 4), 0.1, EACH),),
    in_data="The resonance of the bed's axis falls from layer to layer; the other axes' stay.",
    confounded_with={"belt_stiffness": "Two heights of one print: a slack belt is the same at both."},
    of=("axes",),
    spread_mm=(0.0, 0.0, 20.0),
    terms=lambda values, _: {"growth": values["growth_per_m"]},
    remedy="Nothing to repair: prints have mass. Once in the file, every layer is compensated for its own mass.",
)


GROUND_SPRING = Effect(
    name="ground_spring",
    title="A spring that pulls the axis to one position",
    family="a pull towards one place",
    law_of="a pull towards one place",
    physics="Hoses, cables, a bellows or gravity on a curved guide pull harder the farther the axis moves.",
    equation="F = k q",
    parameters=(amplitude("stiffness_n_per_m", "k", (0, 1e9), (10, 1000), 5.0, usual=lambda s: s.force_n / s.way_m),),
    in_data="The force at rest grows along the axis.",
    confounded_with={"cogging_force": "The whole travel: a ripple repeats, a spring does not."},
    of=("axis",),
    terms=lambda values, _: {"ground": values["stiffness_n_per_m"]},
    needs="freedom",
    remedy="Look for parts that pull to one position: hoses, cables, a bellows, a counterweight.",
)


PENDULUM_GRAVITY = Effect(
    name="pendulum_gravity",
    title="Gravity on a rotating arm",
    family="a pull towards one place",
    law_of="a pull towards one place",
    physics="Gravity pulls an unbalanced arm, load or rotor to its lowest position.",
    equation="F = m g l sin(q − q₀)",
    parameters=(
        amplitude(
            "force_n",
            "m g l: moment at a right angle",
            (-1e6, 1e6),
            (-10, 10),
            0.1,
            usual=lambda s: s.force_n / min(s.way_m, 1.0),
        ),
        shape("angle_deg", "q₀: angle where it hangs down", (-360, 360), (-180, 180), 5.0, default=0.0),
    ),
    in_data="The force at rest is a sine of the angle from the lowest position.",
    confounded_with={
        "ground_spring": "Angles beyond 60 degrees: a weight pulls less than a spring there.",
        "belt_hardening": "The drive switched off: gravity stays, a softening drive does not.",
        "cogging_force": "A whole turn: gravity repeats once, a ripple several times.",
    },
    of=("axis",),
    terms=lambda values, _: {"weight_moment": values["force_n"], "weight_angle": np.radians(values["angle_deg"])},
    needs="turning",
    remedy="Nothing to repair: the axis carries a weight. Balance it, or leave it in the file.",
)


TURN_APART = 0.7  # cycles over the travel between tried pitches; one in between is half detected


def _force_pitches(s: MotionScales) -> list[float]:
    return [1e3 * s.travel_m / turns for turns in np.arange(2.0, 40.0, TURN_APART).tolist()]


COGGING_FORCE = Effect(
    name="cogging_force",
    title="A force that repeats along the axis",
    physics=(
        "Magnets of a motor, balls of a screw or teeth of a rack push and pull once per pitch. There may be several "
        "lines, each with a pitch: of a motor's poles, slots and their multiples."
    ),
    equation="F = Σ s sin(2π q/p) + c cos(2π q/p)",
    parameters=(
        amplitude("sine_n", "s", (-1e5, 1e5), (-5, 5), 0.5, "lines", usual=lambda s: s.force_n / 3),
        amplitude("cosine_n", "c", (-1e5, 1e5), (-5, 5), 0.5, "lines", usual=lambda s: s.force_n / 3),
        shape(
            "pitch_mm", "p; 2π/N rad for N lines a turn", (0.01, 10_000), (1, 50), 0.5, "lines", tried=_force_pitches
        ),
    ),
    in_data="The force at constant speed repeats with position, whatever the speed.",
    confounded_with={"ground_spring": "More than one pitch of travel: a spring does not repeat."},
    of=("axis",),
    terms=lambda values, _: {
        "ripples": np.column_stack([values["sine_n"], values["cosine_n"], 2e3 * np.pi / values["pitch_mm"]])
    },
    remedy="Look for parts that repeat along the travel: magnets, a screw's balls, a rack's or a belt's teeth.",
    of_motors=True,
)
