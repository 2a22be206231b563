"""The output-error fit of a page: the machine's numbers, and what guides and bead do to its motion.

    minimise  Σ ((y − ŷ(θ, β) − B c) / σ)²  +  |z|²

y is a stroke's distance from the slow line beside it, ŷ that of the simulated nozzle, of which the bead follows late
(drag, between a first-order lag over the way and a point pulled on a string), rounded (over a width); as wide as it
is, it is seen between its edges, which lie aside of its path where that bends and is steep. B c takes out
what each line's place on the page leaves open: an offset, a slope, a bow, and a small shift along it. z are θ and β in
standard deviations of their priors; θ are logarithms. β has the dry friction of each guide too, which makes small waves
die sooner and, where contacts bend, ring quicker: without it, dampings came out 8 to 30 % high on drawn deltas. Its law
near a reversal is one of two; the likelier counts, and the other widens the intervals as far as it is likely too. How
much an axis rings is free by a tenth: without that, a second mode that moves against the first one passes for less
damping. Where roughness leaves much unexplained, rings and speeds are free altogether, which shows input shapers and
speed factors. σ is the rms residual of a line, or around a place of it, times its correlation (effective sample size),
and more where a bead may fold; covariances are at least as wide as by leaving out strokes.
The steps are those of `ffcomp/numerics/least_squares.py`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter1d, maximum_filter1d
from scipy.signal import lfilter

from ffcomp.errors import MeasurementError
from ffcomp.identification.page_lines import STEP_MM, ReadLine
from ffcomp.identification.uncertainty import Estimate, Joint, lognormal, normal, through
from ffcomp.numerics.least_squares import BatchedProblem, Iterate, differences, minimise_batched, predicted_gain
from ffcomp.numerics.stages import Stage
from ffcomp.record.plan import Experiment
from models.arrays import FloatArray
from models.compiled import kernel
from models.effects.catalogue import key_in_file
from models.machine import Machine, value_of, with_values
from models.printer.parameters import ConvertedPrinter, converted_printer
from models.printer.printer import Splines, simulate_printers

RATE_HZ = 3200.0
LEAD_S, SETTLED_S = 0.02, 0.05  # of rest before a motion; after it
SCALE = "effector.nozzle_mass_kg"  # a picture tells ratios of masses only: one stays as it is
LEAST_SD, MOST_SD = 0.08, 0.5  # of a prior, relative
FARTHEST = 4.0  # standard deviations
FACTORS = np.exp(np.arange(-0.48, 0.481, 0.03))  # on all frequencies, where to begin
FRICTION = ("friction_a", "friction_b", "friction_c")  # of the guides, N; of axes without masses, m/s²
FRICTION_SD, LEAST_FRICTION = 1.0, 1e-3  # in units of it: without any, bristles would not be limited
LAWS = {"presliding_mm": (0.003, 1.0), "creep_mm_per_s": (0.5, 1.0)}  # near a reversal: contacts bend, or creep
# middle, sd (of the logarithm); taut: 0, the bead follows in proportion to how far it is behind, 1: as on a string
BEAD = {"drag_mm": (0.15, 0.7), "rounding_mm": (0.12, 0.5), "shift_mm": (0.0, 0.015), "taut": (0.5, 0.7)}
# of a print; 1: as planned. Speeds in the lines' directions; how much of what the zigzags excite rings along x, y: more
# than 1 where a quicker mode moves against the one that rings, less with an input shaper
PLANNED = {"speed": (1.0, 0.0), "ring_x": (1.0, 0.1), "ring_y": (1.0, 0.1)}
OVERRIDDEN = {"speed": (1.0, 0.2), "ring_x": (1.0, 1.0), "ring_y": (1.0, 1.0)}
SPEEDS = (0.7, 0.8, 0.9, 1.1, 1.25, 1.4)  # of an override, where to begin
OTHER_GAIN = 20.0  # of χ², which another speed promises: then it is fitted
SAME_SPEED, SAME_RING = 0.04, 0.85  # of the logarithm: less is no override; a shaper leaves less than this share
RADIUS = (0.53, 0.2)  # of a line, in its widths on the page: a first layer is squeezed
LINE_SHIFT_MM = 0.04  # sd of a line's own place along it
FINE_MM = 0.025
EARLIEST_MM, BEFORE_MM = 0.1, 1.5  # of a line; of the way before it: where the bead begins to be simulated
LEAST_GAIN = 60.0  # of χ² by the waves, correlated roughness allowed for
DOUBTFUL, MOST_UNEXPLAINED = (
    0.1,
    0.3,
)  # of the waves' power that neither the machine explains nor the roughness of lines
FLAT = 0.15  # of the expected waves: less, and a shaper took them away
WORST_HELD = 0.5  # posterior over prior: a number that the picture leaves so wide stays as it was
REWEIGHTED, LOCAL_MM = 2, 0.5  # passes; of a line, around a place
STEEP, STEEP_MM, STEEP_TIMES = 0.5, 1.0, 5.0  # of a slope where a bead may fold; around it; of σ there
STUDENT = 1.15  # Student's 90 % interval over the normal one, of about ten strokes a direction with their own numbers
TOWERS = 0.007  # of the logarithm of a frequency at one place: towers that differ by 2 %, and are fitted as one
FLOOR, DAMPING_FLOOR = 0.004, 0.1  # of the logarithms: towers that differ
MASS_FLOOR = 0.12  # of a carriage's: it shows along z, which lines hardly do, and is up to a fifth off
FRICTION_LAW = 0.25  # of friction's part in what looks like damping: no law of it is better known


@dataclass(frozen=True, eq=False)
class PageFit:
    """What a page says of a machine."""

    machine: Machine
    estimates: Mapping[str, Estimate]  # of the machine file's numbers
    kept: Sequence[str]  # numbers that the picture does not tell
    modes: Mapping[tuple[float, float], Sequence[tuple[Estimate, Estimate]]]  # place -> frequency Hz, damping ratio
    bead: Mapping[str, Estimate]
    explained: float  # share of the waves' power
    lines: Sequence[ReadLine]
    seen: Sequence[FloatArray]  # of each line, mm: without what its place leaves open
    fitted: Sequence[FloatArray]

    @property
    def friction(self) -> dict[str, Any]:
        """Return the guides' dry friction as a machine file has it; nothing where the page does not show any."""
        forces = [self.bead[name] for name in FRICTION if name in self.bead]
        if not any(each.low > 0.0 for each in forces):
            return {}
        law = next(name for name in LAWS if name in self.bead)
        sizes = [float(f"{each.value:.3g}") if each.low > 0.0 else 0.0 for each in forces]
        key = key_in_file("coulomb_friction", "force_n", self.machine.vibration.quantities)
        return {key: sizes + [0.0] * (len(FRICTION) - len(sizes)), law: float(f"{self.bead[law].value:.3g}")}


@dataclass(frozen=True, eq=False)
class Unknown:
    """A number that a page tells, and what is known of it before."""

    name: str
    start: float
    sd: float  # of the logarithm; of a number around zero, its own

    def value(self, z: float) -> float:
        """Return the number z standard deviations from where it starts."""
        return float(self.start * np.exp(self.sd * z)) if self.start else self.sd * z


class _Page:
    """The lines, the commands that drew them, and what a machine would have drawn."""

    def __init__(
        self,
        machine: Machine,
        lines: Sequence[ReadLine],
        law: str,
        width_mm: float,
        conditions: Mapping[str, tuple[float, float]] = PLANNED,
    ) -> None:
        self.machine, self.lines = machine, lines
        names = [line.stroke.name for line in lines]
        self.copies = np.sqrt([names.count(name) for name in names])  # pictures of a stroke share its roughness
        # roughness is correlated over some half millimetre
        rough = self.copies * [max(line.noise_mm, 2e-3) * np.sqrt(0.5 / STEP_MM) for line in lines]
        self.sigma = [each * _steep(line.across_mm) for line, each in zip(lines, rough, strict=True)]  # (n,) mm each
        strokes = {line.stroke.name: line.stroke for line in lines}
        self.which = [list(strokes).index(line.stroke.name) for line in lines]
        self.commands = []
        for stroke in strokes.values():
            t = np.arange(-LEAD_S, stroke.duration_s + SETTLED_S, 1 / RATE_HZ)
            self.commands.append(np.ascontiguousarray(machine.kinematics.inverse(stroke.motion.nozzle(t))))
        of_machine = machine_unknowns(machine)
        self.of_machine = len(of_machine)
        rubbing = FRICTION if machine.vibration.position_dependent else FRICTION[:2]
        self.law = law
        nuisances = dict.fromkeys(rubbing, (0.0, FRICTION_SD)) | {law: LAWS[law]} | BEAD | dict(conditions)
        nuisances["radius_mm"] = (RADIUS[0] * width_mm, RADIUS[1])
        self.unknowns = [*of_machine, *(Unknown(n, m, sd) for n, (m, sd) in nuisances.items())]
        self.low = np.array([LEAST_FRICTION if each.name in FRICTION else -FARTHEST for each in self.unknowns])
        high = np.full(len(self.unknowns), FARTHEST)
        known = np.array([each.sd == 0.0 for each in self.unknowns])
        self.problem = BatchedProblem(self.residuals, np.where(known, 0.0, self.low), np.where(known, 0.0, high))
        self.splines = Splines()

    def values(self, z: FloatArray) -> dict[str, float]:
        return {each.name: each.value(float(at)) for each, at in zip(self.unknowns, z, strict=True)}

    def machine_at(self, z: FloatArray) -> Machine:
        values = self.values(z)
        return with_values(self.machine, {each.name: values[each.name] for each in self.unknowns[: self.of_machine]})

    def rubbing(self, z: FloatArray) -> ConvertedPrinter:
        """Return the machine at z with dry friction, as the simulation takes it."""
        values = self.values(z)
        force = [values.get(name, 0.0) for name in FRICTION]
        friction = {"force_n": force, self.law: values[self.law]}
        effects = {**self.machine.effects, "coulomb_friction": friction}
        return converted_printer(replace(self.machine_at(z), effects=effects), gravity=False)

    def drawn(self, points: Sequence[FloatArray]) -> Iterator[list[FloatArray]]:
        """Simulate each point (p,): the lines as they would be drawn, (n,) mm each."""
        count = len(self.commands)
        printers = [printer for z in points for printer in [self.rubbing(z)] * count]
        motions = simulate_printers(
            [self.machine] * len(printers),
            self.commands * len(points),
            1 / RATE_HZ,
            substeps=1,
            converted=printers,
            splines=self.splines,
        )
        for i, z in enumerate(points):
            motions_here = motions[i * count : (i + 1) * count]
            bead = self.values(z)
            paths = []
            for motion in motions_here:
                if isinstance(motion, ValueError):
                    raise motion
                paths.append(motion.nozzle_mm[:, :2])
            yield [_laid(line, paths[k], bead) for line, k in zip(self.lines, self.which, strict=True)]

    def residuals(self, points: Sequence[FloatArray]) -> Iterator[FloatArray]:
        """Return the whitened residual (rows,) of each point (p,)."""
        for drawn in self.drawn(points):
            yield np.concatenate(
                [self.apart(k, line.across_mm, y)[0] / self.sigma[k] for k, (line, y) in enumerate(self.along(drawn))]
            )

    def along(self, drawn: Sequence[FloatArray]) -> Iterator[tuple[ReadLine, FloatArray]]:
        return zip(self.lines, drawn, strict=True)

    def apart(self, k: int, seen: FloatArray, drawn: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return what is left of a line, (n,) mm, and what of it was taken for the line's own place."""
        n = len(seen)
        u = np.linspace(-1, 1, n)
        slope = np.gradient(drawn, STEP_MM)
        basis = np.column_stack([np.ones(n), u, u**2 - 1 / 3, u**3 - 0.6 * u, LINE_SHIFT_MM * slope])
        ridge = np.diag([0.0, 0.0, 0.0, 0.0, 1.0])
        gap = seen - drawn
        weighted = basis / self.sigma[k][:, None] ** 2
        free = basis @ np.linalg.solve(weighted.T @ basis + ridge + 1e-9 * np.eye(5), weighted.T @ gap)
        return gap - free, free


def machine_unknowns(machine: Machine) -> list[Unknown]:
    """List the numbers that a picture may tell; masses against one of them."""
    known = machine.vibration.parameters()
    sd = dict(zip(known.names, known.relative_sd(machine.uncertainty).tolist(), strict=True))
    default = machine.uncertainty.get("default", 0.1)
    names = [
        n for n in machine.vibration.tunable if n != SCALE and not n.startswith("axes.z.") and "mount_freq" not in n
    ]
    unknowns = []
    for name in names:
        stem = name.partition("[")[0]
        spread = sd.get(name) or machine.uncertainty.get(name, machine.uncertainty.get(stem, default))
        wide = 2.0 if "damping" in name else 1.0  # nobody knows damping better
        if value_of(machine, name):
            unknowns.append(Unknown(name, value_of(machine, name), float(np.clip(wide * spread, LEAST_SD, MOST_SD))))
    return unknowns


def _laid(line: ReadLine, path: FloatArray, bead: Mapping[str, float]) -> FloatArray:
    """Return the bead of a nozzle's path (n, 2) mm at the places where the line was read, (n,) mm across."""
    away = path - line.line.foot
    along = _at_speed(away @ line.line.along, line.stroke, bead["speed"])
    sy = np.column_stack([along, away @ line.line.across])
    before = np.flatnonzero(sy[:, 0] < EARLIEST_MM)
    way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(sy, axis=0), axis=1)))
    way -= way[before[-1]] if len(before) else 0.0
    moving = np.append(True, np.diff(way) > 1e-9) & (way > -BEFORE_MM)
    even = np.arange(way[moving][0], way[-1], FINE_MM)
    nozzle = np.column_stack([np.interp(even, way[moving], each[moving]) for each in sy.T])
    decay = np.exp(-FINE_MM / bead["drag_mm"])
    lagged = lfilter([1 - decay], [1, -decay], nozzle, axis=0, zi=decay * nozzle[:1])[0]
    laid = lagged + bead["taut"] * (_pulled(nozzle, bead["drag_mm"]) - lagged)
    bent = gaussian_filter1d(laid, bead["rounding_mm"] / FINE_MM, axis=0, mode="nearest")
    ring = bead["ring_x"] if abs(line.line.across[0]) > 0.5 else bead["ring_y"]
    return ring * _swept(bent, bead["radius_mm"], line.s_mm[0] + bead["shift_mm"], len(line.s_mm), STEP_MM)


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
def _swept(path: FloatArray, radius: float, first: float, count: int, step: float) -> FloatArray:
    """Sweep a disc along a path (n, 2), and return the middle between both edges (count,) every step."""
    upper, lower = np.full(count, -1e9), np.full(count, 1e9)
    for s, y in path:
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
    """Fit a machine's numbers to a page's lines, which are to be so wide.

    Raises
    ------
    MeasurementError
        If the lines do not ring as any such machine would.
    """
    bends, creeps = (_Page(machine, lines, law, width_mm) for law in LAWS)
    _check_waves(bends)
    progress(Stage(2, "seeking where to begin"))
    start = _start(bends)
    progress(Stage(3, f"fitting {bends.of_machine} numbers to {len(lines)} lines"))
    fitted = minimise_batched(bends.problem, start, iterations=12)
    for _ in range(REWEIGHTED):
        (drawn,) = bends.drawn([fitted.z])
        before = list(bends.sigma)
        _reweight(bends, drawn)
        again = np.concatenate([old / new for old, new in zip(before, bends.sigma, strict=True)])
        fitted = minimise_batched(bends.problem, fitted.z, again[:, None] * fitted.jacobian, iterations=12)
    creeps.sigma = bends.sigma
    _check_conditions(bends, _Page(machine, lines, bends.law, width_mm, OVERRIDDEN), fitted)
    other = minimise_batched(creeps.problem, fitted.z, fitted.jacobian, iterations=12)
    if other.cost < fitted.cost:
        return _result(creeps, other, fitted)
    return _result(bends, fitted, other)


def _start(page: _Page) -> FloatArray:
    """Scale all frequencies, of each direction by itself where they are independent, to what rings most alike."""
    groups = ["all"] if page.machine.vibration.position_dependent else ["x", "y"]
    trials = [_scaled(page, dict.fromkeys(groups, float(factor))) for factor in FACTORS]
    alike = np.zeros((len(groups), len(FACTORS)))
    for j, drawn in enumerate(page.drawn(trials)):
        for k, (line, y) in enumerate(page.along(drawn)):
            seen, model = (_without_bow(each) / page.sigma[k] for each in (line.across_mm, y))
            gain = max(float(seen @ model), 0.0) / max(float(model @ model), 1e-18)
            along_y = len(groups) > 1 and abs(line.line.across[0]) <= abs(line.line.across[1])
            alike[int(along_y), j] += min(gain, 2.0) * float(seen @ model)
    best = {name: float(FACTORS[int(np.argmax(row))]) for name, row in zip(groups, alike, strict=True)}
    return _scaled(page, best)


def _scaled(page: _Page, factors: Mapping[str, float]) -> FloatArray:
    """Return the point whose frequencies are multiplied."""
    z = np.zeros(len(page.unknowns))
    z[page.low == LEAST_FRICTION] = 0.2
    for i, each in enumerate(page.unknowns[: page.of_machine]):
        factor = factors.get("all") or factors.get(each.name.split(".")[1], 1.0)
        power = 2.0 if "stiffness" in each.name else 1.0 if "frequency" in each.name else 0.0
        if "damping_n" in each.name:
            power = 1.0
        z[i] = np.clip(power * np.log(factor) / each.sd, -FARTHEST, FARTHEST)
    return z


def _without_bow(y: FloatArray) -> FloatArray:
    u = np.linspace(-1, 1, len(y))
    return np.asarray(y - np.polyval(np.polyfit(u, y, 3), u))


def _steep(y: FloatArray) -> FloatArray:
    """Return the factor (n,) of sigma: more than 1 where a bead is so steep, or near it, that it may fold."""
    slope = np.abs(gaussian_filter1d(y, 2, order=1)) / STEP_MM
    return np.where(maximum_filter1d(slope, 2 * round(STEEP_MM / STEP_MM) + 1) > STEEP, STEEP_TIMES, 1.0)


def _reweight(page: _Page, drawn: Sequence[FloatArray]) -> None:
    """Set each place's weight by what is left of its line and around it, correlated as that is."""
    for k, (line, y) in enumerate(page.along(drawn)):
        left, _ = page.apart(k, line.across_mm, y)
        spectrum = np.abs(np.fft.rfft(left, 2 * len(left))) ** 2
        correlation = np.fft.irfft(spectrum)[: len(left) // 3]
        correlation /= max(float(correlation[0]), 1e-18)
        crossing = int(np.argmax(correlation < 0.1)) or len(correlation)
        times = 1.0 + 2.0 * float(correlation[1:crossing].sum())
        here = np.sqrt(gaussian_filter1d(left**2, LOCAL_MM / STEP_MM))
        steep = np.maximum(_steep(line.across_mm), _steep(y))
        everywhere = max(float(np.sqrt(np.mean(left[steep == 1.0] ** 2))), 1e-3)
        page.sigma[k] = page.copies[k] * steep * np.maximum(here, everywhere) * np.sqrt(times)


@dataclass(frozen=True, eq=False)
class _Shown:
    """A page's lines against the fitted ones."""

    seen: list[FloatArray]  # (n,) mm each, without what a line's place leaves open
    fitted: list[FloatArray]
    explained: float  # share of the waves' power, weighted
    gain: float  # of χ²
    unexplained: float  # share of the waves' power beyond the lines' roughness


def _shown(page: _Page, z: FloatArray) -> _Shown:
    (drawn,) = page.drawn([z])
    seen, model = [], []
    for k, (line, y) in enumerate(page.along(drawn)):
        _, free = page.apart(k, line.across_mm, y)
        bow = y - _without_bow(y)
        seen.append(line.across_mm - free - bow)
        model.append(y - bow)
    weights = [1 / s**2 for s in page.sigma]
    left = sum(float(np.sum(w * (a - b) ** 2)) for w, a, b in zip(weights, seen, model, strict=True))
    power = sum(float(np.sum(w * a**2)) for w, a in zip(weights, seen, strict=True))
    rough = sum(float(np.sum(w * line.noise_mm**2)) for w, line in zip(weights, page.lines, strict=True))
    return _Shown(seen, model, 1.0 - left / power, power - left, (left - rough) / power)


def _result(page: _Page, fitted: Iterate, other: Iterate) -> PageFit:
    shown = _shown(page, fitted.z)
    covariance = _covariance(page, fitted)
    # of two laws of friction the likelier one counts, and the other one as far as it is likely too
    apart, odds = other.z - fitted.z, np.exp(min(0.5 * (other.cost - fitted.cost), 50.0))
    covariance = covariance + np.outer(apart, apart) / (1.0 + odds)
    machine = page.machine_at(fitted.z)
    estimates, bead, kept = {}, {}, []
    for i, each in enumerate(page.unknowns):
        spread = float(np.sqrt(covariance[i, i]))
        value = each.value(float(fitted.z[i]))
        if each.sd == 0.0:
            continue
        if i >= page.of_machine:
            sd = each.sd * spread
            bead[each.name] = lognormal(value, sd) if each.start else normal(value, sd)
            if each.name in FRICTION:
                bead[each.name] = replace(bead[each.name], low=max(bead[each.name].low, 0.0))
            continue
        estimates[each.name] = _signed(value, each.sd * spread)
        if spread > WORST_HELD:
            kept.append(each.name)
    modes = _modes(page, fitted.z, covariance)
    return PageFit(machine, estimates, kept, modes, bead, shown.explained, page.lines, shown.seen, shown.fitted)


def _signed(value: float, relative_sd: float) -> Estimate:
    e = lognormal(abs(value), relative_sd)
    return e if value > 0 else Estimate(value, e.sd, -e.high, -e.low)


def _check_conditions(page: _Page, free: _Page, fitted: Iterate) -> None:
    """Refuse a page that was drawn under other conditions than its G-code says, with the probable one.

    Where roughness does not account for the residual, or another speed promises to lessen it, speed and rings are
    fitted freely: a line shows what rings against its own length and the zigzag's time, which no override of speeds
    changes.
    """
    shown, names = _shown(page, fitted.z), [each.name for each in page.unknowns]
    free.sigma, i = page.sigma, names.index("speed")
    z = fitted.z * [b.sd / a.sd for a, b in zip(free.unknowns, page.unknowns, strict=True)]
    jacobian = fitted.jacobian.copy()
    jacobian[:, i] = differences(free.problem, z, fitted.residual, [i], central=True)[:, 0]
    trials, as_long = [z], _scaled(free, {"all": 1.0})
    for factor in SPEEDS:  # waves as long, of other frequencies
        shifted = z + _scaled(free, {"all": factor}) - as_long
        shifted[i] = np.log(factor) / free.unknowns[i].sd
        trials.append(free.problem.clip(shifted))
    here = [Iterate(at, r, jacobian) for at, r in zip(trials, free.problem.residuals(trials), strict=True)]
    expected = [each.cost - predicted_gain(free.problem, each) for each in here]
    if shown.unexplained > DOUBTFUL or min(expected) < fitted.cost - OTHER_GAIN:
        released = minimise_batched(free.problem, here[int(np.argmin(expected))].z, iterations=12)
        if released.cost < fitted.cost:
            page, fitted, shown = free, released, _shown(free, released.z)
    sd = np.sqrt(np.diag(_covariance(page, fitted)))
    found = {name: lognormal(page.values(fitted.z)[name], page.unknowns[k].sd * sd[k]) for k, name in enumerate(names)}
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
    elif not enough:
        reason = (
            f"The machine explains {100 * max(shown.explained, 0.0):.0f} % of the lines' waves, and roughness does "
            "not account for the rest: this page was drawn by another machine, by other G-code, with an input shaper "
            "on or speed overrides, or its lines are torn. Check -m and --plan, switch the shaper off, or print the "
            "page again."
        )
    else:
        return
    raise MeasurementError(", ".join(dict.fromkeys(line.picture for line in page.lines)), [reason])


def _check_waves(page: _Page) -> None:
    """Refuse lines that wave far less than the machine file expects."""
    path = ", ".join(dict.fromkeys(line.picture for line in page.lines))
    rough = float(np.mean([line.noise_mm**2 for line in page.lines]))
    seen = np.concatenate([_without_bow(line.across_mm) for line in page.lines])
    waves = float(np.sqrt(max(float(np.mean(seen**2)) - 2.0 * rough, 0.0)))
    (as_filed,) = page.drawn([page.problem.clip(np.zeros(len(page.unknowns)))])
    expected = float(np.sqrt(np.mean(np.concatenate([_without_bow(y) for y in as_filed]) ** 2)))
    if waves < FLAT * expected:
        raise MeasurementError(
            path,
            [
                f"The lines wave by {1e3 * waves:.0f} µm where this machine should make {1e3 * expected:.0f}: they "
                "were printed with an input shaper on, or much slower. Run the page's G-code as it is, without "
                "overrides, and let it switch the shaper off."
            ],
        )


def _covariance(page: _Page, fitted: Iterate) -> FloatArray:
    """Estimate the covariance (p, p) of z, at least as wide as by leaving out each stroke (jackknife).

    Without stroke c, to first order, the fit moves by (N − J_cᵀ J_c)⁻¹ J_cᵀ r_c (MacKinnon & White, J. Econometrics 29,
    1985, for clusters); what a stroke's neighbours do not share, such as a law of friction that is not quite right at
    its speed, is in that.
    """
    normal, _ = fitted.quadratic
    bread = np.linalg.inv(normal)
    ends = np.cumsum([len(line.s_mm) for line in page.lines])
    own: dict[str, tuple[FloatArray, FloatArray]] = {}
    for line, begin, end in zip(page.lines, [0, *ends[:-1]], ends, strict=True):
        part = fitted.jacobian[begin:end]
        matrix, gradient = own.get(line.stroke.name, (0.0, 0.0))
        own[line.stroke.name] = (matrix + part.T @ part, gradient + part.T @ fitted.residual[begin:end])
    moved = np.array([np.linalg.solve(normal - matrix, gradient) for matrix, gradient in own.values()])
    wider = np.sqrt(np.maximum(1.0, STUDENT**2 * np.sum(moved**2, axis=0) / np.diag(bread)))
    covariance = np.asarray(bread * np.outer(wider, wider))
    size = np.sum(fitted.jacobian**2, axis=0)
    for i, each in enumerate(page.unknowns[: page.of_machine]):
        floor = DAMPING_FLOOR if "damping" in each.name else MASS_FLOOR if each.name == "carriage.mass_kg" else FLOOR
        covariance[i, i] += (floor / each.sd) ** 2
        if "damping" in each.name:  # of friction, what looks like this damping
            alike = [
                fitted.z[j] * float(fitted.jacobian[:, i] @ fitted.jacobian[:, j]) / max(float(size[i]), 1e-12)
                for j, other in enumerate(page.unknowns)
                if other.name in FRICTION
            ]
            covariance[i, i] += (FRICTION_LAW * sum(alike)) ** 2
    return covariance


RINGING = 0.3  # damping ratio: more, and a mode does not ring


def _modes(
    page: _Page, z: FloatArray, covariance: FloatArray
) -> dict[tuple[float, float], list[tuple[Estimate, Estimate]]]:
    """Return frequencies and damping ratios of what rings, at the places of the strokes."""
    names = tuple(each.name for each in page.unknowns)
    joint = Joint(names, z, covariance)
    places = {line.stroke.place: line.stroke.position_mm[:2] for line in page.lines}
    by_place: dict[tuple[float, float], list[tuple[Estimate, Estimate]]] = {}
    for x, y in places.values():
        here = page.machine_at(z).vibration.modes_at(np.array([x, y]))
        count = len(here.frequencies_hz)

        def both(at: FloatArray, x: float = x, y: float = y, hz: FloatArray = here.frequencies_hz) -> FloatArray:
            modes = page.machine_at(at).vibration.modes_at(np.array([x, y]))
            same = np.abs(np.log(modes.frequencies_hz / hz[:, None])).argmin(axis=1)  # one may cease to swing
            return np.log(np.concatenate([modes.frequencies_hz[same], modes.damping_ratios[same]]))

        spread = np.sqrt(
            np.maximum(
                np.diag(through(both, tuple(map(str, range(2 * count))), joint).covariance[: 2 * count, : 2 * count]),
                0.0,
            )
        )
        if page.machine.vibration.position_dependent:
            spread[:count] = np.hypot(spread[:count], TOWERS)
        by_place[x, y] = [
            (lognormal(float(f), float(spread[i])), lognormal(float(d), float(spread[count + i])))
            for i, (f, d) in enumerate(zip(here.frequencies_hz, here.damping_ratios, strict=True))
            if d < RINGING
        ]
    return by_place
