"""What depends on the place, or moves along: frame, gantry, bed, and forces along an axis."""

from __future__ import annotations

import numpy as np

from models.effects.effect import USUAL_SHARE, Effect, MotionScales, OnAxis, Parameter, Terms, Values


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
    title="A frame that sways under the moving effector",
    kind="frame",
    physics=(
        "The reaction to the effector's acceleration pushes the frame with towers, carriages and bed, which stands on "
        "a soft base. Accelerometers feel the sway; the print, made on a bed that sways along, feels what it does to "
        "the arms."
    ),
    equation="M_f (d̈ + 2 ζ ω ḋ + ω² d) = −F,  F = force of the arms on the effector along d",
    parameters=(
        Parameter("mass_kg", "kg", "M_f: all that sways, without the effector", (0.1, 1e4), (3, 100), 50.0, power=-1),
        Parameter("frequency_hz", "Hz", "ω/2π, with the effector off", (0.5, 500), (5, 60), 1.0, role="shape"),
        Parameter("damping_ratio", "", "ζ", (0, 2), (0.01, 0.1), 0.01, role="shape"),
        Parameter(
            "direction", "", "'x', 'y', 'both' alike, or a unit vector", (-1, 1), (-1, 1), 0.1, "direction", "shape"
        ),
    ),
    in_data="A pair of peak and dip in one horizontal direction, at the same frequency all over the bed.",
    confounded_with={
        "extruder_mount": "The carriages: a frame shakes the effector whole, the mount only the extruder."
    },
    terms=_frame_terms,
    remedy="Stiffen the frame: tighten its corners, brace it, and stand it on something heavy.",
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
    title="A gantry that racks: it yaws under its toolhead",
    kind="frame",
    physics=(
        "A toolhead off the gantry's middle lags behind when the gantry accelerates along y, and turns it; belts that "
        "pull the toolhead along x at unequal distances (an H-frame; a CoreXY whose belts do not lie over each "
        "other) turn it too. The toolhead swings along y, the more the farther from the middle "
        "(Edoimioya, Ramani & Okwudire, arXiv 2105.09878)."
    ),
    equation="(λ² + (1 − μ) ξ²) θ̈ = −λ² (ω² θ + 2 ζ ω θ̇) − ξ f_y + a f_x,  ξ = x − x_c,  y = y₀ + ξ θ",
    parameters=(
        Parameter(
            "radius_mm",
            "mm",
            "λ: λ² is the gantry's moment of inertia over the toolhead's mass",
            (1, 1e5),
            (80, 400),
            400.0,
            power=-2,
        ),
        Parameter(
            "frequency_hz",
            "Hz",
            "ω/2π, with the toolhead in the middle",
            (1, 1000),
            (20, 120),
            2.0,
            role="shape",
            starts=(60.0, 22.0, 30.0, 41.0, 80.0, 110.0),
        ),
        Parameter("damping_ratio", "", "ζ", (0, 2), (0.02, 0.12), 0.01, role="shape"),
        Parameter("x_centre_mm", "mm", "x_c: the gantry's middle", (-1000, 1000), (0, 300), 5.0, "scalar", "shape"),
        Parameter(
            "tool_share",
            "",
            "μ: of the mass that moves along y, the toolhead's",
            (0, 1),
            (0.2, 0.8),
            0.05,
            "scalar",
            "shape",
            default=0.5,
        ),
        Parameter(
            "arm_mm",
            "mm",
            "a: by which the belts' force along x turns the gantry",
            (-500, 500),
            (-40, 40),
            5.0,
            "scalar",
            "shape",
            default=0.0,
            starts=(0.0, 20.0),
        ),
    ),
    in_data="Off the middle, y rings at a second frequency, of opposite sign on the two sides; moves of x show in y.",
    confounded_with={
        "belt_stiffness": "Several x: unequal belts of a CoreXY exchange motion alike everywhere.",
        "toolhead_mode": "The middle of the gantry: there racking leaves y alone, whatever its mode does.",
        "sensor_misalignment": "Several x: a turned sensor errs alike everywhere.",
        "frame_mode": "Several x: a frame sways alike wherever the toolhead is.",
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
    title="A toolhead whose mode depends on where it is along X",
    kind="force",
    physics=(
        "The beam that carries the toolhead gives way more in its middle than at its ends, and twists more the "
        "farther from a guide. Of an axis with several modes this is that of the highest frequency."
    ),
    equation="ω² → ω² (1 + r (x − x_c) + h (x − x_c)²)",
    parameters=(
        Parameter("slope_per_m", "1/m", "r, of ω² of the axis' highest mode", (-10, 10), (-2, 2), 0.05, "per_tower"),
        Parameter("curve_per_m2", "1/m²", "h", (-200, 200), (-20, 20), 0.5, "per_tower"),
        Parameter(
            "x_centre_mm", "mm", "x_c: where the file's ω holds", (-1000, 1000), (0, 300), 5.0, "scalar", "shape"
        ),
    ),
    in_data="Shaken at several x, along x or y, a resonance is found at another frequency each time.",
    confounded_with={
        "belt_position_stiffness": "Shake y at several x: the belts of y do not know where x is.",
        "gantry_racking": "The middle of the gantry: racking comes from both sides of it, and turns its sign there.",
    },
    of=("axes",),
    spread_mm=(40.0, 0.0, 0.0),
    terms=_toolhead_terms,
    remedy="Check the screws of the toolhead and of the beam that carries it; a stiffer beam varies less.",
)


GROWING_BED = Effect(
    name="growing_bed",
    title="A bed that grows heavier with the print",
    kind="force",
    physics=(
        "What a bed slinger prints rides on the bed: the higher the print, the more mass the belt moves. The file's "
        "numbers are those of the empty bed. Every mode of the axis slows down alike, which is exact for one mode."
    ),
    equation="M → M (1 + g z),  z = height of the nozzle over the bed",
    parameters=(
        Parameter(
            "growth_per_m", "1/m", "g, of the mass that an axis moves", (0, 100), (0.2, 4), 0.1, size="per_tower"
        ),
    ),
    in_data="The resonance of the bed's axis falls from layer to layer, those of the other axes stay.",
    confounded_with={"belt_stiffness": "Two heights of one print: a slack belt is as slack at the first layer."},
    of=("axes",),
    spread_mm=(0.0, 0.0, 20.0),
    terms=lambda values, _: {"growth": values["growth_per_m"]},
    remedy="Nothing to mend: a print weighs. With it in the file every layer is compensated for its own mass.",
)


GROUND_SPRING = Effect(
    name="ground_spring",
    title="A spring that pulls the axis to one place",
    kind="force",
    physics="Hoses, cables, a bellows or gravity on a curved guide pull harder the farther the axis goes.",
    equation="F = k q",
    parameters=(
        Parameter(
            "stiffness_n_per_m",
            "N/m",
            "k",
            (-1e9, 1e9),
            (-100, 1000),
            5.0,
            on_axis=OnAxis(size=lambda s: USUAL_SHARE * s.force_n / s.way_m),
        ),
    ),
    in_data="The force at rest grows along the axis.",
    confounded_with={"cogging_force": "The whole travel: a ripple comes back, a spring does not."},
    of=("axis",),
    terms=lambda values, _: {"ground": values["stiffness_n_per_m"]},
    needs="freedom",
    remedy="Look for what pulls to one place: hoses, cables, a bellows, a counterweight.",
)


PENDULUM_GRAVITY = Effect(
    name="pendulum_gravity",
    title="Gravity on an arm that turns",
    kind="force",
    physics="An arm, a load or a rotor out of balance is pulled to where its weight hangs lowest.",
    equation="F = m g l sin(q − q₀)",
    parameters=(
        Parameter(
            "force_n",
            "N",
            "m g l: at a right angle",
            (-1e6, 1e6),
            (-10, 10),
            0.1,
            on_axis=OnAxis(size=lambda s: USUAL_SHARE * s.force_n / min(s.way_m, 1.0)),
        ),
        Parameter(
            "angle_deg", "degrees", "q₀: where it hangs down", (-360, 360), (-180, 180), 5.0, role="shape", default=0.0
        ),
    ),
    in_data="The force at rest goes as a sine of the angle, to one side of its lowest place and to the other.",
    confounded_with={
        "ground_spring": "Angles beyond 60 degrees: there a weight pulls less than a spring, and none at the top.",
        "belt_hardening": "The drive switched off: gravity stays, a drive that softens does not.",
        "cogging_force": "A whole turn: gravity comes once, a ripple several times.",
    },
    of=("axis",),
    terms=lambda values, _: {"weight_moment": values["force_n"], "weight_angle": np.radians(values["angle_deg"])},
    needs="turning",
    remedy="Nothing to mend: a weight hangs at the axis. Balance it, or leave it in the file.",
)


TURN_APART = 0.7  # of a turn over the travel, by which pitches of a force are apart: one between them is half seen


def _force_pitches(s: MotionScales) -> list[float]:
    return [1e3 * s.travel_m / turns for turns in np.arange(2.0, 40.0, TURN_APART).tolist()]


USUAL_RIPPLE = OnAxis(size=lambda s: USUAL_SHARE * s.force_n / 3)


COGGING_FORCE = Effect(
    name="cogging_force",
    title="A force that repeats along the axis",
    kind="force",
    physics=(
        "Magnets of a motor, balls of a screw or teeth of a rack pull to and fro, once a pitch. There may be several "
        "lines, each with a pitch: of a motor's poles, slots and their multiples."
    ),
    equation="F = Σ s sin(2π q/p) + c cos(2π q/p)",
    parameters=(
        Parameter("sine_n", "N", "s", (-1e5, 1e5), (-5, 5), 0.5, "lines", on_axis=USUAL_RIPPLE),
        Parameter("cosine_n", "N", "c", (-1e5, 1e5), (-5, 5), 0.5, "lines", on_axis=USUAL_RIPPLE),
        Parameter(
            "pitch_mm",
            "mm",
            "p; of N lines a turn, 2π/N rad",
            (0.01, 10_000),
            (1, 50),
            0.5,
            "lines",
            "shape",
            on_axis=OnAxis(starts=_force_pitches),
        ),
    ),
    in_data="The force needed at constant speed repeats with the place, whatever the speed.",
    confounded_with={"ground_spring": "More than one pitch of travel: a spring does not come back."},
    of=("axis",),
    terms=lambda values, _: {
        "ripples": np.column_stack([values["sine_n"], values["cosine_n"], 2e3 * np.pi / values["pitch_mm"]])
    },
    remedy="Look for what repeats along the travel: magnets, a screw's balls, a rack's or a belt's teeth.",
    of_motors=True,
)

EFFECTS = (FRAME_MODE, GANTRY_RACKING, TOOLHEAD_MODE, GROWING_BED, GROUND_SPRING, PENDULUM_GRAVITY, COGGING_FORCE)
