"""The faults of recordings that make a search pointless: an input shaper left on, a sensor that does not measure.

Both look like huge effects of the machine. What makes a fault, and its sentence, stands in
`ffcomp.measurement.faults`; no simulation is needed beyond that of the machine file.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ffcomp.diagnosis.fit import EstimationProblem, Fit
from ffcomp.measurement.faults import (
    BadSensor,
    GapSpectra,
    NormalEquations,
    ShapersLeftOn,
    clipped_against,
    shaper_in_gap,
)
from models.arrays import FloatArray

Fault = ShapersLeftOn | BadSensor

SHAPED = 3.0  # noise power: with a larger discrepancy an input shaper is looked for
ONE_SIGNAL = 0.85  # of the discrepancy, in one signal of three or more: its sensor is at fault


def fault_of_recordings(estimation: EstimationProblem, simulated: Sequence[FloatArray], retuned: Fit) -> Fault | None:
    """Return a fault that makes any search pointless: a clipped sensor, or a shaper.

    simulated : (n, m) an observation with the machine file.
    """
    return shaper_on(estimation, simulated, retuned) or clipped_sensor(estimation, simulated)


def shaper_on(estimation: EstimationProblem, simulated: Sequence[FloatArray], retuned: Fit) -> ShapersLeftOn | None:
    """Return the shaper that explains most of the discrepancy far better than retuning does; None if none does."""
    if not estimation.problem.commanded:
        return None
    filed = estimation.measured - estimation.whiten(simulated)
    if min(float(filed @ filed), retuned.chi_squared) < (1 + SHAPED) * len(filed):
        return None
    names = frozenset(name for o in estimation.whiten.observations for name in o.signals)
    axes = {axis: frozenset(name for name in names if name.endswith(f"_{axis}")) for axis in "xy"}
    spectra = {axis: _spectra(estimation, simulated, signals) for axis, signals in axes.items() if all(axes.values())}
    return shaper_in_gap(_spectra(estimation, simulated, names), spectra, retuned.chi_squared)


def _spectra(estimation: EstimationProblem, simulated: Sequence[FloatArray], signals: frozenset[str]) -> GapSpectra:
    """Sum up the whitened spectra of these signals: observations as long as each other share their frequencies."""
    whiten = estimation.whiten
    sums: dict[bytes, NormalEquations] = {}
    noise = 0.0
    for o, y in zip(whiten.observations, simulated, strict=True):
        (m, frequency), (s, _) = whiten.spectrum(o, o.measured), whiten.spectrum(o, y)
        scale = np.sqrt(np.stack([whiten.floor.at(name, frequency) for name in o.signals]) * whiten.power(o))
        for i, name in enumerate(o.signals):
            if name in signals:
                grid = frequency.tobytes()
                one = NormalEquations.of(frequency, m[i] / scale[i], (s[i] / scale[i])[:, None])
                sums[grid] = sums[grid] + one if grid in sums else one
                noise += 2.0 * len(frequency)
    return GapSpectra(tuple(sums.values()), noise)


def clipped_sensor(estimation: EstimationProblem, simulated: Sequence[FloatArray]) -> BadSensor | None:
    """Return a sensor that stands at its largest value while its simulation goes far beyond."""
    tests: dict[str, list[tuple[float, str, bool]]] = {}  # by signal: how loud it should be, file, clipped
    for o, y in zip(estimation.whiten.observations, simulated, strict=True):
        for k, name in enumerate(o.signals):
            if name.startswith("acc"):
                clipped = clipped_against(o.measured[:, k], y[:, k])
                tests.setdefault(name, []).append((float(np.max(np.abs(y[:, k]))), Path(o.name).name, clipped))
    # a sensor that clips does so in its loudest recording
    files = {name: tuple(file for _, file, bad in rows if bad) for name, rows in tests.items() if max(rows)[2]}
    if not files:
        return None
    name = max(files, key=lambda each: len(files[each]))
    return BadSensor(name, "clipped", 1.0, files[name])


def odd_signal(estimation: EstimationProblem, fits: Sequence[Fit]) -> BadSensor | None:
    """Return the signal that holds nearly all of the excess of some fit, where three or more are compared.

    Not where the last of the fits explains most of its excess: there an effect acts on its axis.
    """
    whiten = estimation.whiten
    names = sorted({s for o in whiten.observations for s in o.signals})
    if not fits or len(names) < 3:
        return None
    parts = [whiten.of_signal(name) for name in names]
    excess = np.array([[float(np.sum(fit.residual[part] ** 2 - 1)) for part in parts] for fit in fits])
    total, least = np.maximum(excess, 0.0).sum(axis=1), estimation.tolerance * len(estimation.measured)
    # by chance alone, one signal has all of a trace
    share = np.where(total > least, excess.max(axis=1) / np.maximum(total, 1e-300), 0.0)
    k = int(excess[int(share.argmax())].argmax())
    stays = excess[-1, k] > (1 - estimation.settings.added) * excess[0, k]
    return BadSensor(names[k], "holds the gap", float(share.max())) if share.max() > ONE_SIGNAL and stays else None
