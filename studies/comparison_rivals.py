"""Every method of one print, set as its firmware would and at its best: what the comparison judges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ffcomp.comparison import methods as every
from ffcomp.comparison.methods import COMMON_FACTORS, DAMPING, DAMPING_FACTORS, LinearPrinter, Shaping, TunedMethod
from ffcomp.comparison.sampling import PrintSlice
from ffcomp.inverse.settings import settings_for
from ffcomp.metrics import peak_acceleration
from ffcomp.shapers import DAMPING_RATIO, SHAPERS, Shaper
from ffcomp.shapers.pulses import KERNELS
from ffcomp.shapers.search import Optimum, Scan, search
from ffcomp.simulation.linear import STEP_S
from models.arrays import FloatArray
from models.machine import Machine

INVERTED = ("smooth_zv", "smooth_mzv")  # the kernels of the firmware that inverts a mode
JUDGED = 6  # kinds, the best of all on this print, that are executed; of the others the linear plant's answer is told
SOUGHT = "the least contour rms on this print, sought with the plant known."
KERNEL_FACTORS = (0.33, 0.42, 0.55, 0.75, 1.3)  # of the kernel alone, which may be much quicker than the mode
SPANS_S = (0.004, 0.001)  # over which accelerations count: of one segment of ours, and of a quick kernel
NODES = 64  # of the sum with the kernel's second derivative: to 0.1 µm at 5 m/s² and a mode of 40 Hz


@dataclass(frozen=True, eq=False)
class Pair:
    """One method as its firmware sets it, and at its best."""

    label: str
    group: str  # what is shaped
    calibrated: TunedMethod
    best: TunedMethod
    plain: bool  # a shaper of x and y, as most firmware has it


@dataclass(frozen=True, eq=False)
class Known:
    """A rival, its best settings and what they leave on the linear plant, µm."""

    rival: Shaping
    found: Optimum


def pairs(machine: Machine, slices: list[PrintSlice]) -> tuple[list[Pair], dict[str, float]]:
    """Set every rival on some slices of a print.

    Returns
    -------
    pairs : list of Pair
        What is worth executing.
    others : dict
        Label → contour rms on the linear plant, µm, of the kinds that are not.
    """
    linear = InversePrinter(machine, slices)
    kinds = sorted(
        (Known(each, linear.best(each)) for each in map(Shaping, SHAPERS)), key=lambda known: known.found.cost
    )
    first, inverted = kinds[:JUDGED], [Known(each, linear.best(each)) for each in map(ModeInverse, INVERTED)]
    known = first + inverted
    if z_rings(machine):
        known += [_with_z(linear, each) for each in first + inverted]
    return [_pair(linear, each) for each in known], {each.rival.label: each.found.cost for each in kinds[JUDGED:]}


def inverse_within(machine: Machine, slices: list[PrintSlice], peak_mm_per_s2: float, span_s: float) -> Pair:
    """Set the best inverse of a mode whose command has no higher peak of acceleration."""
    linear = InversePrinter(machine, slices, peak_mm_per_s2, span_s)
    found = [Known(each, linear.best(each)) for each in map(ModeInverse, INVERTED)]
    return _pair(linear, min(found, key=lambda known: known.found.cost))


def inversions(machine: Machine) -> list[TunedMethod]:
    """Return ffcomp's ways."""
    settings = settings_for(machine)
    names = (every.ONE_MODEL, every.ROBUST, every.COMPENSATED)
    return [every.inversion(machine, settings, name) for name in names]


def z_rings(machine: Machine) -> bool:
    """Tell whether the nozzle answers to z otherwise than by following."""
    hz = np.linspace(10.0, 150.0, 141)
    middle = np.array(machine.kinematics.centre_mm)
    answer = machine.vibration.frequency_response(middle, hz, "nozzle", "nozzle")[:, 2, 2]
    return bool(np.abs(answer).max() > 1.05)


def _with_z(linear: LinearPrinter, known: Known) -> Known:
    """Shape z too: from the best of x and y on, z alone."""
    rival = replace(known.rival, shapes_z=True)
    at, others = rival.names.index("z"), known.found.settings
    start, scans = linear.calibrated(rival)[[at]], [Scan([0], COMMON_FACTORS)]
    found = search(lambda z: linear.cost(rival, np.insert(others, at, z)), start, scans)
    return Known(rival, Optimum(np.insert(others, at, found.settings), found.cost))


def _pair(linear: LinearPrinter, known: Known) -> Pair:
    rival = known.rival
    calibrated = every.fixed(rival, linear.calibrated(rival), "calibrated", "as its firmware sets it.")
    best = every.fixed(rival, known.found.settings, "best fixed", SOUGHT)
    plain = type(rival) is Shaping and not rival.shapes_z
    return Pair(rival.label, "x, y and z" if rival.shapes_z else "x and y", calibrated, best, plain)


# ---- the inverse of one mode of each axis after a smooth shaper, as dderg's Kalico has it --------------


def mode_inverse(name: str, frequency_hz: float, mode_hz: float, damping_ratio: float) -> Shaper:
    """Return a smooth shaper followed by the inverse of one mode: u = x + (2ζ/ω) ẋ + ẍ/ω².

    So an axis with nothing but this mode follows the smoothed plan exactly. The derivatives are the kernel's:
    ẍ_s = ∫ w''(τ) x(t − τ) dτ + w'(−T/2) x(t + T/2) − w'(T/2) x(t − T/2). At constant speed the command runs ahead by
    the 2ζ/ω that such an axis lags behind, so the mean delay is not zero but minus that.

    Parameters
    ----------
    name, frequency_hz : of the kernel, one of `KERNELS`
    mode_hz, damping_ratio : of the mode that is inverted
    """
    omega, support = 2 * np.pi * mode_hz, KERNELS[name].support_periods / frequency_hz
    w = np.polynomial.Polynomial(KERNELS[name].coefficients[::-1])
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    at, share = nodes / 2, weights / 2
    area = share @ w(at)
    k1, k2 = 2 * damping_ratio / (omega * support), 1 / (omega * support) ** 2
    inside = share * (w(at) + k1 * w.deriv()(at) + k2 * w.deriv(2)(at))
    begin, end = k2 * w.deriv()(-0.5), -k2 * w.deriv()(0.5)
    amplitude = np.concatenate([[begin], inside, [end]]) / area
    mean = support * (share @ (w(at) * at)) / area
    return Shaper(amplitude, support * np.concatenate([[-0.5], at, [0.5]]) - mean)


@dataclass(frozen=True)
class ModeInverse(Shaping):
    """A smooth kernel and the mode inverted in x and y; z, if it is shaped, has the kernel alone."""

    @property
    def name(self) -> str:
        """The key of its method."""
        return f"{self.kind}-inverse{'-z' if self.shapes_z else ''}"

    @property
    def label(self) -> str:
        """The name in a table."""
        return f"{self.kind.upper()} + mode inverse{', z too' if self.shapes_z else ''}"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the settings."""
        return ("kernel x", "kernel y", *(("z",) if self.shapes_z else ()), "mode x", "mode y", DAMPING)

    @property
    def scans(self) -> tuple[Scan, ...]:
        """What is tried before the search steps along each setting."""
        return (Scan([0, 1], KERNEL_FACTORS), Scan([len(self.names) - 1], DAMPING_FACTORS))

    def shapers(self, settings: FloatArray) -> tuple[Shaper | None, ...]:
        """Return the shapers of x, y and z."""
        zeta, z = float(settings[-1]), KERNELS[self.kind](settings[2]) if self.shapes_z else None
        pairs = zip(settings[:2], settings[-3:-1], strict=True)
        return (*(mode_inverse(self.kind, float(hz), float(mode), zeta) for hz, mode in pairs), z)


class InversePrinter(LinearPrinter):
    """Evaluates inverses too; one that breaks a carriage's limit, or a peak of acceleration, does not count."""

    def __init__(
        self, machine: Machine, slices: Sequence[PrintSlice], peak_mm_per_s2: float = np.inf, span_s: float = SPANS_S[0]
    ) -> None:
        super().__init__(machine, slices)
        self._machine, self._peak_mm_per_s2, self._span_s = machine, peak_mm_per_s2, span_s

    def calibrated(self, shaping: Shaping) -> FloatArray:
        """Return a firmware's settings; the mode that is inverted is that of the kernel, as its firmware documents."""
        if not isinstance(shaping, ModeInverse):
            return super().calibrated(shaping)
        kernel = super().calibrated(Shaping(shaping.kind, shaping.shapes_z))
        return np.array([*kernel, *kernel[:2], DAMPING_RATIO])

    def cost(self, shaping: Shaping, settings: FloatArray) -> float:
        """Return the contour rms, µm; infinite where an inverse asks for too much."""
        commands = [piece.planned(*shaping.shapers(settings)).rows for piece in self.pieces]
        if isinstance(shaping, ModeInverse) and not all(map(self._possible, commands)):
            return np.inf
        return super().cost(shaping, settings)

    def _possible(self, command: FloatArray) -> bool:
        carriages, limits = self._machine.kinematics.inverse(command), self._machine.limits
        every = round(SPANS_S[0] / STEP_S)
        speed = np.diff(carriages[::every], axis=0) / SPANS_S[0]
        acceleration = np.diff(speed, axis=0) / SPANS_S[0]
        return bool(
            np.abs(speed).max(initial=0.0) <= limits.carriage_velocity_mm_per_s
            and np.abs(acceleration).max(initial=0.0) <= limits.carriage_acceleration_mm_per_s2
            and peak_acceleration(carriages, STEP_S, self._span_s) <= self._peak_mm_per_s2
        )

    def best(self, shaping: Shaping) -> Optimum:
        """Return the best settings; an inverse is sought from a kernel that is far quicker than the mode."""
        if not isinstance(shaping, ModeInverse):
            return super().best(shaping)
        begin = self.calibrated(shaping)
        modes = super().calibrated(Shaping("zv"))[:2]
        begin[:2], begin[-3:-1] = 3 * modes, modes
        return search(lambda settings: self.cost(shaping, settings), begin, shaping.scans)
