"""Choose between the path and the robust reference by what the machine file says of its own numbers.

One number decides: the relative standard deviation of the modes' frequencies that would make the response as uncertain
as the file's `[uncertainty]` does. Every parameter counts by what it changes of G, where a print excites it. Below some
value robust inversion gains nothing to speak of. Above another, half the printers are so far from the file that no
command suits them all, the median gains nothing any more, and a printer that is as its file says loses much
(studies/reports/robust.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ffcomp.inverse.sensitivity import machines_off
from ffcomp.inverse.settings import Settings
from models.arrays import ComplexArray, FloatArray
from models.machine import Machine

PAYS = (0.02, 0.1)  # of the modes: where the median gains, and peaks of the command stay near the plan's
STEP = 0.01  # relative, small: what counts is the slope
LINES, LOWEST_HZ = 60, 5.0
BEYOND = 1.5  # times the bandwidth, up to which the response counts


@dataclass(frozen=True, slots=True)
class RobustChoice:
    """Whether to invert robustly, and why."""

    robust: bool
    reason: str


PLAIN = RobustChoice(False, "Plain inversion: nothing else was asked for.")
BOUNDED = RobustChoice(True, "Robust inversion, as always under a bound on the error.")


def choose_robust(machine: Machine, settings: Settings, asked: bool | None = None) -> RobustChoice:
    """Choose for a machine. asked : by the user; None: by the machine file."""
    if asked is not None:
        return RobustChoice(asked, f"{'Robust' if asked else 'Plain'} inversion, as it was asked for.")
    sd = mode_sd(machine, settings.bandwidth_hz)
    known = f"by its [uncertainty] the machine file knows its modes to {100 * sd:.2g} %"
    if not PAYS[0] <= sd <= PAYS[1]:
        least, most = (f"{100 * each:g}" for each in PAYS)
        return RobustChoice(False, f"Plain inversion: {known}; --robust pays from {least} to {most} %.")
    return RobustChoice(True, f"Robust inversion: {known}. If the file is exact: --no-robust.")


def mode_sd(machine: Machine, bandwidth_hz: float) -> float:
    """Return the relative standard deviation of all modes together that makes the response as uncertain as it is."""
    most = max(machine.uncertainty.values(), default=0.0)
    if most == 0.0:
        return 0.0
    f = np.geomspace(LOWEST_HZ, BEYOND * bandwidth_hz, LINES)
    scaled = {name: STEP / most * value for name, value in machine.uncertainty.items()}
    own, *off = (_response(each, f) for each in machines_off(replace(machine, uncertainty=scaled)))
    return most * _spread(own, off, f) / _spread(own, [_response(machine, f / (1.0 + STEP))], f)


def _response(machine: Machine, f: FloatArray) -> ComplexArray:
    return machine.vibration.frequency_response(np.zeros(2), f, "nozzle", "nozzle")


def _spread(own: ComplexArray, off: Sequence[ComplexArray], f: FloatArray) -> float:
    """Return the root of the summed square of the changes, for acceleration that is alike at all frequencies."""
    squares = [np.sum(np.abs(np.linalg.solve(own, each - own)) ** 2, axis=(1, 2)) for each in off]
    return float(np.sqrt(np.trapezoid(np.sum(squares, axis=0) / f**4, f))) if off else 0.0
