"""The traps: what happens to owners between `record plan` and `diagnose`, and what an answer may and must not say."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from validation.blind.delta import OUTSIDE
from validation.traps import mishaps as m
from validation.traps.bench import CHIP, Bench, Sensing

FRICTION = {"dry": np.full(3, 2.52), "dry_kind": 2, "bristle": 2e-5, "dry_v": 1.5e-3}  # N, each guide
CAMERA_KG = 0.128


@dataclass(frozen=True)
class Said:
    """Allowed, required and forbidden statements; patterns are searched in the answer's text, in any case."""

    verdicts: tuple[str, ...] = ("effects", "none", "unknown")
    refused: bool = False  # the recordings may be refused (exit code 5); then `must` is searched in the refusal
    names: tuple[str, ...] | None = None  # effects that may be named; None: any
    must: tuple[str, ...] = ()
    must_not: tuple[str, ...] = ()
    values: Mapping[str, tuple[float, float]] = field(
        default_factory=dict
    )  # effect.key -> where its interval must reach
    file: bool | None = None  # whether a better file may be written; None: either


@dataclass(frozen=True)
class Trap:
    """One row of the table."""

    name: str
    about: str
    hidden: str
    said: Said
    bench: Bench = field(default_factory=Bench)
    sensing: Sensing = field(default_factory=Sensing)
    seed_of_plan: int = 1  # of the plan that is given with the captures
    axes_map: str | None = None


NAMED = Said(
    ("effects",), names=("coulomb_friction", "stribeck_friction"), values={"coulomb_friction.force_n": (2.0, 3.0)}
)
CAMERA = Said(("effects",), names=("effector_mass",), values={"effector_mass.added_kg": (0.118, 0.138)})
CAMERA_BENCH, FRICTION_BENCH = Bench(added_kg=CAMERA_KG), Bench(fields=FRICTION)
NOTHING, A_CAMERA, SOME_FRICTION = "nothing", "128 g", "2.5 N of dry friction"

# What may be said: nothing is named where nothing is hidden; a refusal says what to do.
HARMLESS = Said(("none", "unknown"), refused=True, names=())
MISLED = replace(HARMLESS, file=False)  # the data misrepresent the printer: no file may come of them
STILL_CAMERA = replace(CAMERA, verdicts=("effects", "unknown", "none"), refused=True, must_not=("nothing is missing",))
SIZE = {"carriage.mass_kg": 1.4, "effector.nozzle_mass_kg": 1.3, "carriage.belt_stiffness_n_per_m": 0.65}
SHORTER_ARMS = {"kinematics.arm_length_mm": 0.98}
GEOMETRY = {"kinematics.arm_length_mm": 1.13, "kinematics.delta_radius_mm": 1.13}


def refused(*must: str) -> Said:
    """It is refused, or nothing is known, with these words."""
    return replace(MISLED, verdicts=("unknown",), must=must)


def _softer(run: int) -> dict[str, float]:
    """Belts that warm up from run to run: 15 % in the end."""
    return {"warm_share": 0.03 * run, "warm_s": 1e-3}


def _loose(hertz: float) -> m.Feels:
    return m.on_bracket(hertz, rattle=0.3)


def _friction_in_first_repeats(run: int) -> dict[str, object]:
    return FRICTION if run < 3 else {}


def _of_firmware(name: str, about: str, said: Said, moved: m.Moved) -> Trap:
    return Trap(name, about, NOTHING, said, Bench(moved=moved))


def _felt(name: str, about: str, said: Said, *feels: m.Feels, hidden: str = NOTHING) -> Trap:
    return Trap(name, about, hidden, said, sensing=Sensing(feels))


def _written(name: str, about: str, said: Said, *files: m.Writes) -> Trap:
    return Trap(name, about, NOTHING, said, sensing=Sensing(files=files))


GAINS = replace(MISLED, verdicts=("effects", "unknown"), names=("sensor_gain",), file=None)
TURN = replace(GAINS, names=("sensor_misalignment",))
ARMS = replace(HARMLESS, verdicts=("none", "unknown", "effects"), names=("arm_geometry",))
SLOW_PHONE, FASTER_PHONE = (Sensing(chip=m.at_rate(hertz), files=(m.by_phone(),)) for hertz in (100.0, 400.0))
TWO_CHIPS = Sensing(chips={CHIP: (), "hotend": (_loose(62.0),)})
ZV_XY, THREE_HUMPS_X = m.shaped(x=("zv", 40.0), y=("zv", 40.0)), m.shaped(x=("3hump_ei", 75.0))
NO_GRAVITY, IN_MS = m.by_phone(gravity=False), m.by_phone(change=m.in_ms)
A_GRAM = m.scaled(1e-3 / 9.80665, (1,))
OVERFLOWS = m.with_comment("##overflows=12")
EXCHANGED = m.swapped("ffcomp-zigzag-0", "ffcomp-reversals-1")
SEEN = ("effects", "unknown")

TRAPS: tuple[Trap, ...] = (
    Trap("captures-plain", "all as it should be", NOTHING, replace(HARMLESS, refused=False)),
    Trap("captures-camera", "all as it should be", A_CAMERA, replace(CAMERA, verdicts=SEEN), CAMERA_BENCH),
    Trap("captures-friction", "all as it should be", SOME_FRICTION, replace(NAMED, verdicts=SEEN), FRICTION_BENCH),
    # the firmware
    _of_firmware("speed-90", "speed factor 90 %", refused("speed factor|another motion"), m.replanned(0.9)),
    _of_firmware(
        "acceleration-limited",
        "the firmware's acceleration limit is half of the plan's",
        refused("limit|another motion"),
        m.replanned(acceleration_mm_per_s2=0.5),
    ),
    _of_firmware("s-curve", "the firmware makes S-curves of the ramps", MISLED, m.s_curve),
    _of_firmware("shaper-zv", "ZV at 40 Hz left on, both axes", refused("input shaper"), ZV_XY),
    _of_firmware("shaper-3hump-x", "3HUMP_EI at 75 Hz left on, x", refused("input shaper", r"\bx\b"), THREE_HUMPS_X),
    _of_firmware("skew-on", "a skew correction of 1.5° left on", MISLED, m.bent(m.skewed)),
    _of_firmware("mirrored", "two motors exchanged: x is mirrored", HARMLESS, m.bent(m.mirrored)),
    Trap("arm-length", "arms 2 % longer than stated", "longer arms", ARMS, Bench(firmware=SHORTER_ARMS)),
    Trap("other-plan", "the plan of another run", NOTHING, refused("plan|another motion"), seed_of_plan=2),
    Trap("sister-file", "file of the larger sister model", NOTHING, MISLED, Bench(file_factors=GEOMETRY | SIZE)),
    # the printer
    Trap(
        "slip-once",
        "a motor loses steps in one capture",
        NOTHING,
        replace(HARMLESS, must=("lost steps|repeat",)),
        Bench(orders=(m.Slips((1.9, 2.4), 0.64),), orders_in=(1,)),
    ),
    Trap("cable", "a cable swings on the head", "a cable", MISLED, Bench(outside=OUTSIDE["swinging_cable"])),
    Trap("belts-warm", "belts soften by 15 % from the first run to the last", "drift", MISLED, Bench(in_run=_softer)),
    Trap(
        "captures-warm-up",
        "friction in every first repeat, none in the second",
        "friction that goes",
        refused("repeat"),
        Bench(in_run=_friction_in_first_repeats),
    ),
    Trap("play", "a motor's bracket gives way", "a bracket", MISLED, Bench(outside=OUTSIDE["soft_bracket"])),
    # around the chip
    _felt("fan", "a fan at 83 Hz, 2 m/s²", HARMLESS, m.tone(83.0, 2.0)),
    _felt("bump", "somebody bumps the table once", HARMLESS, m.bumped(1)),
    _felt("on-bed", "the chip on the bed", refused("head|nozzle|loose|correlation"), m.elsewhere(0.05)),
    _felt("bracket", "the chip on a bracket that rings at 95 Hz", MISLED, m.on_bracket(95.0)),
    _felt("loose-chip", "the chip rattles", refused("loose|repeat"), _loose(62.0)),
    _felt("whine", "motors whine at 1640 Hz, the chip at 1600 Hz", MISLED, m.whining),
    Trap("two-chips", "one of two chips is loose", A_CAMERA, STILL_CAMERA, CAMERA_BENCH, TWO_CHIPS),
    # the chip
    _felt("low-pass", "the chip's low-pass at 92 Hz is on", MISLED, m.low_pass(92.0)),
    _felt("clone", "x 8 % too large, y 6 % too small", GAINS, m.gains(1.08, 0.94, 1.0), hidden="gains"),
    Trap("turned-20", "the chip is turned by 20°", "a turn", TURN, sensing=Sensing(chip=m.turned(20.0))),
    Trap(
        "moved-chip",
        "the chip is turned by 90° between the repeats",
        NOTHING,
        refused("repeat|axes"),
        sensing=Sensing(chip=m.turned(90.0, 2)),
    ),
    Trap("wrong-axes-map", "--axes-map of another mounting", NOTHING, refused("axes"), axes_map="x,y,z"),
    _written("clipped", "range of ±1 g", refused("clipped"), m.clipped(1.0)),
    # the files
    _written("one-in-g", "one capture in g", replace(HARMLESS, must=(r"unit|gravity| g\b",)), A_GRAM),
    _written("all-halved", "all captures halved (range misread)", refused("gravity|half|range"), m.scaled(0.5)),
    Trap("no-gravity", "an app without gravity", A_CAMERA, STILL_CAMERA, CAMERA_BENCH, Sensing(files=(NO_GRAVITY,))),
    Trap("phone-400", "a phone at 400 Hz", A_CAMERA, STILL_CAMERA, CAMERA_BENCH, FASTER_PHONE),
    Trap("phone-100", "a phone at 100 Hz", A_CAMERA, refused("rate"), CAMERA_BENCH, SLOW_PHONE),
    _written("phone-ms", "times in ms under a header in s", replace(HARMLESS, must=(r"\bms\b",)), IN_MS),
    _written("truncated", "captures cut in the middle", refused("longer|cut short|runs from"), m.cut(share=0.6)),
    _written("late-start", "captures without their first 0.9 s", refused("begin"), m.cut(from_s=-0.1)),
    _written("three-ms", "the first 3 ms of every capture are missing", HARMLESS, m.cut(from_s=-0.997)),
    # a third capture is right, and may be diagnosed
    _written("swapped", "two captures swapped", replace(MISLED, must=("another motion|names",)), EXCHANGED),
    _written("copied", "the repeats are copies of one file", refused("same|cop"), m.copied),
    _written("lost-rows", "one row in twelve is lost", refused("missing|rows"), m.lost_rows(0.08)),
    _written("overflows", "the firmware counted 12 overflows", refused("overflow|lost"), OVERFLOWS),
    _written("same-axis", "y exported in place of z", refused("same|correlation|axes"), m.twice_the_same_axis),
)
