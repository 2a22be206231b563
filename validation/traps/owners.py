"""Traps at the level of captures: what happens to owners between `record plan` and `diagnose` (a declarative list)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from validation.blind.delta.outside import OUTSIDE
from validation.traps import mishaps as m
from validation.traps.bench import CAMERA_KG, FRICTION
from validation.traps.captures import CHIP, CaptureBench, Sensing
from validation.traps.catalogue import CAMERA, NAMED, Said


@dataclass(frozen=True)
class CaptureTrap:
    """One row of the table."""

    name: str
    about: str
    hidden: str
    said: Said
    bench: CaptureBench = field(default_factory=CaptureBench)
    sensing: Sensing = field(default_factory=Sensing)
    seed_of_plan: int = 1  # of the plan that is given with the captures
    axes_map: str | None = None


CAMERA_BENCH, FRICTION_BENCH = CaptureBench(added_kg=CAMERA_KG), CaptureBench(fields=FRICTION)
NOTHING, A_CAMERA, SOME_FRICTION = "nothing", "128 g", "2.5 N of dry friction"

# What may be said: nothing is named where nothing is hidden; a refusal says what to do.
HARMLESS = Said(("none", "unknown"), refused=True, names=())
MISLED = replace(HARMLESS, file=False)  # the data misrepresent the printer: no file may come of them
STILL_CAMERA = replace(CAMERA, verdicts=("effects", "unknown", "none"), refused=True, must_not=("nothing is missing",))
SIZE = {"carriage.mass_kg": 1.4, "effector.nozzle_mass_kg": 1.3, "carriage.belt_stiffness_n_per_m": 0.65}
GEOMETRY = {"kinematics.arm_length_mm": 1.13, "kinematics.delta_radius_mm": 1.13}


def refused(*must: str) -> Said:
    """It is refused, or nothing is known, with these words."""
    return replace(MISLED, verdicts=("unknown",), must=must)


def _softer(run: int) -> dict[str, float]:
    """Belts that warm up from run to run: 15 % in the end."""
    return {"warm_share": 0.03 * run, "warm_s": 1e-3}


def _loose(hertz: float) -> m.Feels:
    return m.on_bracket(hertz, rattle=0.3)


CAPTURE_TRAPS: tuple[CaptureTrap, ...] = (
    CaptureTrap("captures-plain", "all as it should be", NOTHING, replace(HARMLESS, refused=False)),
    CaptureTrap(
        "captures-camera",
        "all as it should be",
        A_CAMERA,
        replace(CAMERA, verdicts=("effects", "unknown")),
        CAMERA_BENCH,
    ),
    CaptureTrap(
        "captures-friction",
        "all as it should be",
        SOME_FRICTION,
        replace(NAMED, verdicts=("effects", "unknown")),
        FRICTION_BENCH,
    ),
    # the firmware
    CaptureTrap(
        "speed-90",
        "speed factor 90 %",
        NOTHING,
        refused("speed factor|another motion"),
        CaptureBench(moved=m.replanned(0.9)),
    ),
    CaptureTrap(
        "acceleration-limited",
        "the firmware's acceleration limit is half of the plan's",
        NOTHING,
        refused("limit|another motion"),
        CaptureBench(moved=m.replanned(acceleration_mm_per_s2=0.5)),
    ),
    CaptureTrap(
        "corner-speed",
        "the firmware takes corners at half the plan's speed",
        NOTHING,
        MISLED,
        CaptureBench(moved=m.replanned(square_corner_velocity_mm_per_s=0.5)),
    ),
    CaptureTrap("s-curve", "the firmware makes S-curves of the ramps", NOTHING, MISLED, CaptureBench(moved=m.s_curve)),
    CaptureTrap(
        "shaper-zv",
        "ZV at 40 Hz left on, both axes",
        NOTHING,
        refused("input shaper"),
        CaptureBench(moved=m.shaped(x=("zv", 40.0), y=("zv", 40.0))),
    ),
    CaptureTrap(
        "shaper-2hump",
        "2HUMP_EI at 60 Hz left on, both axes",
        NOTHING,
        refused("input shaper"),
        CaptureBench(moved=m.shaped(x=("2hump_ei", 60.0), y=("2hump_ei", 60.0))),
    ),
    CaptureTrap(
        "shaper-3hump-x",
        "3HUMP_EI at 75 Hz left on, only on x",
        NOTHING,
        refused("input shaper", r"\bx\b"),
        CaptureBench(moved=m.shaped(x=("3hump_ei", 75.0))),
    ),
    CaptureTrap(
        "shaper-camera",
        "MZV at 45 Hz left on",
        A_CAMERA,
        refused("input shaper"),
        replace(CAMERA_BENCH, moved=m.shaped(x=("mzv", 45.0), y=("mzv", 45.0))),
    ),
    CaptureTrap("mesh-on", "the bed mesh left on", NOTHING, MISLED, CaptureBench(moved=m.bent(m.over_mesh))),
    CaptureTrap("skew-on", "a skew correction of 1.5° left on", NOTHING, MISLED, CaptureBench(moved=m.bent(m.skewed))),
    CaptureTrap(
        "mirrored", "two motors exchanged: x is mirrored", NOTHING, HARMLESS, CaptureBench(moved=m.bent(m.mirrored))
    ),
    CaptureTrap(
        "arm-length",
        "arms 2 % longer than configuration and file say",
        "arms 2 % longer",
        replace(HARMLESS, verdicts=("none", "unknown", "effects"), names=("arm_geometry",)),
        CaptureBench(firmware={"kinematics.arm_length_mm": 0.98}),
    ),
    CaptureTrap("other-plan", "the plan of another run", NOTHING, refused("plan|another motion"), seed_of_plan=2),
    CaptureTrap(
        "sister-file",
        "machine file of the larger sister model",
        NOTHING,
        MISLED,
        CaptureBench(file_factors=GEOMETRY | SIZE),
    ),
    CaptureTrap(
        "other-machine",
        "captures of another printer: heavier, softer belts",
        NOTHING,
        MISLED,
        CaptureBench(true_factors=SIZE, file_factors={key: 1 / value for key, value in SIZE.items()}),
    ),
    # the printer
    CaptureTrap(
        "slip-once",
        "a motor loses steps in one capture",
        NOTHING,
        replace(HARMLESS, must=("lost steps|repeat",)),
        CaptureBench(orders=(m.Slips((1.9, 2.4), 0.64),), orders_in=(1,)),
    ),
    CaptureTrap(
        "slips",
        "motors lose steps, each time at the same place",
        NOTHING,
        MISLED,
        CaptureBench(orders=(m.Slips((1.7, 2.1, 2.5), 0.32),)),
    ),
    CaptureTrap(
        "cable",
        "a cable of 100 to 250 g swings on the head",
        "a cable",
        MISLED,
        CaptureBench(outside=OUTSIDE["swinging_cable"]),
    ),
    CaptureTrap(
        "belts-warm",
        "belts soften by 15 % from the first run to the last",
        "drift",
        MISLED,
        CaptureBench(in_run=_softer),
    ),
    CaptureTrap(
        "captures-warm-up",
        "friction in every first repeat, none in the second",
        "friction that goes",
        refused("repeat"),
        CaptureBench(in_run=lambda run: FRICTION if run < 3 else {}),
    ),
    CaptureTrap(
        "play", "a motor's bracket gives way", "a bracket", MISLED, CaptureBench(outside=OUTSIDE["soft_tower"])
    ),
    # around the chip
    CaptureTrap("fan", "a fan at 83 Hz, 2 m/s²", NOTHING, HARMLESS, sensing=Sensing((m.tone(83.0, 2.0),))),
    CaptureTrap(
        "mains", "mains hum at 50 Hz, 1 m/s²", A_CAMERA, STILL_CAMERA, CAMERA_BENCH, Sensing((m.tone(50.0, 1.0),))
    ),
    CaptureTrap(
        "neighbour",
        "another printer works on the table",
        A_CAMERA,
        STILL_CAMERA,
        CAMERA_BENCH,
        Sensing((m.neighbour(1.5),)),
    ),
    CaptureTrap("bump", "somebody bumps the table once", NOTHING, HARMLESS, sensing=Sensing((m.bumped(1),))),
    CaptureTrap(
        "on-bed",
        "the chip on the bed, not on the head",
        NOTHING,
        refused("head|nozzle|loose|correlation"),
        sensing=Sensing((m.elsewhere(0.05),)),
    ),
    CaptureTrap(
        "bracket", "the chip on a bracket that rings at 95 Hz", NOTHING, MISLED, sensing=Sensing((m.on_bracket(95.0),))
    ),
    CaptureTrap("loose-chip", "the chip rattles", NOTHING, refused("loose|repeat"), sensing=Sensing((_loose(62.0),))),
    CaptureTrap(
        "two-chips",
        "two chips, of which one is loose",
        A_CAMERA,
        STILL_CAMERA,
        CAMERA_BENCH,
        Sensing(chips={CHIP: (), "hotend": (_loose(62.0),)}),
    ),
    CaptureTrap(
        "whine", "motors whine at 1640 Hz, the chip at 1600 Hz", NOTHING, MISLED, sensing=Sensing((m.whining,))
    ),
    # the chip
    CaptureTrap(
        "low-pass", "the chip's low-pass at 92 Hz is on", NOTHING, MISLED, sensing=Sensing((m.low_pass(92.0),))
    ),
    CaptureTrap("notch", "a notch at 45 Hz is on", NOTHING, MISLED, sensing=Sensing((m.notched(45.0),))),
    CaptureTrap(
        "clone",
        "a clone: x 8 % too large, y 6 % too small",
        "gains",
        replace(MISLED, verdicts=("effects", "unknown"), names=("sensor_gain",), file=None),
        sensing=Sensing((m.gains(1.08, 0.94, 1.0),)),
    ),
    CaptureTrap(
        "turned-20",
        "the chip is turned by 20° about the vertical",
        "a turn",
        replace(MISLED, verdicts=("effects", "unknown"), names=("sensor_misalignment",), file=None),
        sensing=Sensing(chip=m.turned(20.0)),
    ),
    CaptureTrap(
        "moved-chip",
        "the chip is turned by 90° between the repeats",
        NOTHING,
        refused("repeat|axes"),
        sensing=Sensing(chip=m.turned(90.0, 2)),
    ),
    CaptureTrap(
        "tilted", "the chip hangs 15° askew", A_CAMERA, STILL_CAMERA, CAMERA_BENCH, Sensing(chip=m.tilted(15.0))
    ),
    CaptureTrap("wrong-axes-map", "--axes-map of another mounting", NOTHING, refused("axes"), axes_map="x,y,z"),
    CaptureTrap("clipped", "range of ±1 g", NOTHING, refused("clipped"), sensing=Sensing(files=(m.clipped(1.0),))),
    # the files
    CaptureTrap(
        "one-in-g",
        "one capture in g",
        NOTHING,
        replace(HARMLESS, must=("unit|gravity| g\\b",)),
        sensing=Sensing(files=(m.scaled(1e-3 / 9.80665, (1,)),)),
    ),
    CaptureTrap(
        "one-doubled",
        "one capture twice too large (range misread)",
        NOTHING,
        replace(HARMLESS, must=("gravity|repeat",)),
        sensing=Sensing(files=(m.scaled(2.0, (1,)),)),
    ),
    CaptureTrap(
        "all-halved",
        "all captures half as large (range misread)",
        NOTHING,
        refused("gravity|half|range"),
        sensing=Sensing(files=(m.scaled(0.5),)),
    ),
    CaptureTrap(
        "no-gravity",
        "an app that takes gravity out",
        A_CAMERA,
        STILL_CAMERA,
        CAMERA_BENCH,
        Sensing(files=(m.by_phone(gravity=False),)),
    ),
    CaptureTrap(
        "phone-400",
        "a phone at 400 Hz",
        A_CAMERA,
        STILL_CAMERA,
        CAMERA_BENCH,
        Sensing(chip=m.at_rate(400.0), files=(m.by_phone(),)),
    ),
    CaptureTrap(
        "phone-100",
        "a phone at 100 Hz",
        A_CAMERA,
        refused("rate"),
        CAMERA_BENCH,
        Sensing(chip=m.at_rate(100.0), files=(m.by_phone(),)),
    ),
    CaptureTrap(
        "phone-jitter",
        "a phone at 400 Hz whose times jitter by ± 2 ms",
        A_CAMERA,
        refused("rate|jitter"),
        CAMERA_BENCH,
        Sensing(chip=m.at_rate(400.0), files=(m.by_phone(jitter_s=2e-3),)),
    ),
    CaptureTrap(
        "phone-ms",
        "times in ms under a header that says s",
        NOTHING,
        replace(HARMLESS, must=(r"\bms\b",)),
        sensing=Sensing(files=(m.by_phone(change=m.in_ms),)),
    ),
    CaptureTrap(
        "truncated",
        "captures cut off in the middle",
        NOTHING,
        refused("longer|cut short|runs from"),
        sensing=Sensing(files=(m.cut(share=0.6),)),
    ),
    CaptureTrap(
        "late-start",
        "captures without their first 0.9 s",
        NOTHING,
        refused("begin"),
        sensing=Sensing(files=(m.cut(from_s=-0.1),)),
    ),
    CaptureTrap(
        "three-ms",
        "the first 3 ms of every capture are missing",
        NOTHING,
        HARMLESS,
        sensing=Sensing(files=(m.cut(from_s=-0.997),)),
    ),
    CaptureTrap(
        "swapped",
        "captures of two experiments swapped",
        NOTHING,
        replace(MISLED, must=("another motion|names",)),  # a third capture is right, and may be diagnosed
        sensing=Sensing(files=(m.swapped("ffcomp-zigzag-0", "ffcomp-reversals-1"),)),
    ),
    CaptureTrap(
        "copied", "the repeats are copies of one file", NOTHING, refused("same|cop"), sensing=Sensing(files=(m.copied,))
    ),
    CaptureTrap(
        "lost-rows",
        "one row in twelve is lost",
        NOTHING,
        refused("missing|rows"),
        sensing=Sensing(files=(m.lost_rows(0.08),)),
    ),
    CaptureTrap(
        "overflows",
        "the firmware counted 12 overflows",
        NOTHING,
        refused("overflow|lost"),
        sensing=Sensing(files=(m.with_comment("##overflows=12"),)),
    ),
    CaptureTrap(
        "same-axis",
        "a script exports y in place of z",
        NOTHING,
        refused("same|correlation|axes"),
        sensing=Sensing(files=(m.twice_the_same_axis,)),
    ),
)
