"""Every baseline at its best: as the firmware's own calibration sets it, and as a search finds it.

The search evaluates candidates on the print itself with the linear plant along the path; thousands of candidates would
be too many for the nonlinear printer, which evaluates the winners. Besides shapers for x and y there are the
variants of newer firmware and experiments:

-z          z is shaped too, as Marlin does
-inverse    a smooth shaper, then the inverse of one mode of each axis (dderg's Kalico)
-carriages  one shaper for each carriage, after the inverse kinematics (Klipper's pull request 2030, on a delta)

Each is set as its firmware would, and as serves this very print best: frequencies, damping ratio and, of an inverse,
those of kernel and mode apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ffcomp import shapers
from ffcomp.comparison.evaluation import SETTLE_S
from ffcomp.comparison.sampling import PrintSlice
from ffcomp.metrics import contour_error, rms
from ffcomp.shapers.apply import FrequencyOfPosition, shape_samples, shape_samples_by_frequency
from ffcomp.shapers.calibration import Spectrum, carriage_test_psd, fit, resonance_test_psd
from ffcomp.shapers.search import Fixed, Optimum, Scan, best_fixed, search
from ffcomp.shapers.smooth import KERNELS
from ffcomp.simulation.command import Motion
from ffcomp.simulation.linear import KEEP_EVERY, STEP_S, LinearPlayback, whole_steps
from models.arrays import FloatArray
from models.effects.catalogue import effective_machine
from models.machine import Machine

DAMPING_RATIOS = (0.05, 0.1)
MARGIN_STEPS = 400  # steps, 0.2 s: longer than half of any shaper above 7 Hz
SCAN_STRIDE = 2  # every so many slices serve for the scans, before the search goes on with all
SCHEDULE_FACTORS = np.geomspace(0.9, 2.4, 12)  # of a scheduled shaper's frequency to that of the mode at the position


class LinearPrinter:
    """Evaluate shapers on the plant's linear model along the path: quick, and near enough to choose by."""

    def __init__(self, plant: Machine, slices: Sequence[PrintSlice]) -> None:
        self._playback = LinearPlayback(effective_machine(plant))
        self.slices = [each for each in slices if each.trajectory.end_t > 2 * SETTLE_S]
        self.plans = [_sampled(each.motion) for each in self.slices]  # (MARGIN + n + MARGIN, 3) mm, STEP_S apart

    def contour_rms_um(self, motions: Sequence[Motion]) -> float:
        """Return the contour rms of one motion a slice of `self.slices`, µm."""
        return self.contour_rms_of_um([_sampled(each, 0) for each in motions])

    def contour_rms_of_um(self, commands: Sequence[FloatArray]) -> float:
        """Return the contour rms of commands (k, 3) mm, STEP_S apart, one a slice of `self.slices`, µm."""
        errors = np.concatenate([self._contour_of(s, c) for s, c in zip(self.slices, commands, strict=True)])
        return rms(errors) * 1e3

    def _contour_of(self, print_slice: PrintSlice, command: FloatArray) -> FloatArray:
        t = print_slice.motion.begin_t + STEP_S * np.arange(len(command), dtype=np.float64)
        nozzle, _ = self._playback.respond(command, np.gradient(command, STEP_S, axis=0))
        counted = slice(round(SETTLE_S / STEP_S), None, KEEP_EVERY)
        return contour_error(*print_slice.corners, t[1:][counted], nozzle[counted])

    def best_fixed(self, kind: str) -> Fixed:
        """Find the frequencies and damping ratio of one kind with the least contour rms."""

        def command(plan: FloatArray, x: shapers.Shaper, y: shapers.Shaper) -> FloatArray:
            return np.ascontiguousarray(shape_samples(plan, (x, y, None), STEP_S, MARGIN_STEPS))

        def cost(x: shapers.Shaper, y: shapers.Shaper) -> float:
            return self.contour_rms_of_um([command(plan, x, y) for plan in self.plans])

        def scanned(x: shapers.Shaper, y: shapers.Shaper) -> float:
            some = zip(self.slices[::SCAN_STRIDE], self.plans[::SCAN_STRIDE], strict=True)
            return rms(np.concatenate([self._contour_of(each, command(plan, x, y)) for each, plan in some]))

        return best_fixed(kind, cost, (25.0, 100.0), DAMPING_RATIOS, scanned=scanned)

    def best_factor(self, kind: str, of_position: FrequencyOfPosition) -> float:
        """Find the ratio of a scheduled shaper's frequency to the mode's with the least contour rms."""
        frequencies = [of_position(plan[MARGIN_STEPS:-MARGIN_STEPS, :2].copy()) for plan in self.plans]

        def cost(factor: float) -> float:
            each = zip(self.plans, frequencies, strict=True)
            return self.contour_rms_of_um(
                [
                    shape_samples_by_frequency(plan, factor * each_hz, kind, STEP_S, MARGIN_STEPS)
                    for plan, each_hz in each
                ]
            )

        return float(min(SCHEDULE_FACTORS, key=cost))


def _sampled(motion: Motion, margin: int = MARGIN_STEPS) -> FloatArray:
    steps = whole_steps(motion.end_t - motion.begin_t)
    t = motion.begin_t + STEP_S * np.arange(-margin, steps + 1 + margin, dtype=np.float64)
    return np.ascontiguousarray(motion.position(t))


def shaped(motion: Motion, x: shapers.Shaper, y: shapers.Shaper) -> Motion:
    """Execute a motion as a firmware with input shapers does: each axis convolved, no delay at constant speed."""
    return replace(motion, position=lambda t: shapers.shape(motion.position, t, x, y))


def shaped_by_position(motion: Motion, frequency_of_position: FrequencyOfPosition, kind: str) -> Motion:
    """Shape a motion with the frequency of the position where the plan is at each time."""
    return replace(motion, position=lambda t: shapers.scheduled_shape(motion.position, t, frequency_of_position, kind))


def resonance_tests(plant: Machine) -> list[Spectrum]:
    """Return the firmware's own tests of x and y in the middle of the bed: all kinds of shapers are set by them."""
    return [resonance_test_psd(effective_machine(plant), np.zeros(2), axis) for axis in ("x", "y")]


SHAPED_Z, INVERSE, CARRIAGES = "-z", "-inverse", "-carriages"
OF_ALL, OF_SMOOTH = (SHAPED_Z, CARRIAGES), (INVERSE, INVERSE + SHAPED_Z)
VARIANT_NAMES = tuple(
    kind + variant for kind in shapers.SHAPERS for variant in (OF_ALL + OF_SMOOTH if kind in KERNELS else OF_ALL)
)
LABELS = {
    SHAPED_Z: ", z too",
    CARRIAGES: ", each carriage",
    INVERSE: " + mode inverse",
    INVERSE + SHAPED_Z: " + mode inverse, z too",
}
COMMON_FACTORS = (0.65, 0.75, 0.87, 1.15, 1.32, 1.52, 1.75, 2.0)  # factors of all frequencies at once
KERNEL_FACTORS = (0.33, 0.42, 0.55, 0.75, 1.3)  # of an inverse, whose kernel may be much quicker than the mode
DAMPING = "damping ratio"
DAMPING_FACTORS = (0.4, 0.6, 1.5, 2.2)  # factors
DIFFERENCE_S = 0.004  # over which accelerations of commands are told everywhere


@dataclass(frozen=True, slots=True)
class ShaperVariant:
    """One kind of shaper in one variant, and what its k settings are."""

    kind: str
    variant: str  # "" for x and y only
    names: tuple[str, ...]  # of the settings, as a tuning sentence says them
    scans: tuple[Scan, ...]

    @property
    def smooth(self) -> bool:
        """Whether its kernel is made for one damping ratio."""
        return self.kind in KERNELS

    @property
    def inverse(self) -> bool:
        """Whether a mode is inverted."""
        return self.variant.startswith(INVERSE)

    @property
    def shapes_z(self) -> bool:
        """Whether z is shaped too."""
        return self.variant.endswith(SHAPED_Z)

    @property
    def label(self) -> str:
        """As a table says it."""
        return self.kind.upper() + LABELS.get(self.variant, "")

    def settings_text(self, settings: FloatArray) -> str:
        """Return the settings in words."""
        return ", ".join(
            f"{name} {value:.2f}" if name == DAMPING else f"{name} {value:.1f} Hz"
            for name, value in zip(self.names, settings, strict=True)
        )

    def shapers(self, settings: FloatArray) -> Sequence[shapers.Shaper | None]:
        """Return the shapers of x, y and z, or of the carriages."""
        zeta = float(settings[-1]) if DAMPING in self.names else shapers.DAMPING_RATIO
        count = 3 if self.shapes_z or self.variant == CARRIAGES else 2
        each = [shapers.SHAPERS[self.kind](float(hz), zeta) for hz in settings[:count]]
        if self.inverse:
            pairs = zip(settings[:2], settings[-3:-1], strict=True)
            each[:2] = [shapers.mode_inverse(self.kind, float(hz), float(mode), zeta) for hz, mode in pairs]
        return (*each, None)[:3]


def kind_and_variant(name: str) -> tuple[str, str]:
    """Return kind and variant of a method's name without its tuning."""
    kind, dash, variant = name.partition("-")
    return kind, dash + variant


def shaper_variant(kind: str, variant: str, machine: Machine) -> ShaperVariant:
    """Return a kind of shaper, of `SHAPERS`, in a variant: "", one of `OF_ALL`, or of a smooth kind `OF_SMOOTH`."""
    z, inverse = ("z",) if variant.endswith(SHAPED_Z) else (), variant.startswith(INVERSE)
    if variant == CARRIAGES:
        names: tuple[str, ...] = machine.kinematics.actuator_names
    elif inverse:
        names = ("kernel x", "kernel y", *z, "mode x", "mode y")
    else:
        names = ("x", "y", *z)
    scans = [Scan(range(len(names)), COMMON_FACTORS)]
    if inverse:
        scans.append(Scan([0, 1], KERNEL_FACTORS))
    if kind not in KERNELS or inverse:
        names = (*names, DAMPING)
        scans.append(Scan([len(names) - 1], DAMPING_FACTORS))
    return ShaperVariant(kind, variant, names, tuple(scans))


def shaped_by_variant(variant: ShaperVariant, motion: Motion, settings: FloatArray, machine: Machine) -> Motion:
    """Shape a motion as the machine's firmware does."""
    first, second, third = variant.shapers(settings)
    if variant.variant != CARRIAGES:
        return replace(motion, position=lambda t: shapers.shape(motion.position, t, first, second, third))
    assert first and second and third
    compiled, each = machine.kinematics.compiled(), (first, second, third)
    return replace(motion, position=lambda t: shapers.shape_carriages(motion.position, t, compiled, each))


# ---- their settings ------------------------------------------------------------------------------


class VariantTuner:
    """The settings of every variant on one plant and print."""

    def __init__(self, machine: Machine, plant: Machine, linear: LinearPrinter) -> None:
        self._machine, self._linear = machine, linear
        self._compiled = machine.kinematics.compiled()
        self._plant, self._middle = effective_machine(plant), np.array(plant.kinematics.centre_mm, dtype=float)
        self._known: dict[tuple[str, int, bool], float] = {}  # frequencies that were fitted
        self._plans = [(nozzle, self._compiled.inverse(nozzle)) for nozzle in linear.plans]

    @cached_property
    def _axes(self) -> list[Spectrum]:
        return [resonance_test_psd(self._plant, self._middle, axis) for axis in ("x", "y", "z")]

    @cached_property
    def _carriages(self) -> list[Spectrum]:
        return [carriage_test_psd(self._plant, self._middle, k) for k in range(3)]

    def calibrated(self, variant: ShaperVariant) -> FloatArray:
        """Return the settings that a firmware's calibration finds in the middle of the bed.

        The mode that is inverted is that of the kernel, as in the example of the firmware that has it.
        """
        spectra = self._carriages if variant.variant == CARRIAGES else self._axes
        count = 3 if variant.variant == CARRIAGES or variant.shapes_z else 2
        each = [self._fitted(variant.kind, k, spectra) for k in range(count)]
        if variant.inverse:
            each += each[:2]
        return np.array([*each, shapers.DAMPING_RATIO] if DAMPING in variant.names else each)

    def _fitted(self, kind: str, index: int, spectra: list[Spectrum]) -> float:
        key = (kind, index, spectra is self._carriages)
        if key not in self._known:
            self._known[key] = fit(kind, spectra[index]).frequency_hz
        return self._known[key]

    def cost(self, variant: ShaperVariant, settings: FloatArray) -> float:
        """Return the contour rms on the linear plant, µm; infinite where an inverse breaks a carriage's limit."""
        commands = [self._command(variant, settings, plan) for plan in self._plans]
        if variant.inverse and not all(map(self._possible, commands)):
            return float("inf")
        return self._linear.contour_rms_of_um(commands)

    def _command(self, variant: ShaperVariant, settings: FloatArray, plan: tuple[FloatArray, FloatArray]) -> FloatArray:
        nozzle, carriages = plan
        each = variant.shapers(settings)
        if variant.variant == CARRIAGES:
            return self._compiled.forward(np.ascontiguousarray(shape_samples(carriages, each, STEP_S, MARGIN_STEPS)))
        return np.ascontiguousarray(shape_samples(nozzle, each, STEP_S, MARGIN_STEPS))

    def _possible(self, command: FloatArray) -> bool:
        carriages = self._compiled.inverse(command[:: round(DIFFERENCE_S / STEP_S)])
        speed = np.diff(carriages, axis=0) / DIFFERENCE_S
        acceleration = np.diff(speed, axis=0) / DIFFERENCE_S
        most = self._machine.limits
        return bool(
            np.abs(speed).max(initial=0.0) <= most.carriage_velocity_mm_per_s
            and np.abs(acceleration).max(initial=0.0) <= most.carriage_acceleration_mm_per_s2
        )

    def best(
        self, variant: ShaperVariant, start: FloatArray | None = None, free: Sequence[int] | None = None
    ) -> Optimum:
        """Return the settings with the least contour rms on this print, and that.

        The search begins at `start`, or at the calibrated ones, and may change the `free` ones, or all.
        """

        def cost(settings: FloatArray) -> float:
            return self.cost(variant, settings)

        if start is not None:
            return search(cost, start, variant.scans if free is None else (Scan(free, COMMON_FACTORS),), free)
        settings, scans = self.calibrated(variant), variant.scans
        if variant.inverse:  # from the calibrated one it ends at a kernel that is nearly a shaper: begin far quicker
            modes = [self._fitted("zv", k, self._axes) for k in range(2)]
            settings[:2], settings[-3:-1], scans = 3 * np.array(modes), modes, scans[1:]
        return search(cost, settings, scans)
