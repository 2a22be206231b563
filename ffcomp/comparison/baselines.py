"""Every input shaper at its best: as the firmware's own calibration sets it, and as a search finds it.

The search evaluates candidates on the print itself with the linear plant along the path; thousands of candidates would
be too many for the nonlinear printer, which evaluates the winners. Besides shapers of x and y there are those of x, y
and z (`-z`), as Marlin has them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from ffcomp import shapers
from ffcomp.comparison.sampling import SETTLE_S, PrintSlice
from ffcomp.shapers.calibration import Axis, fit, resonance_test_psd
from ffcomp.shapers.search import Optimum, Scan, search
from ffcomp.shapers.smooth import KERNELS
from ffcomp.simulation.command import Motion
from ffcomp.simulation.expectation import MARGIN, Commanded, Piece, errors_um
from ffcomp.simulation.linear import STEP_S, LinearPlayback, whole_steps
from models.arrays import FloatArray
from models.effects.catalogue import effective_machine
from models.machine import Machine

SHAPED_Z = "-z"  # after a kind
SHAPER_NAMES = (*shapers.SHAPERS, *(kind + SHAPED_Z for kind in shapers.SHAPERS))
COMMON_FACTORS = (0.65, 0.75, 0.87, 1.15, 1.32, 1.52, 1.75, 2.0)  # factors of all frequencies at once
DAMPING = "damping ratio"
DAMPING_FACTORS = (0.4, 0.6, 1.5, 2.2)  # factors


@dataclass(frozen=True)
class Shaping:
    """One kind of shaper for x and y, or for z too, and what its k settings are."""

    kind: str
    shapes_z: bool = False

    @classmethod
    def of(cls, name: str) -> Shaping:
        """Return the shaping of a name in `SHAPER_NAMES`."""
        return cls(name.removesuffix(SHAPED_Z), name.endswith(SHAPED_Z))

    @property
    def name(self) -> str:
        """The key of its method."""
        return self.kind + (SHAPED_Z if self.shapes_z else "")

    @property
    def label(self) -> str:
        """The name in a table."""
        return self.kind.upper() + (", z too" if self.shapes_z else "")

    @property
    def axes(self) -> tuple[Axis, ...]:
        """Axes that are shaped."""
        return ("x", "y", "z") if self.shapes_z else ("x", "y")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the settings; the kernel of a smooth shaper is made for one damping ratio."""
        return self.axes if self.kind in KERNELS else (*self.axes, DAMPING)

    @property
    def scans(self) -> tuple[Scan, ...]:
        """The trials before the search steps along each setting."""
        frequencies = Scan(range(len(self.axes)), COMMON_FACTORS)
        return (frequencies,) if self.kind in KERNELS else (frequencies, Scan([len(self.axes)], DAMPING_FACTORS))

    def settings_text(self, settings: FloatArray) -> str:
        """Return the settings in words."""
        return ", ".join(
            f"{name} {value:.2f}" if name == DAMPING else f"{name} {value:.1f} Hz"
            for name, value in zip(self.names, settings, strict=True)
        )

    def shapers(self, settings: FloatArray) -> tuple[shapers.Shaper | None, ...]:
        """Return the shapers of x, y and z."""
        zeta = float(settings[-1]) if DAMPING in self.names else shapers.DAMPING_RATIO
        each = [shapers.SHAPERS[self.kind](float(hz), zeta) for hz in settings[: len(self.axes)]]
        return (*each, None)[:3]


class LinearPrinter:
    """Evaluate shapers on the plant's linear model along the path: quick, and near enough to choose by."""

    def __init__(self, plant: Machine, slices: Sequence[PrintSlice]) -> None:
        self._plant, self._middle = effective_machine(plant), np.array(plant.kinematics.centre_mm, dtype=float)
        self._playback = LinearPlayback(self._plant)
        self._spectrum = cache(partial(resonance_test_psd, self._plant, self._middle))  # along an axis
        self.pieces = [_piece(each) for each in slices if each.trajectory.end_t > 2 * SETTLE_S]

    def contour_rms_um(self, commanded: Callable[[Piece], Commanded]) -> float:
        """Return the contour rms of a command of every piece, µm."""
        return float(errors_um(self.pieces, [self._playback], commanded)[0])

    def calibrated(self, shaping: Shaping) -> FloatArray:
        """Return the settings that a firmware's calibration finds in the middle of the bed."""
        frequencies = [fit(shaping.kind, self._spectrum(axis)).frequency_hz for axis in shaping.axes]
        return np.array([*frequencies, shapers.DAMPING_RATIO] if DAMPING in shaping.names else frequencies)

    def cost(self, shaping: Shaping, settings: FloatArray) -> float:
        """Return the contour rms of the shaped print, µm."""
        by_axis = shaping.shapers(settings)
        return self.contour_rms_um(lambda piece: piece.planned(*by_axis))

    def best(self, shaping: Shaping) -> Optimum:
        """Return the settings with the least contour rms on this print, sought from the calibrated ones, and that."""
        return search(lambda settings: self.cost(shaping, settings), self.calibrated(shaping), shaping.scans)


def _piece(print_slice: PrintSlice) -> Piece:
    """Return a slice as a piece whose command is its plan."""
    motion = print_slice.motion
    steps = whole_steps(motion.end_t - motion.begin_t)
    t = motion.begin_t + STEP_S * np.arange(-MARGIN, steps + 1 + MARGIN, dtype=np.float64)
    plan, inside = motion.position(t), slice(MARGIN, -MARGIN)
    return Piece(*print_slice.corners, motion.begin_t, plan, t[inside], plan[inside], SETTLE_S)


def shaped(motion: Motion, *by_axis: shapers.Shaper | None) -> Motion:
    """Execute a motion as a firmware with input shapers does: each axis convolved, no delay at constant speed."""
    return replace(motion, position=lambda t: shapers.shape(motion.position, t, *by_axis))
