"""What newer firmware and experiments do beyond shapers for x and y: shape z too, invert a mode, shape carriages.

-z          z is shaped too, as Marlin does
-inverse    a smooth shaper, then the inverse of one mode of each axis (dderg's Kalico)
-carriages  one shaper for each carriage, after the inverse kinematics (Klipper's pull request 2030, on a delta)

Each as its firmware would set it, and with the settings that serve this very print best, sought from there on the
linear plant: frequencies, damping ratio and, of an inverse, those of kernel and mode apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ffcomp import shapers
from ffcomp.compare.baselines import MARGIN, LinearPrinter
from ffcomp.shapers.calibration import Spectrum, carriage_test_psd, fit, resonance_test_psd
from ffcomp.shapers.grid import shape_samples
from ffcomp.shapers.pattern import Found, Scan, search
from ffcomp.shapers.smooth import KERNELS
from ffcomp.simulate.linear import STEP_S
from ffcomp.simulate.motion import Motion
from models.arrays import FloatArray
from models.effects.catalogue import effective_machine
from models.machine import Machine

SHAPED_Z, INVERSE, CARRIAGES = "-z", "-inverse", "-carriages"
OF_ALL, OF_SMOOTH = (SHAPED_Z, CARRIAGES), (INVERSE, INVERSE + SHAPED_Z)
NAMES = tuple(
    kind + variant for kind in shapers.SHAPERS for variant in (OF_ALL + OF_SMOOTH if kind in KERNELS else OF_ALL)
)
LABELS = {
    SHAPED_Z: ", z too",
    CARRIAGES: ", each carriage",
    INVERSE: " + mode inverse",
    INVERSE + SHAPED_Z: " + mode inverse, z too",
}
TOGETHER = (0.65, 0.75, 0.87, 1.15, 1.32, 1.52, 1.75, 2.0)  # factors of all frequencies at once
KERNEL_ALONE = (0.33, 0.42, 0.55, 0.75, 1.3)  # of an inverse, whose kernel may be much quicker than the mode
DAMPING = "damping ratio"
DAMPINGS = (0.4, 0.6, 1.5, 2.2)  # factors
PEAK_S = 0.004  # over which accelerations of commands are told everywhere


@dataclass(frozen=True, slots=True)
class Rival:
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

    def said(self, settings: FloatArray) -> str:
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


def parsed(name: str) -> tuple[str, str]:
    """Return kind and variant of a method's name without its tuning."""
    kind, dash, variant = name.partition("-")
    return kind, dash + variant


def rival(kind: str, variant: str, machine: Machine) -> Rival:
    """Return one kind of shaper in one variant.

    Parameters
    ----------
    kind : str
        A name in `SHAPERS`.
    variant : str
        "" or one of `OF_ALL` or, for a smooth kind, `OF_SMOOTH`.
    machine : Machine
        Whose carriages they are.
    """
    z = ("z",) if variant.endswith(SHAPED_Z) else ()
    if variant == CARRIAGES:
        names: tuple[str, ...] = machine.kinematics.actuator_names
    elif variant.startswith(INVERSE):
        names = ("kernel x", "kernel y", *z, "mode x", "mode y")
    else:
        names = ("x", "y", *z)
    scans = [Scan(range(len(names)), TOGETHER)]
    if variant.startswith(INVERSE):
        scans.append(Scan([k for k, name in enumerate(names) if name.startswith("kernel")], KERNEL_ALONE))
    if kind not in KERNELS or variant.startswith(INVERSE):
        names = (*names, DAMPING)
        scans.append(Scan([len(names) - 1], DAMPINGS))
    return Rival(kind, variant, names, tuple(scans))


def shaped(rival: Rival, motion: Motion, settings: FloatArray, machine: Machine) -> Motion:
    """Shape a motion as the machine's firmware does."""
    first, second, third = rival.shapers(settings)
    if rival.variant != CARRIAGES:
        return replace(motion, position=lambda t: shapers.shape(motion.position, t, first, second, third))
    assert first and second and third
    compiled, each = machine.kinematics.compiled(), (first, second, third)
    return replace(motion, position=lambda t: shapers.shape_carriages(motion.position, t, compiled, each))


# ---- their settings ------------------------------------------------------------------------------


class Tuner:
    """The settings of every rival on one plant and print."""

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

    def calibrated(self, rival: Rival) -> FloatArray:
        """Return the settings that a firmware's calibration finds in the middle of the bed.

        The mode that is inverted is that of the kernel, as in the example of the firmware that has it.
        """
        spectra = self._carriages if rival.variant == CARRIAGES else self._axes
        count = 3 if rival.variant == CARRIAGES or rival.shapes_z else 2
        each = [self._fitted(rival.kind, k, spectra) for k in range(count)]
        if rival.inverse:
            each += each[:2]
        return np.array([*each, shapers.DAMPING_RATIO] if DAMPING in rival.names else each)

    def _fitted(self, kind: str, index: int, spectra: list[Spectrum]) -> float:
        key = (kind, index, spectra is self._carriages)
        if key not in self._known:
            self._known[key] = fit(kind, spectra[index]).frequency_hz
        return self._known[key]

    def cost(self, rival: Rival, settings: FloatArray) -> float:
        """Return the contour rms on the linear plant, µm; infinite where an inverse breaks a carriage's limit."""
        commands = [self._command(rival, settings, plan) for plan in self._plans]
        if rival.inverse and not all(map(self._possible, commands)):
            return float("inf")
        return self._linear.contour_rms_of_um(commands)

    def _command(self, rival: Rival, settings: FloatArray, plan: tuple[FloatArray, FloatArray]) -> FloatArray:
        nozzle, carriages = plan
        each = rival.shapers(settings)
        if rival.variant == CARRIAGES:
            return self._compiled.forward(np.ascontiguousarray(shape_samples(carriages, each, STEP_S, MARGIN)))
        return np.ascontiguousarray(shape_samples(nozzle, each, STEP_S, MARGIN))

    def _possible(self, command: FloatArray) -> bool:
        carriages = self._compiled.inverse(command[:: round(PEAK_S / STEP_S)])
        speed = np.diff(carriages, axis=0) / PEAK_S
        acceleration = np.diff(speed, axis=0) / PEAK_S
        most = self._machine.limits
        return bool(
            np.abs(speed).max(initial=0.0) <= most.carriage_velocity_mm_per_s
            and np.abs(acceleration).max(initial=0.0) <= most.carriage_acceleration_mm_per_s2
        )

    def best(self, rival: Rival, start: FloatArray | None = None, free: Sequence[int] | None = None) -> Found:
        """Return the settings with the least contour rms on this print, and that.

        Parameters
        ----------
        rival : Rival
        start : (k,) array, optional
            None: the calibrated ones.
        free : sequence of int, optional
            Settings that may change; None: all.
        """

        def cost(settings: FloatArray) -> float:
            return self.cost(rival, settings)

        if start is not None:
            return search(cost, start, rival.scans if free is None else (Scan(free, TOGETHER),), free)
        if rival.inverse:  # from the calibrated one it ends at a kernel that is nearly a shaper
            return search(cost, self._quick_kernel(rival), rival.scans[1:])
        return search(cost, self.calibrated(rival), rival.scans)

    def _quick_kernel(self, rival: Rival) -> FloatArray:
        """Return settings whose kernel is far quicker than the mode, which is what ZV's calibration finds."""
        settings = self.calibrated(rival)
        modes = [self._fitted("zv", k, self._axes) for k in range(2)]
        settings[:2] = 3 * np.array(modes)
        settings[-3:-1] = modes
        return settings
