"""One case of the blind test: a machine file, measured runs, fresh runs for the proof, and a label kept apart.

    case(seed, stratum)      stratum, or stratum:effect, or stratum:none, or pair:effect+effect

Strata
    nothing      no effect; file off by 0, 2 or 5 %; any sensors; any number of repeats
    single       one effect, all sensors, file off by 2 %, two repeats
    weak         the same at a thirtieth to a third of the size (half, if it is one of the file's numbers)
    pair         two effects
    outside      what no entry of the catalogue is meant for
    sensors      one effect, only some of the channels (or encoders, or a laser)
    exact-file   one effect, the file right in all numbers
    rough-file   one effect, the file off by 5 %, which it says
    few          one effect, one repeat of one motion
    nozzle       one effect, the command given as the nozzle's path
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from validation.blind.hidden import EFFECTS
from validation.blind.machines import Tables, draw_machine, file_of, toml_of
from validation.blind.motions import KINDS, Motion, Place
from validation.blind.numbers import carriages_of
from validation.blind.outside import OUTSIDE
from validation.blind.real import Reading, Real, played
from validation.blind.sensors import SENSORS, Sensors, csv_of, draw_sensors
from validation.blind.visible import Visibility, retuning, visibility, whitened

STRATA = ("nothing", "single", "weak", "pair", "outside", "sensors", "exact-file", "rough-file", "few", "nozzle")
WEAK = (0.03, 0.3)  # of the size, drawn evenly in its logarithm
RATE_HZ = 1600.0
# what must pass a file's uncertainty before it is an effect comes in weak by half; what is there or not, not at all
HALVED = ("belt_stiffness", "guide_damping", "effector_mass", "extruder_mount", "arm_geometry", "center_of_mass")
WHOLE = ("force_map",)
# two that say the same of a machine, or of a record; and what only a printer with the paper's loads can show
NEVER_TOGETHER = (
    {"coulomb_friction", "stribeck_friction"},
    {"command_delay", "sensor_time_offset"},
    {"sensor_time_offset", "sensor_clock_drift"},
    {"torque_angle", "belt_hardening"},
    {"torque_angle", "belt_backlash"},
    {"center_of_mass", "force_map"},
)


@dataclass(frozen=True)
class Circumstances:
    file_error: float  # standard deviation of the file's numbers, relative
    sensors: str
    repeats: int
    axes: str


@dataclass(frozen=True)
class Label:
    """The truth."""

    stratum: str
    seed: int
    effects: Mapping[str, Mapping[str, Any]]  # of the catalogue, as tables of a machine file
    outside: str  # "" if nothing outside the catalogue is hidden
    visibility: Mapping[str, Visibility]  # of each, the others present
    alike: tuple[str, ...]  # names that no sensor can tell from the truth, by construction
    around: Circumstances

    @property
    def visible(self) -> bool:
        return all(v.visible for v in self.visibility.values())


@dataclass(frozen=True, eq=False)
class Case:
    """`runs` and `fresh` : file name → text. The diagnosis is given `machine` and `runs`, nothing else."""

    machine: str
    runs: Mapping[str, str]
    fresh: Mapping[str, str]
    label: Label


@dataclass(frozen=True, eq=False)
class Plan:
    """What is drawn before anything is simulated."""

    file: Tables
    firmware: Tables  # the kinematics by which nozzle paths become commands
    real: Real
    without: Mapping[str, Real]  # the printer with all that is hidden but this
    plain: Real
    sensors: Sensors
    motions: tuple[Motion, ...]
    repeats: tuple[int, ...]
    fresh: tuple[Motion, ...]
    axes: str  # of the command
    label: Label


def case(seed: int, stratum: str, seconds: float = 3.0, short: bool = False) -> Case:
    """Draw, play, record. `short` : two motions only, the first four times, for tests."""
    plan = draw(seed, stratum, seconds, short)
    rng = np.random.default_rng([seed, 99])
    readings = [played(plan.real, plan.firmware, m) for m in plan.motions]
    fresh = [played(plan.real, plan.firmware, m) for m in plan.fresh]
    return Case(
        toml_of(plan.file, "the owner's printer"),
        _records(plan, plan.motions, readings, plan.repeats, rng),
        _records(plan, plan.fresh, fresh, (2, *[1] * (len(fresh) - 1)), rng),
        replace(plan.label, visibility=_seen(plan, readings)),
    )


def draw(seed: int, stratum: str, seconds: float = 3.0, short: bool = False) -> Plan:
    """Every part of a case has its own stream of random numbers: what is hidden does not change the rest."""
    kind, names = _wanted(seed, stratum)
    own = [np.random.default_rng([seed, n]) for n in range(5)]
    around = _circumstances(kind, own[0])
    machine = _machine(names, own[1])
    sizes = _sizes(kind, names, own[0])
    real, tables = _hidden(machine, seed, sizes)
    motions, fresh = _motions(machine, own[2], seconds, short)
    inside = {name: tables[name] for name in names if name in EFFECTS}
    outside = "".join(name for name in names if name in OUTSIDE)
    return Plan(
        file=file_of(machine, around.file_error, own[3]),
        firmware=machine["kinematics"],
        real=real,
        without={name: _hidden(machine, seed, {**sizes, name: 0.0})[0] for name in names},
        plain=_hidden(machine, seed, dict.fromkeys(names, 0.0))[0],
        sensors=draw_sensors(own[4], around.sensors, RATE_HZ),
        motions=motions,
        repeats=(4, 1) if short else _repeats(kind, around, motions),
        fresh=fresh,
        axes=around.axes,
        label=Label(kind, seed, inside, outside, {}, _alike(inside, around.sensors), around),
    )


def _machine(names: Sequence[str], rng: np.random.Generator) -> Tables:
    machine = draw_machine(rng)
    if "center_of_mass" in names or ("force_map" in names and rng.random() < 0.5):
        machine["effector"]["force_map"] = "paper"
    return machine


def _sizes(kind: str, names: Sequence[str], rng: np.random.Generator) -> dict[str, float]:
    if kind != "weak":
        return dict.fromkeys(names, 1.0)
    size = float(np.exp(rng.uniform(*np.log(WEAK))))
    return {name: 1.0 if name in WHOLE else 0.5 if name in HALVED else size for name in names}


def _repeats(kind: str, around: Circumstances, motions: Sequence[Motion]) -> tuple[int, ...]:
    if kind == "few":
        return (2, *[1] * (len(motions) - 1))
    often = [m.name.endswith("centre") or m.name.startswith("infill") for m in motions]
    return tuple(around.repeats if repeated else 1 for repeated in often)


def _wanted(seed: int, stratum: str) -> tuple[str, tuple[str, ...]]:
    """The stratum and what is hidden: as asked for, or drawn."""
    kind, _, asked = stratum.partition(":")
    if kind not in STRATA:
        raise ValueError(f"There is no stratum {kind!r}; the strata are {', '.join(STRATA)}.")
    if asked:
        return kind, () if asked == "none" else tuple(asked.split("+"))
    rng = np.random.default_rng([seed, 7])
    if kind == "nothing":
        return kind, ()
    if kind == "outside":
        return kind, (str(rng.choice(list(OUTSIDE))),)
    if kind != "pair":
        return kind, (str(rng.choice(list(EFFECTS))),)
    while True:
        pair = tuple(str(x) for x in rng.choice(list(EFFECTS), 2, replace=False))
        if not any(set(pair) <= both for both in NEVER_TOGETHER):
            return kind, pair


def _circumstances(kind: str, rng: np.random.Generator) -> Circumstances:
    usual = Circumstances(0.02, "all", 2, "ABC")
    if kind == "nothing":
        error, repeats = float(rng.choice([0.0, 0.02, 0.05])), int(rng.integers(2, 4))
        sensors = str(rng.choice(["all", "all", "carriages", "effector", "encoders"]))
        return Circumstances(error, sensors, repeats, "ABC")
    if kind == "sensors":
        return replace(usual, sensors=str(rng.choice(["carriages", "effector", "two", "encoders", "laser"])))
    changes: dict[str, Any] = {
        "exact-file": {"file_error": 0.0},
        "rough-file": {"file_error": 0.05},
        "nozzle": {"axes": "xyz"},
    }
    return replace(usual, **changes.get(kind, {}))


def _hidden(machine: Tables, seed: int, sizes: Mapping[str, float]) -> tuple[Real, dict[str, dict[str, Any]]]:
    """The printer with each effect at its size; an effect's own draws do not depend on any size."""
    real, tables = Real(machine), {}
    for name, size in sizes.items():
        rng = np.random.default_rng([seed, zlib.crc32(name.encode())])
        tables[name], real = {**EFFECTS, **OUTSIDE}[name](rng, size, real)
    return real, tables


def _alike(tables: Mapping[str, Mapping[str, Any]], sensors: str) -> tuple[str, ...]:
    """All motors late is the same to accelerometers as all accelerometers late; an encoder knows."""
    if any(channel.startswith("pos") for channel in SENSORS[sensors]):
        return ()
    if not isinstance(tables.get("command_delay", {"delay_s": []})["delay_s"], list):
        return ("sensor_time_offset",)
    return ("command_delay",) if tables.get("sensor_time_offset", {"offset_s": 0.0})["offset_s"] > 0 else ()


def _motions(
    machine: Tables, rng: np.random.Generator, seconds: float, short: bool
) -> tuple[tuple[Motion, ...], tuple[Motion, ...]]:
    """What is measured, and what will be measured afterwards at other places."""
    reach = 0.62 * machine["kinematics"]["print_radius_mm"]
    turn = rng.uniform(0, 2 * np.pi)
    places: list[Place] = [(0.0, 0.0, 30.0)]
    for n in range(5):
        angle = turn + 2 * np.pi * n / 5 + rng.uniform(-0.3, 0.3)
        height = rng.uniform(15, 60) if n % 2 == 0 else rng.uniform(90, 160)
        places.append((reach * np.cos(angle), reach * np.sin(angle), height))

    def motion(kind: str, where: int, name: str, loudness: float = 1.0) -> Motion:
        return Motion(f"{kind}-{name}", KINDS[kind](rng, places[where], seconds, loudness), seconds)

    measured = [
        motion("multisine", 0, "centre"),
        motion("multisine", 0, "loud", 2.5),
        motion("multisine", 1, "left", 1.4),
        motion("infill", 2, "high"),
        motion("slow", 3, "back"),
        motion("steps", 3, "back"),
        motion("turns", 4, "up"),
    ]
    fresh = [motion("multisine", 5, "fresh", 1.2), motion("infill", 5, "fresh")]
    if short:
        measured = [measured[0], measured[2]]
        fresh = fresh[:1]
    return tuple(measured), tuple(fresh)


def _records(
    plan: Plan, motions: Sequence[Motion], readings: Sequence[Reading], repeats: Sequence[int], rng: np.random.Generator
) -> dict[str, str]:
    """CSV texts by file name; repeats are numbered."""
    found = {}
    for motion, reading, count in zip(motions, readings, repeats, strict=True):
        times = reading.t[:: round(1 / (RATE_HZ * (reading.t[1] - reading.t[0])))]
        path = motion.path(times)
        command = path if plan.axes == "xyz" else carriages_of(plan.firmware, path)
        for n in range(count):
            name = f"{motion.name}-{n + 1}.csv" if count > 1 else f"{motion.name}.csv"
            found[name] = csv_of(times, command, plan.axes, plan.sensors.record(reading, rng))
    return found


def _seen(plan: Plan, readings: Sequence[Reading]) -> dict[str, Visibility]:
    """What can be seen of each hidden thing."""
    if not plan.without:
        return {}
    spread = max(plan.label.around.file_error, 0.02)
    n = retuning(plan.plain, plan.firmware, plan.motions, plan.sensors, plan.repeats, spread)
    true = whitened(plan.sensors, readings, plan.repeats)
    others = {name: [played(real, plan.firmware, m) for m in plan.motions] for name, real in plan.without.items()}
    return {name: visibility(true - whitened(plan.sensors, o, plan.repeats), n) for name, o in others.items()}
