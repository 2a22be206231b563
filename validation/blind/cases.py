"""One case of the blind bank: a machine file, measured runs, and a label kept apart.

    case(seed, "corexy/single/rough-file:cogging")      MACHINE/WHAT/CONDITION:NAME+NAME, or none in place of names

Machines: those of `kinds`. What: `nothing`, `single`, `pair`, or `outside`, which no entry of the catalogue is meant
for. Conditions:

    usual        all sensors of the machine, file off by 2 %, two repeats
    rough-file   the file off by 5 %, which it says
    joined       captures of one accelerometer, joined with their plan (`captures`): noise, clock, tilt, lost rows
    free-damping the damping is anywhere between belts and guides, and the file does not state where
    rest         something outside the catalogue in addition, worth 5 to 20 %
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from ffcomp.record.result import DELAY_SD_S
from validation.blind.captures import joined_runs, planned_motions
from validation.blind.kinds import KINDS, Kind
from validation.blind.motions import Motion
from validation.blind.real import FloatArray, Reading, Real, Tables, combined, read_at, toml_of
from validation.blind.sensors import SENSORS, Sensors, commands_of, csv_of, draw_sensors
from validation.blind.visible import PROBE, Visibility, visibility_by_refit, whitened

FILE_ERROR, ROUGH_FILE_ERROR = 0.02, 0.05  # standard deviation of numbers, relative
REST = (0.05, 0.2)  # of what all that is hidden is worth when the file's numbers are refitted
LARGEST_REST = 1.5  # times its usual size
RESTS = """
    off_centre_pulley warming_belt swinging_cable fans_tone notched_wheel creeping_belt heavy_rotor one_sided_belt
    warming_motor commutation bent_rail unbalanced_spindle
"""  # those that may be of any size
RATE_HZ = 1600.0
# pairs that do the same to a machine or to a record, and a pair that only a printer with the paper's loads can show
NEVER_TOGETHER = (
    {"coulomb_friction", "stribeck_friction"},
    {"coulomb_friction", "bristle_friction"},
    {"stribeck_friction", "bristle_friction"},
    {"command_delay", "sensor_time_offset"},
    {"sensor_time_offset", "sensor_clock_drift"},
    {"torque_angle", "belt_hardening"},
    {"torque_angle", "belt_backlash"},
    {"center_of_mass", "force_map"},
    {"gantry_racking", "toolhead_mode"},
    {"belt_damping", "guide_damping"},
)


@dataclass(frozen=True)
class Label:
    """The truth."""

    machine: str  # of kinds.KINDS
    hides: str  # nothing, single, pair, outside
    condition: str
    seed: int
    effects: Mapping[str, Mapping[str, Any]]  # of the catalogue, as tables of a machine file
    outside: str  # "" if nothing outside the catalogue is hidden
    visibility: Mapping[str, Visibility]  # of each, the others present
    alike: tuple[str, ...]  # names that no sensor can distinguish from the truth, by construction
    # true as well, and need not be named: damping in the belts
    also: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    rest: Mapping[str, float] = field(default_factory=dict)  # outside the catalogue, and its share

    @property
    def stratum(self) -> str:
        """Machine, hidden things, and condition."""
        return f"{self.machine}/{self.hides}/{self.condition}"

    @property
    def visible(self) -> bool:
        """Whether all that is hidden can be seen."""
        return all(v.visible for v in self.visibility.values())


@dataclass(frozen=True, eq=False)
class Case:
    """`runs` : file name → text. The diagnosis is given `machine` and `runs`, nothing else."""

    machine: str
    runs: Mapping[str, str]
    label: Label


@dataclass(frozen=True, eq=False)
class Plan:
    """A case before anything is simulated."""

    kind: Kind
    file: Tables
    firmware: Tables  # kinematics that turn nozzle paths into commands
    real: Real
    without: Mapping[str, Real]  # the printer with all that is hidden but this
    plain: Real
    sensors: Sensors
    spreads: tuple[float, ...]  # of the numbers of the file, as `kind.probes` has them
    motions: tuple[Motion, ...]
    repeats: tuple[int, ...]
    label: Label

    @property
    def text(self) -> str:
        """The machine file's text."""
        return toml_of(self.file, "the owner's printer")

    def judged(self, real: Real, readings: Sequence[Reading]) -> list[Reading]:
        """Return what another printer would have read, in the form that is compared."""
        if self.kind.replayed is None:
            return self.readings(real, self.motions)
        return [self.kind.replayed(real, reading) for reading in readings]

    def readings(self, real: Real, motions: Sequence[Motion]) -> list[Reading]:
        """Play motions on a printer."""
        return [self.kind.played(real, self.firmware, motion) for motion in motions]


def case(seed: int, stratum: str, seconds: float) -> Case:
    """Draw, play, record."""
    plan = draw(seed, stratum, seconds)
    rng = np.random.default_rng([seed, 99])
    readings = plan.readings(plan.real, plan.motions)
    if plan.label.condition == "joined":
        runs = joined_runs(plan.text, readings, seed, rng, seconds)
    else:
        runs = _records(plan, readings, rng)
    return Case(plan.text, runs, replace(plan.label, visibility=_seen(plan, readings)))


def draw(seed: int, stratum: str, seconds: float) -> Plan:
    """Every part of a case has its own stream of random numbers: a hidden effect does not change the rest."""
    told, _, hidden = stratum.partition(":")
    of, hides, condition = told.split("/")
    kind, names = KINDS[of], () if hides == "nothing" else tuple(hidden.split("+"))
    own = [np.random.default_rng([seed, n]) for n in range(6)]
    drawn = machine = kind.draw(own[1], names)
    also: Tables = {}
    free = condition == "free-damping" and "belt_damping" not in names
    if free:
        assert kind.damped is not None
        machine, table = kind.damped(drawn, float(np.clip(own[5].uniform(-0.15, 1.15), 0.0, 1.0)))
        also = {"belt_damping": table} if table else {}
    error, sensors = ROUGH_FILE_ERROR if condition == "rough-file" else FILE_ERROR, machine.get("sensors", kind.sensors)
    sizes = dict.fromkeys(names, 1.0)
    real, tables = _hidden(kind, machine, seed, sizes)
    file = kind.file_of(drawn, error, own[3])
    if free and kind.unknown:
        file["uncertainty"] = {**file.get("uncertainty", {}), **dict.fromkeys(kind.unknown, 1.0)}
    motions = kind.motions(machine, own[2], seconds)
    repeats = _repeats(kind, motions)
    if condition == "joined":
        motions, repeats = planned_motions(toml_of(file, "the owner's printer"), seed, seconds)
    inside = kind.restated({name: tables[name] for name in names if name in kind.effects}, real.machine, file)
    outside = "".join(name for name in names if name in kind.outside)
    alike = _alike(inside, sensors)
    plan = Plan(
        kind=kind,
        file=file,
        firmware=machine["kinematics"],
        real=real,
        without={name: _hidden(kind, machine, seed, {**sizes, name: 0.0})[0] for name in names},
        plain=_hidden(kind, machine, seed, dict.fromkeys(names, 0.0))[0],
        sensors=draw_sensors(own[4], sensors, RATE_HZ),
        spreads=_spreads(kind, machine, file, error),
        motions=motions,
        repeats=repeats,
        label=Label(of, hides, condition, seed, inside, outside, {}, alike, also),
    )
    return plan if condition != "rest" else _with_rest(plan, own[5], seed)


def _repeats(kind: Kind, motions: Sequence[Motion]) -> tuple[int, ...]:
    often = [m.name.endswith("centre") or m.name.startswith("infill") for m in motions]
    return tuple(kind.repeats if repeated else 1 for repeated in often)


def _hidden(
    kind: Kind, machine: Tables, seed: int, sizes: Mapping[str, float]
) -> tuple[Real, dict[str, dict[str, Any]]]:
    """Return the printer with each effect at its size; an effect's own draws do not depend on any size."""
    real, tables = Real(machine), {}
    for name, size in sizes.items():
        rng = np.random.default_rng([seed, zlib.crc32(name.encode())])
        tables[name], real = {**kind.effects, **kind.outside}[name](rng, size, real)
    return real, tables


def _alike(tables: Mapping[str, Mapping[str, Any]], sensors: str) -> tuple[str, ...]:
    """All motors late is the same to accelerometers as all accelerometers late; an encoder knows."""
    if any(channel.startswith("pos") for channel in SENSORS[sensors]):
        return ()
    if not isinstance(tables.get("command_delay", {"delay_s": []})["delay_s"], list):
        return ("sensor_time_offset",)
    return ("command_delay",) if tables.get("sensor_time_offset", {"offset_s": 0.0})["offset_s"] > 0 else ()


def _records(plan: Plan, readings: Sequence[Reading], rng: np.random.Generator) -> dict[str, str]:
    """CSV texts by file name; repeats are numbered."""
    found, axes = {}, plan.kind.axes
    for motion, reading, count in zip(plan.motions, readings, plan.repeats, strict=True):
        times = reading.t[:: round(1 / (RATE_HZ * (reading.t[1] - reading.t[0])))]
        if plan.kind.force is None:
            given = commands_of(plan.kind.command(plan.firmware, motion.path(times), axes), axes)
        for n in range(count):
            name = f"{motion.name}-{n + 1}.csv" if count > 1 else f"{motion.name}.csv"
            if plan.kind.force is not None:
                given = plan.kind.force(plan.real.machine, times, reading, rng)
            found[name] = csv_of(times, given, plan.kind.columns(plan.real.machine, plan.sensors.record(reading, rng)))
    return found


def _spreads(kind: Kind, machine: Tables, file: Tables, usual: float) -> tuple[float, ...]:
    """Return the standard deviation of each number that is probed, as a share of what it really is."""
    spreads = [usual for _ in kind.probes(machine, PROBE)]
    for key, at in kind.unknown.items():
        table, _, name = key.partition(".")
        if key in file.get("uncertainty", {}):
            spreads[at] = file[table][name] / machine[table][name]
    return tuple(spreads)


def _with_rest(plan: Plan, rng: np.random.Generator, seed: int) -> Plan:
    """Hide something else in addition: the first of some that can be worth its share, by the first two motions."""
    wanted, found = rng.uniform(*REST), plan
    for name in map(str, rng.permutation([each for each in plan.kind.outside if each in RESTS.split()])):
        size = 1.0
        for _ in range(3):
            found, share = _beside(plan, name, size, seed)
            if share <= 0.0 or abs(share - wanted) < 0.1 * wanted:
                break
            size *= float(np.sqrt(wanted / (1 - wanted) * (1 - share) / share))
            size = min(max(size, 1e-3), LARGEST_REST)
        if REST[0] <= share <= REST[1]:
            break
    return found


def _beside(plan: Plan, name: str, size: float, seed: int) -> tuple[Plan, float]:
    """Hide something else in addition, and return its share of all that is hidden."""

    def beside(real: Real) -> Real:
        return plan.kind.outside[name](np.random.default_rng([seed, zlib.crc32(name.encode())]), size, real)[1]

    without = {each: beside(real) for each, real in plan.without.items()}
    found = replace(plan, real=beside(plan.real), without=without)
    short = replace(found, motions=plan.motions[:2], repeats=plan.repeats[:2], without={**without, "": plan.real})
    *effects, rest = (each.left for each in _seen(short, short.readings(short.real, short.motions)).values())
    share = rest / (sum(effects) + rest)
    return replace(found, label=replace(plan.label, rest={name: share})), share


def _seen(plan: Plan, readings: Sequence[Reading]) -> dict[str, Visibility]:
    """Return what can be seen of each hidden thing."""
    if not plan.without:
        return {}
    machines = (plan.plain.machine, *plan.kind.probes(plan.plain.machine, PROBE))
    plain, *probed = (plan.judged(Real(each, readers=plan.plain.readers), readings) for each in machines)
    spreads, clocks = plan.spreads, 0
    if plan.label.condition == "joined":  # the clock of each motion is in doubt
        clocks = len(plain)
        probed += [_late(plain, PROBE * one) for one in np.eye(clocks)]
        spreads += (1.0,) * clocks
    told = partial(whitened, plan.sensors, repeats=plan.repeats)
    n = np.column_stack([(told(each) - told(plain)) / PROBE for each in probed]) * spreads
    own = readings if plan.kind.replayed is None else [plan.kind.replayed(None, reading) for reading in readings]

    def moved(real: Real, z: FloatArray) -> FloatArray:
        """Return the data of a printer whose numbers are off by so many standard deviations, at most by half."""
        numbers = len(z) - clocks
        off = np.clip(z[:numbers] * plan.spreads, -0.5, 0.5) / PROBE
        machine = combined(real.machine, list(plan.kind.probes(real.machine, PROBE)), off.tolist())
        found = plan.judged(replace(real, machine=machine), readings)
        return told(_late(found, z[numbers:]) if clocks else found)

    others = {name: told(plan.judged(real, readings)) for name, real in plan.without.items()}
    return {
        name: visibility_by_refit(told(own), o, n, partial(moved, plan.without[name])) for name, o in others.items()
    }


def _late(readings: Sequence[Reading], by: FloatArray) -> list[Reading]:
    """Return readings whose accelerometers are late by so many standard deviations of a clock."""
    return [read_at(r, r.t - DELAY_SD_S["firmware"] * z) for r, z in zip(readings, by, strict=True)]
