"""Declare a gantry that yaws under its toolhead."""

from __future__ import annotations

from models.effects.effect import Effect, Parameter

EFFECT = Effect(
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
)
