"""The traps: what owners bring, and what a diagnosis may and must not say of it (a declarative list)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from validation.traps.bench import CAMERA_KG, FRICTION, USUAL, Bench, Spoil
from validation.traps.spoils import Shaped, joined_by_eye, one_channel


@dataclass(frozen=True)
class Said:
    """What may and must not be said. Patterns are searched in the text of the answer, whatever the letters' case."""

    verdicts: tuple[str, ...] = ("effects", "none", "unknown")
    findings: tuple[str, ...] = ()  # any if empty
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
    bench: Bench
    said: Said
    spoils: tuple[Spoil, ...] = ()


FRICTION_BENCH, CAMERA_BENCH, PLAIN = Bench(fields=FRICTION), Bench(added_kg=CAMERA_KG), Bench()
FRICTION_NAMES = ("coulomb_friction", "stribeck_friction")
NAMED = Said(("effects",), names=FRICTION_NAMES, values={"coulomb_friction.force_n": (2.0, 3.0)})
CAMERA = Said(("effects",), names=("effector_mass",), values={"effector_mass.added_kg": (0.118, 0.138)})
ELSEWHERE = "at places it was not fitted to"
ONE_PLACE = tuple(replace(e, place=(3.0 * i, 0.0, 30.0)) for i, e in enumerate(USUAL))
ROUGH = {
    "carriage.belt_stiffness_n_per_m": 0.85,
    "carriage.mass_kg": 0.8,
    "effector.nozzle_mass_kg": 0.85,
    "carriage.arm_pair_mass_kg": 0.88,
    "effector.extruder_mass_kg": 1.15,
}

TRAPS: tuple[Trap, ...] = (
    Trap("control", "dry friction, as our formula does not have it", FRICTION_BENCH, NAMED),
    Trap("camera", "joined exactly", CAMERA_BENCH, CAMERA),
    Trap(
        "files-shifted-3ms",
        "joined by eye",
        CAMERA_BENCH,
        Said(("effects", "unknown"), names=("effector_mass",), must=("late|early",), must_not=("nothing is missing",)),
        (joined_by_eye(3e-3),),
    ),
    Trap(
        "files-shifted-1ms",
        "joined by eye, with care",
        CAMERA_BENCH,
        Said(("effects", "unknown"), names=("effector_mass",), must=("late|early",), must_not=("nothing is missing",)),
        (joined_by_eye(1e-3),),
    ),
    Trap(
        "warm-up",
        "friction in every first repeat, none in the second",
        Bench(in_repeat={1: FRICTION}),
        Said(("unknown",), refused=True, must=("repeat",), file=False),
    ),
    Trap(
        "one-motion-twice",
        "one motion recorded twice",
        replace(FRICTION_BENCH, experiments=(replace(USUAL[2], kind="infill", place=(0.0, 0.0, 30.0)),)),
        Said(("effects", "unknown"), names=FRICTION_NAMES, must=("one place only|not tested",), must_not=(ELSEWHERE,)),
    ),
    Trap(
        "one-place",
        "several motions within a few millimetres",
        replace(CAMERA_BENCH, experiments=ONE_PLACE),
        Said(("effects", "unknown"), names=("effector_mass",), must=("one place only",), must_not=(ELSEWHERE,)),
    ),
    Trap("noise-0.0001", "sensors of a laboratory", replace(FRICTION_BENCH, noise=1e-4), NAMED),
    Trap("noise-0.01", "good sensors", replace(FRICTION_BENCH, noise=1e-2), NAMED),
    Trap(
        "noise-0.21",
        "poor sensors",
        replace(FRICTION_BENCH, noise=0.21),
        replace(NAMED, verdicts=("effects", "unknown")),
    ),
    Trap(
        "noise-0.21-nothing",
        "poor sensors, and nothing hidden",
        Bench(noise=0.21),
        Said(("unknown",), must=("cannot tell",), must_not=("nothing is missing",), file=False),
    ),
    Trap(
        "rough-file",
        "the file 12 to 20 % off in five numbers, saying 2 %",
        Bench(file_factors=ROUGH),
        Said(must=("weigh|off by",)),
    ),
    Trap(
        "shaper-on",
        "an MZV shaper at 42 Hz left on",
        Bench(orders=(Shaped("mzv", 42.0),)),
        Said(("unknown",), must=("input shaper", "MZV"), file=False),
    ),
    Trap(
        "dead-channel",
        "one channel dead",
        PLAIN,
        Said(("unknown",), refused=True, must=("acc_y",), file=False),
        (one_channel("acc_y", "dead"),),
    ),
    Trap(
        "loose-sensor",
        "one axis' mount loose",
        PLAIN,
        Said(("unknown",), must=("acc_y",), file=False),
        (one_channel("acc_y", "loose"),),
    ),
    Trap(
        "clipped-sensor",
        "one axis clipped",
        PLAIN,
        Said(("unknown",), refused=True, must=("acc_y",), file=False),
        (one_channel("acc_y", "clipped"),),
    ),
    Trap(
        "pair",
        "friction and a camera",
        replace(FRICTION_BENCH, added_kg=CAMERA_KG),
        Said(("effects", "unknown"), names=(*FRICTION_NAMES, "effector_mass")),
    ),
    Trap(
        "planar",
        "all in one plane, the command in carriage heights",
        replace(CAMERA_BENCH, experiments=tuple(replace(e, planar=True) for e in USUAL)),
        replace(CAMERA, verdicts=("effects", "unknown")),
    ),
    Trap("nothing", "nothing hidden", PLAIN, Said(("none",))),
)
