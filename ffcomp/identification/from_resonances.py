"""A starting machine file from resonances alone, as Klipper's own test measures them.

Power spectra hold no phase and no force: they do not separate masses from stiffnesses, nor the parts of the damping.
They do determine where the nozzle resonates and how sharply. So two parameters of the starting file are scaled: the
belts' stiffness until the main resonances lie at the measured ones, and the dampings until they are as sharp; the rest
stays the starting file's, with its uncertainty.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ffcomp.errors import SolverError
from ffcomp.identification.uncertainty import Estimate, Mode, lognormal
from ffcomp.measurement.frf import AXES
from ffcomp.record.page import RINGING
from models.machine import Machine, value_of, with_values

STIFFNESS = "carriage.belt_stiffness_n_per_m"
DAMPINGS = ("carriage.belt_damping_n_s_per_m", "carriage.guide_damping_n_s_per_m")
SCALES = np.geomspace(0.1, 10.0, 81)  # of the stiffness, searched before it is refined
MODEL_SD = 0.10  # of a frequency: the error of a model of two parameters


@dataclass(frozen=True, eq=False)
class ResonanceStart:
    """Numbers of a machine that are scaled to resonances."""

    estimates: dict[str, Estimate]
    predicted_hz: list[float]  # of each resonance, with these numbers


def belts_alone(start: Machine, read: Sequence[tuple[str, Estimate]]) -> ResonanceStart:
    """Scale the belts' stiffness until the main mode along each axis lies at its frequency in the middle of the bed.

    Raises SolverError if no stiffness within a factor of ten brings the model's resonances near.
    """
    weights = np.array([np.hypot(hz.relative_sd, MODEL_SD) ** -2.0 for _, hz in read])
    stiffness = value_of(start, STIFFNESS)

    def made(scale: float) -> list[float]:
        machine = with_values(start, {STIFFNESS: stiffness * scale})
        return [main_mode(machine, axis)[0] for axis, _ in read]

    def misfit(scale: float) -> float:
        return float(weights @ np.square(np.log(made(scale)) - np.log([hz.value for _, hz in read])))

    coarse = int(np.argmin([misfit(scale) for scale in SCALES]))
    if coarse in (0, len(SCALES) - 1):
        measured = ", ".join(f"{hz.value:.1f} Hz" for _, hz in read)
        raise SolverError(
            "No belt stiffness between a tenth and ten times the starting machine's brings its resonances to the "
            f"measured ones ({measured}): start from another machine."
        )
    scale = min(np.geomspace(float(SCALES[coarse - 1]), float(SCALES[coarse + 1]), 41).tolist(), key=misfit)
    spread = 2 / float(np.sqrt(weights.sum()))  # twice a frequency's relative uncertainty
    return ResonanceStart({STIFFNESS: lognormal(stiffness * scale, spread)}, made(scale))


def starting_machine(start: Machine, resonances: Sequence[tuple[str, Mode]]) -> ResonanceStart:
    """Scale the belts' stiffness, then both dampings, until the main modes are as measured in the middle of the bed.

    Raises SolverError as `belts_alone`.
    """
    belts = belts_alone(start, [(axis, mode.frequency_hz) for axis, mode in resonances]).estimates
    tuned = with_values(start, {key: e.value for key, e in belts.items()})
    # both are proportional to c + b while small
    ratios = [mode.damping_ratio.value / main_mode(tuned, axis)[1] for axis, mode in resonances]
    factor = float(np.clip(np.exp(np.mean(np.log(ratios))), 0.1, 10.0))
    relative = [mode.damping_ratio.relative_sd for _, mode in resonances]
    spread = float(np.hypot(np.sqrt(np.mean(np.square(relative)) / len(resonances)), 0.3))  # and the ratios' scatter
    estimates = belts | {name: lognormal(value_of(tuned, name) * factor, spread) for name in DAMPINGS}
    tuned = with_values(tuned, {key: e.value for key, e in estimates.items()})
    return ResonanceStart(estimates, [main_mode(tuned, axis)[0] for axis, _ in resonances])


def main_mode(machine: Machine, axis: str) -> tuple[float, float]:
    """Find the mode that rings and moves the nozzle most along the axis, Hz and damping ratio."""
    modes = machine.vibration.modes_at(np.array(machine.kinematics.centre_mm))
    most = int(np.argmax(np.abs(modes.nozzle[:, AXES.index(axis)]) * (modes.damping_ratios < RINGING)))
    return float(modes.frequencies_hz[most]), float(modes.damping_ratios[most])
