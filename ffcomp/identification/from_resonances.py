"""A starting machine file from resonances alone, as Klipper's own test measures them.

Power spectra hold no phase and no force: they do not separate masses from stiffnesses, nor the parts of the damping.
They do determine where the nozzle resonates and how sharply. So two parameters of the starting file are scaled: the
belts' stiffness until the main resonances lie at the measured ones, and the dampings until they are as sharp; the rest
stays the starting file's, with its uncertainty.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ffcomp.errors import SolverError
from ffcomp.identification.uncertainty import Estimate, lognormal
from ffcomp.measurement.frf import AXES
from models.arrays import FloatArray
from models.machine import Machine, value_of, with_values

STIFFNESS = "carriage.belt_stiffness_n_per_m"
DAMPINGS = ("carriage.belt_damping_n_s_per_m", "carriage.guide_damping_n_s_per_m")
SCALES = np.geomspace(0.1, 10.0, 81)  # of the stiffness, searched before it is refined
RINGING = 0.3  # damping ratio: more, and a mode does not ring
BAND_HZ = np.arange(8.0, 160.0, 0.25)
MODEL_SD = 0.10  # of a frequency: the error of a model of two parameters


@dataclass(frozen=True)
class Resonance:
    """The main mode of one measurement."""

    axis: str  # x, y or z of the nozzle
    place_mm: tuple[float, float]
    frequency_hz: Estimate
    damping_ratio: Estimate


@dataclass(frozen=True, eq=False)
class ResonanceStart:
    """A starting machine scaled to resonances."""

    machine: Machine
    estimates: dict[str, Estimate]
    predicted_hz: list[float]  # of each resonance, by the tuned machine


def starting_machine(
    start: Machine, resonances: Sequence[Resonance], main: Callable[[Machine, Resonance], float] | None = None
) -> ResonanceStart:
    """Scale the starting machine to the resonances, which are those of `main` in a machine: of spectra, their peaks.

    Raises
    ------
    SolverError
        If no stiffness within a factor of ten brings the model's resonances near.
    """
    if not resonances:
        raise SolverError("None of the measurements shows a clear mode; there is nothing to tune a machine to.")
    stiffness, main = value_of(start, STIFFNESS), main or _main
    misfits = [_misfit(with_values(start, {STIFFNESS: stiffness * scale}), resonances, main) for scale in SCALES]
    nearest = int(np.argmin(misfits))
    if nearest in (0, len(SCALES) - 1):
        measured = ", ".join(f"{r.frequency_hz.value:.1f} Hz" for r in resonances)
        raise SolverError(
            "No belt stiffness between a tenth and ten times the starting machine's brings its resonances to the "
            f"measured ones ({measured}): start from another machine."
        )
    fine = np.geomspace(float(SCALES[nearest - 1]), float(SCALES[nearest + 1]), 41)
    misfits = [_misfit(with_values(start, {STIFFNESS: stiffness * scale}), resonances, main) for scale in fine]
    scale = float(fine[np.argmin(misfits)])
    tuned = with_values(start, {STIFFNESS: stiffness * scale})
    factor = _damping_factor(tuned, resonances)
    dampings = {name: value_of(tuned, name) * factor for name in DAMPINGS}
    tuned = with_values(tuned, dampings)
    return ResonanceStart(
        tuned, _estimates(stiffness * scale, dampings, resonances), [main(tuned, r) for r in resonances]
    )


def _misfit(machine: Machine, resonances: Sequence[Resonance], main: Callable[[Machine, Resonance], float]) -> float:
    return sum((np.log(main(machine, r) / r.frequency_hz.value) / _sd(r)) ** 2 for r in resonances)


def _sd(r: Resonance) -> float:
    return float(np.hypot(r.frequency_hz.relative_sd, MODEL_SD))


def _main(machine: Machine, r: Resonance) -> float:
    """Find where the nozzle responds most along the axis, Hz."""
    i = AXES.index(r.axis)
    size = np.abs(machine.vibration.frequency_response(np.array(r.place_mm), BAND_HZ, "nozzle", "nozzle")[:, i, i])
    return float(BAND_HZ[np.argmax(size)])


def ringing_mode(machine: Machine, r: Resonance) -> float:
    """Find the mode that rings and moves the nozzle most along the axis, Hz: a drive's own peak is none of them."""
    modes = machine.vibration.modes_at(np.array(r.place_mm))
    size = np.abs(modes.nozzle[:, AXES.index(r.axis)]) * (modes.damping_ratios < RINGING)
    return float(modes.frequencies_hz[np.argmax(size)])


def _damping_factor(machine: Machine, resonances: Sequence[Resonance]) -> float:
    """Average the ratio of measured to modelled damping ratio; both are proportional to c + b while small."""
    ratios = []
    for r in resonances:
        modes = machine.vibration.modes_at(np.array(r.place_mm))
        nearest = int(np.argmin(np.abs(np.log(modes.frequencies_hz / _main(machine, r)))))
        ratios.append(r.damping_ratio.value / modes.damping_ratios[nearest])
    return float(np.clip(np.exp(np.mean(np.log(ratios))), 0.1, 10.0))


def _estimates(stiffness: float, dampings: dict[str, float], resonances: Sequence[Resonance]) -> dict[str, Estimate]:
    """Take twice a frequency's relative uncertainty for the stiffness; the ratios' scatter for the dampings."""
    weight: FloatArray = np.array([1 / _sd(r) ** 2 for r in resonances])
    relative = [r.damping_ratio.relative_sd for r in resonances]
    spread = float(np.hypot(np.sqrt(np.mean(np.square(relative)) / len(resonances)), 0.3))
    estimates = {STIFFNESS: lognormal(stiffness, 2 / float(np.sqrt(weight.sum())))}
    return estimates | {name: lognormal(value, spread) for name, value in dampings.items()}
