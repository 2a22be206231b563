"""The traps: what happens to owners between `record plan` and `diagnose`, and what an answer may and must not say."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from validation.blind.delta import OUTSIDE
from validation.blind.real import Real
from validation.traps import mishaps as m
from validation.traps.bench import CHIP, USUAL, Bench, Sensing

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
    values: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # effect.key → where its interval reaches
    file: bool | None = None  # whether a better file may be written; None: either


@dataclass(frozen=True)
class Trap:
    """One row of the table."""

    name: str
    about: str
    said: Said
    bench: Bench = USUAL
    sensing: Sensing = field(default_factory=Sensing)
    axes_map: str | None = None


def with_camera(real: Real, _: int) -> Real:
    """128 g on the nozzle holder."""
    return real.changed("effector", nozzle_mass_kg=real.machine["effector"]["nozzle_mass_kg"] + CAMERA_KG)


def rubbing(real: Real, run: int, until: int = 6) -> Real:
    """2.5 N of dry friction, perhaps in the first runs only."""
    return real.having(**FRICTION) if run < until else real


def softening(real: Real, run: int) -> Real:
    """Belts that warm up from run to run: 15 % in the end."""
    return real.having(warm_share=0.03 * run, warm_s=1e-3)


def slipping(real: Real, run: int) -> Real:
    """A motor loses steps in the second run."""
    return real.ordered(m.slips((1.9, 2.4), 0.64)) if run == 1 else real


def hiding(real: Real, _: int, name: str) -> Real:
    """Something outside the catalogue."""
    return OUTSIDE[name](np.random.default_rng(1), 1.0, real)[1]


def firmware(name: str, about: str, said: Said, moved: Any, **numbers: Any) -> Trap:
    """Return a trap of what the firmware does with the moves."""
    return Trap(name, about, said, Bench(moved=partial(moved, **numbers)))


def felt(name: str, about: str, said: Said, feels: Any, **numbers: Any) -> Trap:
    """Return a trap of what the chip feels."""
    return Trap(name, about, said, sensing=Sensing({CHIP: (partial(feels, **numbers),)}))


def chip(name: str, about: str, said: Said, changed: Any, **numbers: Any) -> Trap:
    """Return a trap of the chip itself."""
    return Trap(name, about, said, sensing=Sensing(chip=partial(changed, **numbers)))


def written(name: str, about: str, said: Said, file: Any, bench: Bench = USUAL, **numbers: Any) -> Trap:
    """Return a trap of the files."""
    return Trap(name, about, said, bench, Sensing(files=(partial(file, **numbers),)))


def phone(name: str, about: str, said: Said, hertz: float) -> Trap:
    """Return a trap of a phone in the chip's place, with a camera to be found."""
    return Trap(name, about, said, CAMERA, Sensing(chip=partial(m.at_rate, hertz=hertz), files=(m.by_phone,)))


CAMERA, RUBBING = Bench(with_camera), Bench(rubbing)
WARMING_UP = Bench(partial(rubbing, until=3), by_run=True)
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
SISTER = {"carriage.mass_kg": 1.4, "effector.nozzle_mass_kg": 1.3, "carriage.belt_stiffness_n_per_m": 0.65}
SISTER |= {"kinematics.arm_length_mm": 1.13, "kinematics.delta_radius_mm": 1.13}
SHORTER = {"kinematics.arm_length_mm": 0.98}
LOOSE = partial(m.on_bracket, hertz=62.0, rattle=0.3)
SKEW = [[1.0, np.tan(np.deg2rad(1.5)), 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
EXCHANGED = ("ffcomp-zigzag-0", "ffcomp-reversals-1")


def refused(*must: str) -> Said:
    """It is refused, or nothing is known, with these words."""
    return replace(MISLED, verdicts=("unknown",), must=must)


def harmless(*must: str) -> Said:
    """Nothing is named, and these words are said."""
    return replace(HARMLESS, must=must)


TRAPS: tuple[Trap, ...] = (
    Trap("captures-plain", "all as it should be", NOTHING),
    Trap("captures-camera", "all as it should be, 128 g", A_MASS, CAMERA),
    Trap("captures-friction", "all as it should be, 2.5 N of dry friction", A_FRICTION, RUBBING),
    # the firmware
    firmware("speed-90", "speed factor 90 %", refused("speed factor|another motion"), m.replanned, speed=0.9),
    firmware(
        "acceleration-limited",
        "the firmware's acceleration limit is half of the plan's",
        refused("limit|another motion"),
        m.replanned,
        acceleration_mm_per_s2=0.5,
    ),
    firmware("s-curve", "the firmware makes S-curves of the ramps", MISLED, m.s_curve),
    firmware("shaper-zv", "ZV at 40 Hz left on", refused("input shaper"), m.shaped, x=("zv", 40.0), y=("zv", 40.0)),
    firmware(
        "shaper-3hump-x", "3HUMP_EI left on, x", refused("input shaper", r"\bx\b"), m.shaped, x=("3hump_ei", 75.0)
    ),
    firmware("skew-on", "a skew correction of 1.5° left on", MISLED, m.bent, by=SKEW),
    firmware("mirrored", "two motors exchanged: x is mirrored", HARMLESS, m.bent, by=np.diag([-1.0, 1.0, 1.0])),
    Trap("arm-length", "arms 2 % longer than stated", ARMS, Bench(firmware=SHORTER)),
    Trap("other-plan", "the plan of another run", refused("plan|another motion"), sensing=Sensing(seed_of_plan=2)),
    Trap("sister-file", "file of the larger sister model", MISLED, Bench(file=SISTER)),
    # the printer
    Trap("slip-once", "lost steps in one capture", harmless("lost steps|repeat"), Bench(slipping, by_run=True)),
    Trap("cable", "a cable swings on the head", MISLED, Bench(partial(hiding, name="swinging_cable"))),
    Trap("belts-warm", "belts soften by 15 % from the first run to the last", MISLED, Bench(softening, by_run=True)),
    Trap("captures-warm-up", "friction in every first repeat, none in the second", refused("repeat"), WARMING_UP),
    Trap("play", "a motor's bracket gives way", MISLED, Bench(partial(hiding, name="soft_bracket"))),
    # around the chip
    felt("fan", "a fan at 83 Hz, 2 m/s²", HARMLESS, m.tone, hertz=83.0, m_per_s2=2.0),
    felt("bump", "somebody bumps the table once", HARMLESS, m.bumped, once=1),
    felt("on-bed", "the chip on the bed", refused("head|nozzle|loose|correlation"), m.elsewhere, share=0.05),
    felt("bracket", "the chip on a bracket that rings at 95 Hz", MISLED, m.on_bracket, hertz=95.0),
    felt("loose-chip", "the chip rattles", refused("loose|repeat"), LOOSE),
    felt("whine", "motors whine at 1640 Hz, the chip at 1600 Hz", MISLED, m.whining),
    Trap(
        "two-chips", "128 g; one of two chips is loose", STILL_A_MASS, CAMERA, Sensing({CHIP: (), "hotend": (LOOSE,)})
    ),
    # the chip
    felt("low-pass", "the chip's low-pass at 92 Hz is on", MISLED, m.low_pass, hertz=92.0),
    felt("clone", "x 8 % too large, y 6 % too small", GAINS, m.gains, xyz=(1.08, 0.94, 1.0)),
    chip("turned-20", "the chip is turned by 20°", TURN, m.turned, degrees=20.0),
    chip("moved-chip", "turned by 90° between repeats", refused("repeat|axes"), m.turned, degrees=90.0, repeats=(2,)),
    Trap("wrong-axes-map", "--axes-map of another mounting", refused("axes"), axes_map="x,y,z"),
    written("clipped", "range of ±1 g", refused("clipped"), m.clipped, g=1.0),
    # the files
    written("one-in-g", "one capture in g", harmless(r"unit|gravity| g\b"), m.scaled, factor=1e-3 / 9.80665, only=(1,)),
    written("all-halved", "all captures halved (range misread)", refused("gravity|half|range"), m.scaled, factor=0.5),
    written("no-gravity", "128 g; an app without gravity", STILL_A_MASS, m.by_phone, CAMERA, gravity=False),
    phone("phone-400", "128 g; a phone at 400 Hz", STILL_A_MASS, 400.0),
    phone("phone-100", "128 g; a phone at 100 Hz", refused("rate"), 100.0),
    written("phone-ms", "times in ms under a header in s", harmless(r"\bms\b"), m.by_phone, change=m.in_ms),
    written("truncated", "captures cut in the middle", refused("longer|cut short|runs from"), m.cut, share=0.6),
    written("late-start", "captures without their first 0.9 s", refused("begin"), m.cut, from_s=-0.1),
    written("three-ms", "the first 3 ms of every capture are missing", HARMLESS, m.cut, from_s=-0.997),
    # a third capture is right, and may be diagnosed
    written(
        "swapped", "two captures swapped", replace(MISLED, must=("another motion|names",)), m.swapped, names=EXCHANGED
    ),
    written("copied", "the repeats are copies of one file", refused("same|cop"), m.copied),
    written("lost-rows", "one row in twelve is lost", refused("missing|rows"), m.lost_rows, share=0.08),
    written("overflows", "12 overflows counted", refused("overflow|lost"), m.with_comment, line="##overflows=12"),
    written("same-axis", "y exported in place of z", refused("same|correlation|axes"), m.twice_the_same_axis),
)
