"""What is wrong with recordings, not with the machine file: an input shaper left on, a sensor that does not measure.

Both look like huge effects of the machine. A shaper acts on the command, and the printer is nearly linear: what it
would have measured without one, filtered by the shaper's pulses, is what it measures with it. So no simulation is
needed beyond that of the file as it is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

from ffcomp.diagnose.fit import EstimationProblem, Fit
from ffcomp.shapers.pulses import ei, mzv, three_hump_ei, two_hump_ei, zv, zvd
from models.arrays import ComplexArray, FloatArray

TRIED = {"zv": zv, "mzv": mzv, "zvd": zvd, "ei": ei, "2hump_ei": two_hump_ei, "3hump_ei": three_hump_ei}
TRIED_HZ = (15.0, 120.0, 0.5)  # from, to, step of a shaper's frequency
DAMPING_RATIO = 0.1  # the firmware's usual
SHAPED = 0.95  # of the excess must a shaper explain
BETTER = 0.25  # times what retuning, or a delay alone, leaves may it leave
DELAYS_S = np.arange(-8e-3, 8.1e-3, 2.5e-4)  # that are tried alone
LOUD = 3.0  # discrepancy, of the noise, from which a shaper is looked for
ONE_SIGNAL = 0.85  # of the excess in one signal of three or more
OVER, ROWS = 1.4, 40  # times a sensor's largest value; rows of a simulation beyond that: it is clipped
FLAT = 0.15  # of that value by which it may vary there
NEARLY, AT_LEVEL = 0.8, 0.05  # of a level: of the rows above the one, those as near to it as the other stand there
STANDING = 0.45  # of these rows: of a resonance a third, of what is clipped three fifths and more
FOLLOWING = 0.75  # of a row's share of its simulation: by so much what is not clipped grows with it
LEVEL = 99.8  # percentile that stands for the largest value


@dataclass(frozen=True)
class Shaper:
    """One type of input shaper at one frequency, on one axis or, if that is empty, on all."""

    kind: str
    frequency_hz: float
    axis: str = ""

    def __str__(self) -> str:
        """Say so in a sentence."""
        return f"{self.kind.upper()} at {self.frequency_hz:.0f} Hz" + f" on {self.axis}" * bool(self.axis)


@dataclass(frozen=True)
class ShaperOn:
    """Input shapers that explain the discrepancy."""

    shapers: tuple[Shaper, ...]
    explained: float  # share of the excess

    def sentence(self) -> str:
        """Say so, and what to do."""
        which = " and ".join(str(shaper) for shaper in self.shapers)
        one = len(self.shapers) == 1
        return (
            f"{'An input shaper' if one else 'Input shapers'} of type {which} {'seems' if one else 'seem'} to have "
            f"been on while this was recorded: on {'its' if one else 'their'} own {'it explains' if one else 'they'} "
            f"{'' if one else 'explain '}{100 * self.explained:.0f} % of the gap. Switch {'it' if one else 'them'} off "
            '(Klipper: SET_INPUT_SHAPER SHAPER_FREQ_X=0 SHAPER_FREQ_Y=0; RepRapFirmware: M593 P"none"), record again.'
        )


@dataclass(frozen=True)
class BadSensor:
    """One signal that does not measure what the others do."""

    signal: str
    what: str  # "clipped" or "holds the gap"
    share: float  # of the excess in it
    files: tuple[str, ...] = ()

    def sentence(self) -> str:
        """Say so, and what to do."""
        if self.what == "clipped":
            return (
                f"Sensor {self.signal} is clipped in {', '.join(self.files[:3])}: it stands at one value while the "
                "motion goes on. Set a wider range or record a gentler motion; or leave its column out."
            )
        return (
            f"One signal holds the gap: {100 * self.share:.0f} % of it is in {self.signal}, while the others agree. "
            "Look at how this sensor is fastened, at its cable and its range (loose, broken or clipped), or leave its "
            "column out and diagnose again."
        )


Fault = ShaperOn | BadSensor


def fault_of_recordings(estimation: EstimationProblem, simulated: Sequence[FloatArray], retuned: Fit) -> Fault | None:
    """Return a fault that makes any search pointless: a clipped sensor, or a shaper.

    Parameters
    ----------
    simulated : (n, m) an observation with the machine file as it is.
    """
    return shaper_on(estimation, simulated, retuned) or clipped_sensor(estimation, simulated)


# ---- shapers -------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Spectra:
    """What tells whether a simulation needs a filter: Σ|Y|² and Σ conj(M) Y, whitened, of some signals, (k,) each."""

    frequency_hz: FloatArray
    power: FloatArray
    cross: ComplexArray
    excess: float  # |r|² beyond noise, without a filter

    def gain(self, response: ComplexArray) -> float:
        """Return by how much |r|² falls if the simulation has another frequency response (k,)."""
        cost = float(np.sum(np.abs(response) ** 2 * self.power) - 2 * np.sum((response * self.cross).real))
        return float(np.sum(self.power) - 2 * np.sum(self.cross.real)) - cost

    def delayed(self) -> float:
        """Return what the best delay alone takes off |r|²."""
        return max(self.gain(np.exp(-2j * np.pi * self.frequency_hz * late)) for late in DELAYS_S)


def shaper_on(estimation: EstimationProblem, simulated: Sequence[FloatArray], retuned: Fit) -> ShaperOn | None:
    """Return the shaper that explains most of the discrepancy far better than retuning does; None if none does.

    It is tried on all axes, then on x and y each its own, as firmware has them, by the sensors that feel one axis.
    """
    filed = estimation.measured - estimation.whiten(simulated)
    n, before = len(filed), float(filed @ filed)
    if before < (1 + LOUD) * n or retuned.chi_squared < (1 + LOUD) * n:
        return None

    def judged(shapers: Sequence[Shaper], gain: float, by_delays: float) -> ShaperOn | None:
        explained = 1 - max(before - gain - n, 0.0) / (before - n)
        poor = explained < SHAPED or before - gain > BETTER * min(retuned.chi_squared, before - by_delays)
        at_the_edge = any(shaper.frequency_hz in TRIED_HZ[:2] for shaper in shapers)
        return None if poor or at_the_edge or not shapers else ShaperOn(tuple(shapers), explained)

    names = frozenset(name for o in estimation.whiten.observations for name in o.signals)
    groups = {axis: frozenset(name for name in names if name.endswith(f"_{axis}")) for axis in "xy"}
    if not all(groups.values()):
        groups = {}
    spectra = {axis: _spectra(estimation, simulated, own) for axis, own in {"": names, **groups}.items()}
    found = _best_shapers(spectra)
    shaper, gain = found.pop("")
    both = judged([shaper], gain, spectra[""].delayed())
    loud = [axis for axis in groups if spectra[axis].excess > (1 - SHAPED) * (before - n)]
    if both is not None or any(found[axis][1] < SHAPED * spectra[axis].excess for axis in loud):
        return both
    gained, by_delays = (sum(each) for each in ([found[a][1] for a in loud], [spectra[a].delayed() for a in loud]))
    return judged([found[axis][0] for axis in loud], gained, by_delays)


def _best_shapers(spectra: Mapping[str, _Spectra]) -> dict[str, tuple[Shaper, float]]:
    """Return, for the signals of each axis, the shaper that takes most off |r|², and how much: all are of one grid."""
    frequency = spectra[""].frequency_hz
    found = {axis: (Shaper("", 0.0, axis), -np.inf) for axis in spectra}
    for kind, hz in product(TRIED, _frequencies().tolist()):
        shaper = TRIED[kind](hz, DAMPING_RATIO)
        late = np.exp(-2j * np.pi * np.outer(frequency, shaper.time)) @ shaper.amplitude  # from the command on
        centred = late * np.exp(2j * np.pi * frequency * shaper.time[0])
        for axis, own in spectra.items():
            gain = max(own.gain(each) for each in (late, centred))
            if gain > found[axis][1]:
                found[axis] = Shaper(kind, hz, axis), gain
    return found


def _frequencies() -> FloatArray:
    low, high, step = TRIED_HZ
    return np.arange(low, high + step / 2, step)


def _spectra(estimation: EstimationProblem, simulated: Sequence[FloatArray], signals: frozenset[str]) -> _Spectra:
    """Sum up the spectra of these signals in all observations of a grid.

    Observations as long as each other share their frequencies, so that a shaper need be tried once for all of them.
    """
    whiten = estimation.whiten
    sums: dict[bytes, tuple[FloatArray, FloatArray, ComplexArray]] = {}
    excess = 0.0
    for o, y in zip(whiten.observations, simulated, strict=True):
        (m, frequency), (s, _) = whiten.spectrum(o, o.measured), whiten.spectrum(o, y)
        scale = np.stack([whiten.floor.at(name, frequency) for name in o.signals]) * whiten.power(o)
        own = [i for i, name in enumerate(o.signals) if name in signals]
        error = np.abs(m[own] - s[own]) ** 2 / scale[own]
        excess += float(np.sum(error)) - 2 * error.size
        power = np.sum(np.abs(s[own]) ** 2 / scale[own], axis=0)
        cross = np.sum(np.conj(m[own]) * s[own] / scale[own], axis=0)
        _, powers, crosses = sums.get(frequency.tobytes(), (frequency, np.zeros_like(power), np.zeros_like(cross)))
        sums[frequency.tobytes()] = frequency, powers + power, crosses + cross
    grids, all_powers, all_crosses = zip(*sums.values(), strict=True)
    return _Spectra(np.concatenate(grids), np.concatenate(all_powers), np.concatenate(all_crosses), excess)


# ---- sensors -------------------------------------------------------------------------------------


def clipped_sensor(estimation: EstimationProblem, simulated: Sequence[FloatArray]) -> BadSensor | None:
    """Return a sensor that stands at its largest value while its simulation goes far beyond."""
    found: dict[str, list[tuple[float, str, bool]]] = {}  # by signal: how loud it should be, file, clipped
    for o, y in zip(estimation.whiten.observations, simulated, strict=True):
        for k, name in enumerate(o.signals):
            if name.startswith("acc"):
                size = float(np.max(np.abs(y[:, k])))
                found.setdefault(name, []).append((size, Path(o.name).name, _clipped(o.measured[:, k], y[:, k])))
    # a range ends somewhere: what is clipped at all is clipped where it is loudest
    clipped = {name: [file for _, file, bad in rows if bad] for name, rows in found.items() if max(rows)[2]}
    if not clipped:
        return None
    name = max(clipped, key=lambda each: len(clipped[each]))
    return BadSensor(name, "clipped", 1.0, tuple(clipped[name]))


def _clipped(measured: FloatArray, simulated: FloatArray) -> bool:
    known = np.isfinite(measured)
    if not known.any():
        return False
    limit = float(np.percentile(np.abs(measured[known]), LEVEL))
    beyond = known & (np.abs(simulated) > OVER * limit)
    if beyond.sum() < ROWS:
        return False
    there = np.abs(measured[beyond])
    if np.median(there) < (1 - FLAT) * limit or np.std(there) > FLAT * limit:
        return False
    return _stands(np.abs(measured[known]), float(np.median(there))) and not _follows(there, np.abs(simulated[beyond]))


def _stands(sizes: FloatArray, level: float) -> bool:
    """Tell whether a signal dwells at a level, as one that a range cuts off does."""
    return bool(np.sum(np.abs(sizes - level) < AT_LEVEL * level) > STANDING * np.sum(sizes > NEARLY * level))


def _follows(sizes: FloatArray, simulated: FloatArray) -> bool:
    """Tell whether a signal grows with its simulation: then the machine is only gentler than its file says."""
    slope = float(np.polyfit(simulated, sizes, 1)[0])
    return slope > FOLLOWING * float(np.median(sizes / simulated))


def odd_signal(estimation: EstimationProblem, fits: Sequence[Fit]) -> BadSensor | None:
    """Return the signal that holds nearly all of the excess of some fit, where three or more are compared."""
    found = max((_share(estimation, fitted) for fitted in fits), key=lambda each: each[1], default=("", 0.0))
    return BadSensor(found[0], "holds the gap", found[1]) if found[1] > ONE_SIGNAL else None


def _share(estimation: EstimationProblem, fitted: Fit) -> tuple[str, float]:
    excess: dict[str, float] = {}
    for o, rows in zip(estimation.whiten.observations, estimation.whiten.rows, strict=True):
        parts = fitted.residual[rows].reshape(2, len(o.signals), -1)
        for k, name in enumerate(o.signals):
            excess[name] = excess.get(name, 0.0) + float(np.sum(parts[:, k] ** 2 - 1))
    total = sum(max(x, 0.0) for x in excess.values())
    name = max(excess, key=lambda each: excess[each])
    stands_out = total > estimation.tolerance * len(fitted.residual)  # by chance alone, one signal has all of a trace
    return name, (excess[name] / total if stands_out and len(excess) > 2 else 0.0)
