"""The traps: what happens to owners between `record plan` and `diagnose`, and what an answer may and must not say.

Captures that `record join` refuses by themselves are in `tests/unit/ffcomp/record`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from validation.traps import mishaps as m
from validation.traps.bench import Said, Trap

# What may be said: nothing is named where nothing is hidden; a refusal says what to do.
A_MASS = Said(("effects", "unknown"), names=("effector_mass",), values={"effector_mass.added_kg": (0.118, 0.138)})
A_FRICTION = Said(
    ("effects", "unknown"),
    names=("coulomb_friction", "stribeck_friction"),
    values={"coulomb_friction.force_n": (2.0, 3.0)},
)
NOTHING = Said(("none", "unknown"), names=())
HARMLESS = replace(NOTHING, refused=True)
MISLED = replace(HARMLESS, file=False)  # the data misrepresent the printer: no file may come of them
GAINS = replace(MISLED, verdicts=("effects", "unknown"), names=("sensor_gain",), file=None)
TURN = replace(GAINS, names=("sensor_misalignment",))
ARMS = replace(HARMLESS, verdicts=("none", "unknown", "effects"), names=("arm_geometry",))
STILL_A_MASS = replace(A_MASS, verdicts=("effects", "unknown", "none"), refused=True, must_not=("nothing is missing",))


def refused(*must: str) -> Said:
    """It is refused, or nothing is known, with these words."""
    return replace(MISLED, verdicts=("unknown",), must=must)


def harmless(*must: str) -> Said:
    """Nothing is named, and these words are said."""
    return replace(HARMLESS, must=must)


SISTER = {"carriage.mass_kg": 1.4, "effector.nozzle_mass_kg": 1.3, "carriage.belt_stiffness_n_per_m": 0.65}
SISTER |= {"kinematics.arm_length_mm": 1.13, "kinematics.delta_radius_mm": 1.13}
SKEW = np.array([[1.0, np.tan(np.deg2rad(1.5)), 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
LOOSE = m.on_bracket(62.0, rattle=0.3)
CAMERA: dict[str, Any] = {"printer": m.with_camera}


def phone(hertz: float) -> dict[str, Any]:
    """A phone in the chip's place, without a filter of its own, and a camera to be found."""
    return {**CAMERA, "chip": lambda chip, _: replace(chip, rate_hz=hertz), "written": m.by_phone()}


TRAPS: tuple[Trap, ...] = (
    Trap("captures-plain", "all as it should be", NOTHING),
    Trap("captures-camera", "all as it should be, 128 g", A_MASS, **CAMERA),
    Trap("captures-friction", "all as it should be, 2.5 N of dry friction", A_FRICTION, m.rubbing()),
    # the firmware
    Trap(
        "acceleration-limited",
        "the firmware's acceleration limit is half of the plan's",
        refused("limit|another motion"),
        moved=m.replanned(acceleration=0.5),
    ),
    Trap("s-curve", "the firmware makes S-curves of the ramps", MISLED, moved=m.s_curve),
    Trap("skew-on", "a skew correction of 1.5° left on", MISLED, moved=m.bent(SKEW)),
    Trap("mirrored", "two motors exchanged: x is mirrored", HARMLESS, moved=m.bent(np.diag([-1.0, 1.0, 1.0]))),
    Trap("arm-length", "arms 2 % longer than stated", ARMS, firmware={"kinematics.arm_length_mm": 0.98}),
    Trap("sister-file", "file of the larger sister model", MISLED, file=SISTER),
    # the printer
    Trap("slip-once", "lost steps in one capture", harmless("lost steps|repeat"), m.slipping, by_run=True),
    Trap("cable", "a cable swings on the head", MISLED, m.hiding("swinging_cable")),
    Trap("belts-warm", "belts soften by 15 % from the first run to the last", MISLED, m.softening, by_run=True),
    Trap(
        "captures-warm-up",
        "friction in every first repeat, none in the second",
        refused("repeat"),
        m.rubbing(until=3),
        by_run=True,
    ),
    Trap("play", "a motor's bracket gives way", MISLED, m.hiding("soft_bracket")),
    # around the chip
    Trap("fan", "a fan at 83 Hz, 2 m/s²", HARMLESS, feels=m.tone),
    Trap("bump", "somebody bumps the table once", HARMLESS, feels=m.bumped),
    Trap(
        "on-bed",
        "the chip on the bed",
        refused("head|nozzle|loose|correlation"),
        feels=m.filtered(2, (15.0, 60.0), "bandpass", share=0.05),
    ),
    Trap("bracket", "the chip on a bracket that rings at 95 Hz", MISLED, feels=m.on_bracket(95.0)),
    Trap("loose-chip", "the chip rattles", refused("loose|repeat"), feels=LOOSE),
    Trap("whine", "motors whine at 1640 Hz, the chip at 1600 Hz", MISLED, feels=m.whining),
    Trap("two-chips", "128 g; one of two chips is loose", STILL_A_MASS, **CAMERA, second=LOOSE),
    # the chip
    Trap("low-pass", "the chip's low-pass at 92 Hz is on", MISLED, feels=m.filtered(1, 92.0, "lowpass")),
    Trap("clone", "x 8 % too large, y 6 % too small", GAINS, feels=lambda t, felt, _: felt * [1.08, 0.94, 1.0]),
    Trap("turned-20", "the chip is turned by 20°", TURN, chip=m.turned(20.0)),
    Trap("wrong-axes-map", "--axes-map of another mounting", refused("axes"), axes_map="x,y,z"),
    # the files
    Trap("one-in-g", "one capture in g", harmless(r"unit|gravity| g\b"), written=m.scaled(1e-3 / 9.80665, only=(1,))),
    Trap("no-gravity", "128 g; an app without gravity", STILL_A_MASS, **CAMERA, written=m.by_phone(gravity=False)),
    Trap("phone-400", "128 g; a phone at 400 Hz", STILL_A_MASS, **phone(400.0)),
    Trap("phone-100", "128 g; a phone at 100 Hz", refused("rate"), **phone(100.0)),
    Trap("three-ms", "the first 3 ms of every capture are missing", HARMLESS, written=m.cut(from_s=-0.997)),
    # a third capture is right, and may be diagnosed
    Trap("swapped", "two captures swapped", replace(MISLED, must=("another motion|names",)), written=m.swapped),
)
