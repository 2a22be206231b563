"""The output-error fit of a page: the machine's numbers, and what guides and bead do to its motion.

    minimise  Σ ((y − ŷ(θ, β) − B c) / σ)²  +  the prior's part

y is a stroke's distance from the slow line next to it, ŷ that of the simulated nozzle's bead. The bead is pulled after
the nozzle as on a string (drag), rounded over a width, and conserves volume: an axis that rings along the line slows
the nozzle down there, and the bead, seen between its edges, is up to three times as wide and hides the waves. With one
width everywhere ŷ was off by half the waves in the first 3 mm of drawn lines, and frequencies by up to 2 %. B c takes
out what each line's place on the page leaves open: an offset, a slope, a bow, and a small shift along it. θ are
logarithms of the machine's numbers. β are nuisance parameters, the dry friction of each guide among them, which makes
small waves die sooner and ring quicker: without it, dampings came out 8 to 30 % high on drawn deltas. How much an axis
rings is free by a tenth: a second mode, which moves against the first one, makes it ring more. On straight axes, whose
files seldom name that mode, more is expected: taken for equal, frequencies near 65 Hz came out 1.5 % high. Where one
rings more by a tenth or more, the mode itself is fitted, whether or not its own short waves show through the bead:
without it, dampings came out 14 to 28 % low. It is written only where the page tells its frequency.

The fit starts at each frequency of an axis that rings about as much alike as its best one, and the evidence decides. σ²
is a line's roughness, by the residual of its calm half, and the model's own error in proportion to the waves around,
times how many neighbours err alike (effective sample size). Where the machine leaves much of an axis' waves
unexplained, rings and speeds are free altogether, which shows input shapers and speed factors. Covariances are at least
as wide as by leaving out strokes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.signal import lfilter

from ffcomp.errors import MeasurementError
from ffcomp.identification.page.lines import STEP_MM, ReadLine
from ffcomp.identification.uncertainty import Estimate, Mode, Number, estimates, lognormal, normal
from ffcomp.inference.fit import FitResult, FitSettings, fit
from ffcomp.inference.problem import EstimationProblem, Observation, Unknown, model_error
from ffcomp.numerics.stages import Stage
from ffcomp.record.page import RINGING
from ffcomp.record.plan import Experiment, Motion
from models.arrays import FloatArray
from models.compiled import kernel
from models.effects.catalogue import key_in_file
from models.machine import Machine, value_of, with_values
from models.printer.parameters import ConvertedPrinter, converted_printer
from models.printer.printer import Splines, played, simulate_printers
from models.vibration.modal import ModalAxes, Oscillator

RATE_HZ = 3200.0
LEAD_S, SETTLED_S = 0.02, 0.05  # of rest before a motion; after it
SCALE = "effector.nozzle_mass_kg"  # a picture tells ratios of masses only: one stays as it is
LEAST_SD, MOST_SD = 0.08, 0.5  # of a prior, relative
FARTHEST, DIFFERENCE = 4.0, 0.05  # of a prior, standard deviations: its bounds; a step of differences
FACTORS = np.exp(np.arange(-0.48, 0.481, 0.03))  # on all frequencies, where to begin
RIVAL = 0.3  # of the best likeness: another maximum as high is a start too
LEAST_ROUGH_MM = 2e-3  # of a place of a line, standard deviation
FRICTION = ("friction_a", "friction_b", "friction_c")  # of the guides, N; of axes without masses, m/s²
FRICTION_SD, LEAST_FRICTION = 2.0, 1e-3  # in units of it: without any, bristles would not be limited
# by which contacts bend before they slide; of straight axes, which differ more than towers, one each
PRESLIDING, OWN_PRESLIDING = "presliding_mm", ("presliding_a_mm", "presliding_b_mm", "presliding_c_mm")
PRESLIDING_MM = (0.003, 1.0)
# middle, sd (of the logarithm); pressure: by which the flow lags behind the extruder
BEAD = {"drag_mm": (0.2, 0.5), "rounding_mm": (0.12, 0.5), "shift_mm": (0.0, 0.015), "pressure_s": (0.006, 0.7)}
# of a print; 1: as planned. Speeds in the lines' directions; how much of what the zigzags excite rings along x, y: more
# than 1 where a quicker mode moves against the one that rings, less with an input shaper
PLANNED = {"speed": (1.0, 0.0), "ring_x": (1.0, 0.1), "ring_y": (1.0, 0.1)}
SECOND = {"ring_x": (1.1, 0.15), "ring_y": (1.1, 0.15)}  # of straight axes, which often have a mode that no file names
# of such a mode, where an axis rings more by a tenth: its frequency over the first one's, where it is sought; ring next
# to it, damping ratio, standard deviations of the logarithms of frequency and share
STRONG, QUICKER = 0.1, (1.5, 1.9, 2.4)
SAME, SECOND_DAMPING, SECOND_HZ_SD, SHARE_SD = (1.0, 0.05), (0.07, 0.5), 0.2, 0.5
TOLD = 0.1  # of the logarithm of its frequency: a mode that is less sure moves the first one, and is not written
OVERRIDDEN = {"speed": (1.0, 0.2), "ring_x": (1.0, 1.0), "ring_y": (1.0, 1.0)}
SPEEDS, TRIED = (0.7, 0.8, 0.9, 1.0, 1.1, 1.25, 1.4), 2  # of an override, where to begin; how many of them
SAME_SPEED, SAME_RING = 0.04, 0.85  # of the logarithm: less is no override; a shaper leaves less than this share
RADIUS = (0.53, 0.2)  # of a line, in its widths on the page: a first layer is squeezed
LINE_SHIFT_MM = 0.04  # sd of a line's own place along it
FINE_MM = 0.025
EARLIEST_MM, BEFORE = 0.1, 64  # of a line; steps before it: where the bead begins to be simulated
WIDTHS = (0.3, 3.0)  # of a bead over the line's: thinner, it breaks
LEAST_GAIN = 60.0  # of χ² by the waves, correlated roughness allowed for
# of the waves' power that neither the machine explains nor the roughness of lines
DOUBTFUL, MOST_UNEXPLAINED = 0.1, 0.4
WORST_HELD = 0.5  # posterior over prior: a picture hardly tells a number that it leaves so wide
LOCAL_MM = 1.5  # over which the waves of a line are averaged
BEGIN, FINISH = FitSettings(steps=6, gain=1.0), FitSettings(steps=10, rounds=5, gain=0.3)
SOUGHT = FitSettings(steps=20, gain=1.0)  # of a second mode, from each start: unfinished fits do not compare
TOWERS = 0.007  # of the logarithm of a frequency at one place: towers that differ by 2 %, and are fitted as one
FLOOR, DAMPING_FLOOR = 0.004, 0.1  # of the logarithms: towers that differ
MASS_FLOOR = 0.12  # of a carriage's: it shows along z, which lines hardly do, and is up to a fifth off
FRICTION_LAW = 0.25  # of friction's part in what looks like damping: no law of it is better known


@dataclass(frozen=True, slots=True)
class PlaceModes:
    """The modes at a place."""

    position_mm: tuple[float, float]
    modes: Sequence[Mode]


@dataclass(frozen=True, eq=False)
class PageFit:
    """The machine's numbers and the lines that they were fitted to."""

    machine: Machine
    estimates: Mapping[str, Estimate]  # of the machine file's numbers
    kept: Sequence[str]  # numbers that the picture hardly tells
    places: Sequence[PlaceModes]
    bead: Mapping[str, Estimate]
    second: Sequence[str]  # straight axes whose second mode, which the file lacks, is written
    doubts: Sequence[str]  # about how the fit ended
    explained: float  # share of the waves' power beyond roughness, of the worse direction
    rough_mm: float  # standard deviation of the typical line's places
    lines: Sequence[ReadLine]
    seen: Sequence[FloatArray]  # of each line, mm: without what its place leaves open
    fitted: Sequence[FloatArray]

    @property
    def count(self) -> int:
        """How many lines were read."""
        return len(self.lines)

    @property
    def friction(self) -> dict[str, Any]:
        """Return the guides' dry friction as a machine file has it; nothing where the page does not show any."""
        forces = [self.bead.get(name, normal(0.0, 0.0)) for name in FRICTION]
        if not any(each.low > 0.0 for each in forces):
            return {}
        bends = min((e for n, e in self.bead.items() if "presliding" in n), key=lambda e: e.relative_sd)
        sizes = [float(f"{each.value:.3g}") if each.low > 0.0 else 0.0 for each in forces]
        key = key_in_file("coulomb_friction", "force_n", self.machine.vibration.quantities)
        return {key: sizes, PRESLIDING: float(f"{bends.value:.3g}")}


def _unknown(number: Number) -> Unknown:
    """Return a number as a fit moves it."""
    low = LEAST_FRICTION if number.name in FRICTION else -FARTHEST * number.sd
    return number.unknown(DIFFERENCE * number.sd, low, FARTHEST * number.sd)


class _Page(EstimationProblem):
    """Lines, the commands that drew them, and what a machine would have drawn."""

    def __init__(
        self,
        machine: Machine,
        lines: Sequence[ReadLine],
        width_mm: float,
        second: Mapping[str, tuple[float, float]] | None = None,
        conditions: Mapping[str, tuple[float, float]] | None = None,
    ) -> None:
        self.file, self.lines, self.width_mm, self.second = machine, lines, width_mm, second or {}
        self.machine = with_second_modes(machine, self.second)
        self.across = [_axis(line) for line in lines]
        names = [line.stroke.name for line in lines]
        self.copies = [names.count(name) for name in names]  # pictures of a stroke share its roughness
        strokes = {line.stroke.name: line.stroke for line in lines}
        self.which = [list(strokes).index(line.stroke.name) for line in lines]
        self.commands, self.extruded = [], list[FloatArray]()
        for stroke in strokes.values():
            t = np.arange(-LEAD_S, stroke.duration_s + SETTLED_S, 1 / RATE_HZ)
            self.commands.append(np.ascontiguousarray(machine.kinematics.inverse(stroke.motion.nozzle(t))))
            self.extruded.append(_extruded(stroke.motion, t))
        of_machine = machine_unknowns(machine)
        self.of_machine = len(of_machine)
        towers = machine.vibration.position_dependent
        nuisances = dict.fromkeys(FRICTION[: 3 if towers else 2], (0.0, FRICTION_SD))
        nuisances |= dict.fromkeys([PRESLIDING] if towers else OWN_PRESLIDING[:2], PRESLIDING_MM) | BEAD
        nuisances |= conditions or PLANNED | ({} if towers else SECOND)
        nuisances |= {"radius_mm": (RADIUS[0] * width_mm, RADIUS[1])}
        for axis, (first, share) in self.second.items():
            nuisances |= dict(
                zip(_second(axis), [(first, SECOND_HZ_SD), SECOND_DAMPING, (share, SHARE_SD)], strict=True)
            )
            nuisances[f"ring_{axis}"] = SAME
        self.numbers = [*of_machine, *(Number(n, m, sd, not m) for n, (m, sd) in nuisances.items() if sd)]
        self.unknowns = list(map(_unknown, self.numbers))
        self.moves = np.array(
            ["." in n.name or n.name.startswith(("friction", "presliding", "second")) for n in self.numbers]
        )
        self.splines = Splines()
        self.elsewhere: dict[str, float] = {}  # variance of a number's logarithm by other optima that fit about as well
        self.weigh([_without_bow(line.across_mm) for line in lines])

    def weigh(self, left: Sequence[FloatArray]) -> None:
        """Take each line's roughness, and how many places are alike, from its calm half's residual, (n,) mm."""
        powers = map(_power, self.lines)
        parts = [each[power <= np.median(power)] for power, each in zip(powers, left, strict=True)]
        rough = [max(float(np.sqrt(np.mean(part**2))), LEAST_ROUGH_MM) for part in parts]
        self.observations = [_observed(line, each) for line, each in zip(self.lines, rough, strict=True)]
        self.rows_alike = np.full(len(parts), np.mean([_rows_alike(part) for part in parts]))

    def values(self, x: FloatArray) -> dict[str, float]:
        return {"speed": 1.0} | {each.name: each.value(float(at)) for each, at in zip(self.numbers, x, strict=True)}

    def near(self, found: FitResult[_Page]) -> FloatArray:
        """Return the point (p,) with the numbers of another page's fit."""
        values = found.problem.values(found.values)
        new = {f"ring_{axis}" for axis in self.second.keys() - found.problem.second.keys()}
        known = [each if each.name in values and each.name not in new else None for each in self.numbers]
        return np.clip([each.at(values[each.name]) if each else 0.0 for each in known], *self.limits)

    def index(self, name: str) -> int:
        return [each.name for each in self.numbers].index(name)

    def machine_at(self, x: FloatArray, axes: Sequence[str] = "xy") -> Machine:
        """Return the machine at x; second modes that no file names only of some axes."""
        values, second = self.values(x), {axis: self.second[axis] for axis in axes if axis in self.second}
        machine = with_second_modes(self.file, second)
        numbers = {k: v for k, v in values.items() if k in machine.vibration.tunable}
        for axis in second:
            share = values[_second(axis)[-1]]
            numbers |= {f"axes.{axis}.share[0]": 1.0 + share, f"axes.{axis}.share[1]": -share}
        return with_values(machine, numbers)

    def rubbing(self, x: FloatArray) -> ConvertedPrinter:
        """Return the machine at x with dry friction, as the simulation takes it."""
        values = self.values(x)
        bend = [values.get(name, values.get(PRESLIDING, PRESLIDING_MM[0])) for name in OWN_PRESLIDING]
        friction = {"force_n": [values.get(name, 0.0) for name in FRICTION], PRESLIDING: bend}
        effects = {**self.machine.effects, "coulomb_friction": friction}
        return converted_printer(replace(self.machine_at(x), effects=effects), gravity=False)

    def drawn(self, lanes: Sequence[FloatArray]) -> Iterator[list[FloatArray]]:
        """Simulate each of several points (p,): the lines as they would be drawn, (n,) mm each."""
        count = len(self.commands)
        moved = [x[self.moves].tobytes() for x in lanes]
        first = dict(zip(moved, lanes, strict=True))  # the bead alone moves nothing
        printers = [printer for x in first.values() for printer in [self.rubbing(x)] * count]
        commands = self.commands * len(first)
        motions = simulate_printers(printers, commands, 1 / RATE_HZ, substeps=1, splines=self.splines)
        paths: dict[bytes, list[FloatArray]] = {key: [] for key in first}
        for i, motion in enumerate(motions):
            paths[list(first)[i // count]].append(played(motion).nozzle_mm[:, :2])
        for x, key in zip(lanes, moved, strict=True):
            bead = self.values(x)
            yield [
                _laid(line, paths[key][k], self.extruded[k], bead)
                for line, k in zip(self.lines, self.which, strict=True)
            ]

    def simulate(self, lanes: Sequence[FloatArray]) -> Iterator[FloatArray]:
        """Simulate each of several points (p,): all places of all lines, (rows,) mm."""
        return map(np.concatenate, self.drawn(lanes))

    def whitened(self, simulated: FloatArray, sd: FloatArray) -> FloatArray:
        """Return the residual (rows,) in standard deviations, without what each line's place leaves open."""
        parts = (np.split(each, self.ends[:-1]) for each in (self.measured, simulated, sd))
        return np.concatenate([(y - drawn - _open(y, drawn, s)) / s for y, drawn, s in zip(*parts, strict=True)])

    def deviations(self, errors: FloatArray) -> FloatArray:
        """Return the standard deviation of each place, (rows,) mm: neighbours that err alike count as one."""
        rows = np.repeat(self.rows_alike * self.copies, np.diff(self.ends, prepend=0))
        return super().deviations(errors) * np.sqrt(rows)

    def errors_of(self, residual: FloatArray, together: bool = False) -> FloatArray:
        """Estimate the model's error along each axis, and each line's roughness, from what a fit leaves."""
        parts, errors = np.split(residual, self.ends[:-1]), np.zeros(len(self.lines))
        self.weigh(parts)
        for axis in set(self.across):
            own = [i for i, across in enumerate(self.across) if across == axis]
            noise, size = (
                np.concatenate([getattr(self.observations[i], key) for i in own]) for key in ("noise", "size")
            )
            errors[own] = model_error(np.concatenate([parts[i] for i in own]) ** 2, noise, size, len(self.numbers))
        return errors


def _observed(line: ReadLine, rough_mm: float) -> Observation:
    """Return a line as an observation, rough by so much; the model errs in proportion to the waves around."""
    n = len(line.s_mm)
    return Observation(
        line.across_mm, np.full(n, rough_mm**2), _power(line), np.zeros(n, dtype=np.int64), line.stroke.name
    )


def _power(line: ReadLine) -> FloatArray:
    """Return the mean square of the waves around each place, (n,) mm²."""
    return np.asarray(gaussian_filter1d(_without_bow(line.across_mm) ** 2, LOCAL_MM / STEP_MM))


def _axis(line: ReadLine) -> str:
    """Name the axis that rings across a line."""
    return "x" if abs(line.line.across[0]) > abs(line.line.across[1]) else "y"


def _open(seen: FloatArray, drawn: FloatArray, sd: FloatArray) -> FloatArray:
    """Return the error of the line's own place, (n,) mm: of lines (n,) mm as seen and as drawn."""
    u = np.linspace(-1, 1, len(seen))
    basis = np.column_stack(
        [np.ones(len(u)), u, u**2 - 1 / 3, u**3 - 0.6 * u, LINE_SHIFT_MM * np.gradient(drawn, STEP_MM)]
    )
    weighted = basis / sd[:, None] ** 2
    ridge = np.diag([0.0, 0.0, 0.0, 0.0, 1.0]) + 1e-9 * np.eye(5)
    return np.asarray(basis @ np.linalg.solve(weighted.T @ basis + ridge, weighted.T @ (seen - drawn)))


def _rows_alike(left: FloatArray) -> float:
    """Return over how many places a residual (n,) is alike: the sum of its correlations up to their first zero."""
    spectrum = np.abs(np.fft.rfft(left, 2 * len(left))) ** 2
    correlation = np.fft.irfft(spectrum)[: len(left) // 3]
    correlation /= max(float(correlation[0]), 1e-18)
    crossing = int(np.argmax(correlation < 0.1)) or len(correlation)
    return 1.0 + 2.0 * float(correlation[1:crossing].sum())


def machine_unknowns(machine: Machine) -> list[Number]:
    """List the numbers that a picture may tell; masses against one of them."""
    unknowns, default = [], machine.uncertainty.get("default", 0.1)
    for name in machine.vibration.tunable:
        if name == SCALE or name.startswith("axes.z.") or "mount_freq" in name or not value_of(machine, name):
            continue
        wide = 2.0 if "damping" in name else 1.0  # damping is known half as well
        spread = wide * machine.uncertainty.get(name.partition("[")[0], default)
        unknowns.append(Number(name, value_of(machine, name), float(np.clip(spread, LEAST_SD, MOST_SD))))
    return unknowns


def _second(axis: str) -> tuple[str, str, str]:
    """Name frequency, damping ratio and share of an axis' second mode."""
    return f"axes.{axis}.frequency_hz[1]", f"axes.{axis}.damping_ratio[1]", f"second_{axis}"


def with_second_modes(machine: Machine, second: Mapping[str, tuple[float, float]]) -> Machine:
    """Return a machine of straight axes some of which have a second mode: of a frequency, Hz, and a share."""
    vibration = machine.vibration
    if not isinstance(vibration, ModalAxes):
        return machine

    def both(axis: str, modes: tuple[Oscillator, ...]) -> tuple[Oscillator, ...]:
        hz, share = second.get(axis, (0.0, 0.0))
        omega = 2 * np.pi * hz
        quicker = Oscillator(omega**2, 2 * SECOND_DAMPING[0] * omega, share=-share)
        return (replace(modes[0], share=1.0 + share), quicker) if hz else modes

    x, y, z = map(both, "xyz", vibration.axes)
    return replace(machine, vibration=replace(vibration, axes=(x, y, z)))


def _extruded(motion: Motion, t: FloatArray) -> FloatArray:
    """Return what was extruded at the times t (n,), as the length (n,) mm of a line; the line itself begins at zero."""
    if not np.ptp(motion.ends_mm[:, 3]):  # a pen
        return np.zeros(0)
    foot, end = motion.ends_mm[-2:]
    per_mm = (end[3] - foot[3]) / np.linalg.norm(end[:3] - foot[:3])
    return np.asarray((motion.trajectory.position(t)[:, 3] - foot[3]) / per_mm)


def _laid(line: ReadLine, path: FloatArray, extruded: FloatArray, bead: Mapping[str, float]) -> FloatArray:
    """Return the bead of a nozzle's path (n, 2) mm at the places where the line was read, (n,) mm across.

    It conserves volume: where the nozzle slows down along its way, as it rings along the line, the bead is wider.

    Parameters
    ----------
    extruded : (n,) mm of a line, with the path; nothing of a pen, whose line is as wide everywhere.
    """
    away = path - line.line.foot
    along = _at_speed(away @ line.line.along, line.stroke, bead["speed"])
    sy = np.column_stack([along, away @ line.line.across])
    begin = max(0, int(np.flatnonzero(sy[:, 0] < EARLIEST_MM)[-1]) - BEFORE)
    laid = _pulled(sy[begin:], bead["drag_mm"])
    way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(laid, axis=0), axis=1)))
    moving = np.append(True, np.diff(way) > 1e-9)
    even = np.arange(0.0, way[-1], FINE_MM)
    columns = laid
    if len(extruded):
        decay = np.exp(-1.0 / (RATE_HZ * bead["pressure_s"]))
        flow = _at_speed(extruded, line.stroke, bead["speed"])
        flow = lfilter([1 - decay], [1, -decay], flow, zi=decay * flow[:1])[0]
        columns = np.column_stack([laid, flow[begin:]])
    columns = np.column_stack([np.interp(even, way[moving], each[moving]) for each in columns.T])
    smooth = gaussian_filter1d(columns, bead["rounding_mm"] / FINE_MM, axis=0, mode="nearest")
    width = np.clip(np.gradient(smooth[:, 2], FINE_MM), *WIDTHS) if len(extruded) else np.ones(len(even))
    ring = bead["ring_x"] if abs(line.line.across[0]) > 0.5 else bead["ring_y"]
    first = line.s_mm[0] + bead["shift_mm"]
    return ring * _swept(smooth[:, :2], bead["radius_mm"] * width, first, len(line.s_mm), STEP_MM)


def _at_speed(s: FloatArray, stroke: Experiment, factor: float) -> FloatArray:
    """Return where (n,) mm along its line a nozzle is that would be at s, (n,) mm, were the speed not overridden.

    The line begins at rest with the acceleration a, which no override changes, up to the speed v: after the ramp
    s = v t − v²/2a, and f v t − f² v²/2a at the speed f v.
    """
    v, a = float(stroke.motion.speed[-1]), stroke.motion.limits.acceleration_mm_per_s2
    ramp = v**2 / (2 * a)
    t = np.where(s < ramp, np.sqrt(2 * np.maximum(s, 0.0) / a), (s + ramp) / v)
    return np.where(s <= 0.0, s, np.where(t < factor * v / a, 0.5 * a * t**2, factor * v * t - factor**2 * ramp))


@kernel
def _swept(path: FloatArray, radii: FloatArray, first: float, count: int, step: float) -> FloatArray:
    """Sweep a disc of radii (n,) along a path (n, 2); return the middle between both edges (count,) every step."""
    upper, lower = np.full(count, -1e9), np.full(count, 1e9)
    for i in range(len(path)):
        (s, y), radius = path[i], radii[i]
        begin = max(0, math.ceil((s - radius - first) / step))
        for k in range(begin, min(count, math.floor((s + radius - first) / step) + 1)):
            high = math.sqrt(max(radius**2 - (first + k * step - s) ** 2, 0.0))
            upper[k], lower[k] = max(upper[k], y + high), min(lower[k], y - high)
    return 0.5 * (upper + lower)


@kernel
def _pulled(path: FloatArray, length: float) -> FloatArray:
    """Pull a point after the path (n, 2) on a string."""
    laid = path.copy()
    for k in range(1, len(path)):
        x, y = path[k, 0] - laid[k - 1, 0], path[k, 1] - laid[k - 1, 1]
        slack = 1.0 - min(length / max(math.hypot(x, y), 1e-12), 1.0)
        laid[k, 0], laid[k, 1] = laid[k - 1, 0] + slack * x, laid[k - 1, 1] + slack * y
    return laid


# ---- the fit -------------------------------------------------------------------------------------


def fit_page(
    machine: Machine, lines: Sequence[ReadLine], width_mm: float, progress: Callable[[str], None] = lambda _: None
) -> PageFit:
    """Fit a machine's numbers to a page's lines, which are to be so wide; straight axes one by one.

    Raises
    ------
    MeasurementError
        If the lines do not ring as any such machine would.
    """
    page = _Page(machine, lines, width_mm)
    progress(Stage(2, "seeking where to begin"))
    begin = np.zeros(len(lines))
    rough = [fit(page, start, BEGIN, errors=begin) for start in _starts(page)]
    best = min(rough, key=lambda each: each.evidence)
    progress(Stage(3, f"fitting {page.of_machine} numbers to {len(lines)} lines"))
    fitted = fit(page, best.values, FINISH, errors=begin, jacobian=best.jacobian)
    _check_conditions(fitted)
    return _result(_with_second_modes(fitted))


def _starts(page: _Page) -> list[FloatArray]:
    """Scale all frequencies to what rings most alike, and to each other maximum that is nearly as high.

    Of each direction by itself where they are independent.
    """
    groups = {"xy"} if page.machine.vibration.position_dependent else set(page.across)
    trials = [_scaled(page, dict.fromkeys("xy", float(factor))) for factor in FACTORS]
    sds = np.split(page.deviations(np.zeros(len(page.lines))), page.ends[:-1])
    alike = {group: np.zeros(len(FACTORS) + 2) for group in sorted(groups)}
    for j, drawn in enumerate(page.drawn(trials)):
        for line, axis, y, sd in zip(page.lines, page.across, drawn, sds, strict=True):
            seen, model = (_without_bow(each) / sd for each in (line.across_mm, y))
            gain = max(float(seen @ model), 0.0) / max(float(model @ model), 1e-18)
            next(row for group, row in alike.items() if axis in group)[j + 1] += min(gain, 2.0) * float(seen @ model)
    factors = []
    for row in alike.values():
        inner = row[1:-1]
        best = (inner >= row[:-2]) & (inner > row[2:]) & (inner > RIVAL * inner.max())
        factors.append(FACTORS[best] if best.any() else FACTORS[[int(np.argmax(inner))]])
    return [
        _scaled(page, {axis: float(f) for group, f in zip(alike, each, strict=True) for axis in group})
        for each in product(*factors)
    ]


def _rings_more(found: FitResult[_Page]) -> dict[str, float]:
    """Return by how much the straight axes ring more than their one mode in the file, where that is strong and sure."""
    each = estimates(found.problem.numbers, found.values, np.diag(found.covariance))
    more = dict[str, float]()
    for axis in "xy":
        one = f"axes.{axis}.frequency_hz[0]" in each and _second(axis)[0] not in each
        if one and each[f"ring_{axis}"].low > 1.0 + STRONG:
            more[axis] = each[f"ring_{axis}"].value - 1.0
    return more


def _with_second_modes(found: FitResult[_Page]) -> FitResult[_Page]:
    """Fit a second mode of each axis that rings more than its first one would; the fit before where it fits no worse.

    From one start, modes at 74 and 77 Hz were taken for 124 and 53 Hz.
    """
    page, more = found.problem, _rings_more(found)
    if not more:
        return found
    first, tried = page.values(found.values), list[FitResult[_Page]]()
    for ratio in QUICKER:
        second = {axis: (ratio * first[f"axes.{axis}.frequency_hz[0]"], share) for axis, share in more.items()}
        wide = _Page(page.machine, page.lines, page.width_mm, second)
        errors = wide.errors_of(found.residual * found.sd)
        tried.append(fit(wide, wide.near(found), SOUGHT, errors=errors))
    best, values, elsewhere = tried[0], tried[0].values.copy(), dict[str, float]()
    for axis in more:
        rows = np.repeat([across == axis for across in page.across], np.diff(page.ends, prepend=0))
        costs = np.array([float(np.sum(each.residual[rows] ** 2)) for each in tried])
        least = int(np.argmin(costs))
        chosen, hz = tried[least], _second(axis)[0]
        for i, (number, to) in enumerate(zip(chosen.problem.numbers, best.problem.numbers, strict=True)):
            if f".{axis}." in number.name or number.name.endswith(f"_{axis}"):
                values[i] = to.at(number.value(float(chosen.values[i])))
        each_hz = np.array([each.problem.values(each.values)[hz] for each in tried])
        likely = np.exp(0.5 * (costs[least] - costs))
        elsewhere[hz] = float(np.average(np.log(each_hz / each_hz[least]) ** 2, weights=likely))
    final = fit(best.problem, values, replace(FINISH, gain=1.0), errors=best.errors)
    final.problem.elsewhere = elsewhere
    return final if final.deviance < found.deviance else found


def _named(axes: Iterable[str], found: Mapping[str, Estimate]) -> list[str]:
    """Return the axes whose second mode is strong, with a wave that tells its frequency and its damping."""
    named = []
    for axis in axes:
        hz, damping, share = (found[name] for name in _second(axis))
        if share.low > STRONG and hz.relative_sd < TOLD and damping.relative_sd < SECOND_DAMPING[1]:
            named.append(axis)
    return named


def _scaled(page: _Page, factors: Mapping[str, float]) -> FloatArray:
    """Return the point whose frequencies are multiplied, of each axis by its factor; of a delta by that of x."""
    x = np.zeros(len(page.numbers))
    for i, each in enumerate(page.numbers):
        if each.name in FRICTION:
            x[i] = 0.2
        if "." in each.name and ("stiffness" in each.name or "frequency" in each.name or "damping_n" in each.name):
            factor = factors.get(each.name.split(".")[1], factors.get("x", 1.0))
            x[i] = (2.0 if "stiffness" in each.name else 1.0) * np.log(factor)
    return np.clip(x, *page.limits)


def _without_bow(y: FloatArray) -> FloatArray:
    u = np.linspace(-1, 1, len(y))
    return np.asarray(y - np.polyval(np.polyfit(u, y, 3), u))


@dataclass(frozen=True, eq=False)
class _Shown:
    """A page's lines against the fitted ones."""

    seen: list[FloatArray]  # (n,) mm each, without what a line's place leaves open
    fitted: list[FloatArray]
    unexplained: float  # share of the waves' power beyond the roughness of the lines' last thirds,
    worse: str  # across this axis, the worse one
    doubt: float  # the same beyond that of their calm halves, which are the less rough ones as well: at least as large
    gain: float  # of χ² by the machine, of the worse direction


def _shown(result: FitResult[_Page]) -> _Shown:
    page = result.problem
    (drawn,) = page.drawn([result.values])
    sds = np.split(page.deviations(np.zeros(len(page.lines))), page.ends[:-1])
    seen, model, power, gains = [], [], np.zeros((2, 4)), dict.fromkeys(page.across, 0.0)
    for line, axis, y, sd, own in zip(page.lines, page.across, drawn, sds, page.observations, strict=True):
        bow = y - _without_bow(y)
        left = line.across_mm - y - _open(line.across_mm, y, sd)
        seen.append(left + y - bow)
        model.append(y - bow)
        last = np.full(len(left), np.mean(left[-(len(left) // 3) :] ** 2))
        power["xy".index(axis)] += [float(np.sum(each)) for each in (seen[-1] ** 2, left**2, own.noise, last)]
        gains[axis] += float(np.sum((seen[-1] ** 2 - left**2) / sd**2))
    waves, rest, *rough = power.T
    calm, last = (np.maximum(rest - each, 0.0) / np.maximum(waves - each, 1e-12) for each in rough)
    worse = int(np.argmax(last))
    return _Shown(seen, model, float(last[worse]), "xy"[worse], float(calm.max()), min(gains.values()))


def _result(fitted: FitResult[_Page]) -> PageFit:
    page, shown, covariance = fitted.problem, _shown(fitted), _covariance(fitted)
    found = estimates(page.numbers, fitted.values, np.diag(covariance))
    second, of_machine = _named(page.second, found), page.numbers[: page.of_machine]
    told = {each.name: found[each.name] for each in of_machine}
    kept = [each.name for each in of_machine if found[each.name].relative_sd > WORST_HELD * each.sd]
    bead = {name: each for name, each in found.items() if "." not in name}
    bead |= {name: replace(bead[name], low=max(bead[name].low, 0.0)) for name in FRICTION if name in bead}
    told |= {name: found[name] for axis in second for name in _second(axis)[:2]}
    told |= {f"axes.{axis}.share[1]": bead[_second(axis)[2]].scaled(-1.0) for axis in second}
    places, machine = _modes(fitted, covariance, second), page.machine_at(fitted.values, second)
    rough = float(np.median([np.sqrt(each.noise[0]) for each in page.observations]))
    return PageFit(
        machine,
        told,
        kept,
        places,
        bead,
        second,
        fitted.doubt("the page"),
        1.0 - shown.unexplained,
        rough,
        page.lines,
        shown.seen,
        shown.fitted,
    )


def _check_conditions(fitted: FitResult[_Page]) -> None:
    """Refuse a page that was drawn under other conditions than its G-code says, with the probable one.

    Where roughness does not account for the residual, speed and rings are fitted freely: a line shows what rings
    against its own length and the zigzag's time. Where it does, less ringing is that of a load on an elastic mount.
    """
    page, shown = fitted.problem, _shown(fitted)
    if shown.doubt <= DOUBTFUL and shown.gain >= LEAST_GAIN:
        return
    free = _Page(page.machine, page.lines, page.width_mm, conditions=OVERRIDDEN)
    x, errors, trials = free.near(fitted), np.zeros(len(page.lines)), list[FloatArray]()
    for factor in SPEEDS:  # waves as long, of other frequencies
        shifted = x + _scaled(free, dict.fromkeys("xy", factor)) - _scaled(free, {})
        shifted[free.index("speed")] = np.log(factor)
        trials.append(np.clip(shifted, *free.limits))
    sd = free.deviations(errors)
    costs = [float(np.sum(free.whitened(each, sd) ** 2)) for each in free.simulate(trials)]
    tried = (fit(free, trials[int(i)], BEGIN, errors=errors) for i in np.argsort(costs)[:TRIED])
    fitted = min(tried, key=lambda each: each.cost)
    shown = _shown(fitted)
    found = estimates(free.numbers, fitted.values, np.diag(_covariance(fitted)))
    speed = found["speed"]
    weak = {axis: found[f"ring_{axis}"] for axis in "xy" if found[f"ring_{axis}"].high < SAME_RING}
    enough = shown.gain >= LEAST_GAIN and shown.unexplained < MOST_UNEXPLAINED
    if enough and abs(np.log(speed.value)) > SAME_SPEED and not speed.low <= 1.0 <= speed.high:
        reason = (
            f"The page was drawn at {100 * speed.value:.0f} % ({100 * speed.low:.0f} to {100 * speed.high:.0f}) of its "
            "speed: a speed factor is set. Set it to 100 % (M220 S100, or on the display), and print the page again."
        )
    elif weak:
        rings = " and ".join(f"{axis} rings {each.value:.2f} times as much" for axis, each in weak.items())
        reason = (
            f"{rings} as the zigzags excite: the page was printed with an input shaper on, or with less acceleration. "
            "Run the page's G-code as it is, without overrides, and let it switch the shaper off."
        )
    elif shown.unexplained < MOST_UNEXPLAINED and not enough:
        reason = (
            "The waves hardly stand out from the roughness of the lines: an input shaper was on, or the printer rings "
            "too little. Switch the shaper off and print the page again, or use a sensor."
        )
    elif not enough:
        reason = (
            f"The machine explains {100 * max(1.0 - shown.unexplained, 0.0):.0f} % of the waves of {shown.worse}, "
            "and roughness does not account for the rest: this page was drawn by another machine, by other G-code, by "
            "speed overrides or with an input shaper on, or its lines are torn. Check -m and --plan, switch the shaper "
            "off, or print the page again."
        )
    else:
        return
    raise MeasurementError(", ".join(dict.fromkeys(line.picture for line in page.lines)), [reason])


def _covariance(result: FitResult[_Page]) -> FloatArray:
    """Return the covariance (p, p), at least as wide as by leaving out each stroke, with what no page shows.

    What strokes do not share, such as a law of friction that is not quite right at a speed, is in the fit's own.
    """
    covariance = result.covariance.copy()
    size = np.sum(result.jacobian**2, axis=0)
    numbers, elsewhere = result.problem.numbers, result.problem.elsewhere
    for i in np.flatnonzero(["." in each.name for each in numbers]):
        each = numbers[i]
        floor = DAMPING_FLOOR if "damping" in each.name else MASS_FLOOR if each.name == "carriage.mass_kg" else FLOOR
        covariance[i, i] += floor**2 + elsewhere.get(each.name, 0.0)
        if "damping" in each.name:  # of friction, what looks like this damping
            alike = [
                result.values[j] * float(result.jacobian[:, i] @ result.jacobian[:, j]) / max(float(size[i]), 1e-12)
                for j, other in enumerate(numbers)
                if other.name in FRICTION
            ]
            covariance[i, i] += (FRICTION_LAW * sum(alike)) ** 2
    return covariance


def _modes(fitted: FitResult[_Page], covariance: FloatArray, second: Sequence[str]) -> list[PlaceModes]:
    """Return frequencies and damping ratios of what rings, at the places of the strokes."""
    page, found = fitted.problem, list[PlaceModes]()
    steps = 1e-2 * np.sqrt(np.diag(covariance))
    for x, y in {line.stroke.place: line.stroke.position_mm[:2] for line in page.lines}.values():
        here = page.machine_at(fitted.values, second).vibration.modes_at(np.array([x, y]))
        count = len(here.frequencies_hz)

        def both(at: FloatArray, x: float = x, y: float = y, hz: FloatArray = here.frequencies_hz) -> FloatArray:
            modes = page.machine_at(at, second).vibration.modes_at(np.array([x, y]))
            same = np.abs(np.log(modes.frequencies_hz / hz[:, None])).argmin(axis=1)  # one may cease to swing
            return np.log(np.concatenate([modes.frequencies_hz[same], modes.damping_ratios[same]]))

        moved = [both(fitted.values + step) - both(fitted.values - step) for step in np.diag(steps)]
        slope = np.stack(moved, axis=1) / (2 * steps)
        spread = np.sqrt(np.einsum("ij,jk,ik->i", slope, covariance, slope))
        if page.machine.vibration.position_dependent:
            spread[:count] = np.hypot(spread[:count], TOWERS)
        each = zip(here.frequencies_hz, here.damping_ratios, spread[:count], spread[count:], strict=True)
        modes = [Mode(lognormal(float(f), a), lognormal(float(d), b)) for f, d, a, b in each if d < RINGING]
        found.append(PlaceModes((x, y), modes))
    return found
