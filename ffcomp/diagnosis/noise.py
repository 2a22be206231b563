"""The noise floor, and the whitener: a residual whose entries have variance one if only noise is left.

Repeats of one experiment differ by noise alone: half the spectrum of their difference is the floor. Without repeats
it is taken from the residual above the model's band; that is weaker, and reported. Whitening happens in the
frequency domain, which is zero-phase, holds the band exactly, and treats measurement and simulation alike.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from ffcomp.diagnosis.problem import Observation, Problem
from ffcomp.measurement.clock import fill_gaps
from models.arrays import ComplexArray, FloatArray

BAND_HZ = (1.0, 200.0)
SIMULATION_ERROR = 3e-3  # of the signals: no simulation is nearer, however quiet sensors are
TAPER_S = 0.1  # faded in and out at both ends
SEGMENT_S = 0.64  # of the averaged spectra: 1.6 Hz lines
SMOOTHING_HZ = 5.0
LINE_HZ = 25.0  # twice as wide as a line of the shortest windows
QUIET = 0.25  # of all windows: a quarter moves little, or evenly
SMOOTHED_LINES = 4.6  # independent ones in that: dividing by a floor of n averages makes noise 1 + 1/n too large


REPEATS = "repeats"
SENSORS = f"the encoder, and {100 * SIMULATION_ERROR:g} % of the motion: no simulation is nearer"
ABOVE = "the spectrum above the model's band, which is weaker than repeats"
RESIDUAL = "what is left, quiet windows and loud ones alike"


@dataclass(frozen=True, eq=False)
class NoiseFloor:
    """One-sided power spectral density of each signal's noise, unit²/Hz."""

    frequency_hz: FloatArray  # (k,)
    density: Mapping[str, FloatArray]  # signal -> (k,)
    origin: str  # where it is known from, in words

    @property
    def from_repeats(self) -> bool:
        """Whether it was measured: all others are guesses."""
        return self.origin == REPEATS

    def at(self, signal: str, frequency_hz: FloatArray) -> FloatArray:
        """Interpolate the density of one signal: (n,) Hz -> (n,) unit²/Hz."""
        return np.interp(frequency_hz, self.frequency_hz, self.density[signal])


def noise_grid(observations: Sequence[Observation]) -> FloatArray:
    """Return the frequencies, (k,) Hz, at which densities are given."""
    return np.arange(0.0, min(o.rate_hz for o in observations) / 2 + 1e-9, 1 / SEGMENT_S)


def noise_floor(problem: Problem, simulated: Sequence[FloatArray] | None = None) -> NoiseFloor:
    """Take the noise from repeats; without any, from what is left above the model's band.

    simulated : (n, m) an observation with the machine file, if it is known already.
    """
    floor, known = noise_from_repeats(problem.observations), problem.least_density
    if floor is not None and (known or any(each.any() for each in floor.density.values())):  # of copies there is none
        return floor
    # of positions: what their sensors and the simulation cannot separate
    if known and all(name in known for o in problem.observations for name in o.signals):
        return noise_of_sensors(problem.observations, known)
    predicted = problem.simulate({}) if simulated is None else simulated
    errors = [o.measured - y for o, y in zip(problem.observations, predicted, strict=True)]
    above = noise_from_residual(problem.observations, errors, problem.band_hz)
    if not known:
        return above
    sensors = noise_of_sensors(problem.observations, known)
    return replace(above, density={**above.density, **{name: sensors.density[name] for name in known}})


def noise_from_repeats(observations: Sequence[Observation]) -> NoiseFloor | None:
    """Estimate the noise from repeats; None if nothing was measured twice."""
    ordered = sorted(observations, key=lambda o: (o.repeat_of, o.name))
    pairs = [(a, b) for a, b in pairwise(ordered) if a.repeat_of == b.repeat_of and len(a.measured) == len(b.measured)]
    if not pairs:
        return None
    grid = noise_grid([a for a, _ in pairs])
    density = {}
    for signal in sorted({name for a, b in pairs for name in a.signals if name in b.signals}):
        both = [(a, b) for a, b in pairs if signal in a.signals and signal in b.signals]
        spectra = [density_of(_column(a, signal) - _column(b, signal), a.rate_hz, grid) / 2 for a, b in both]
        averages = sum(len(a.measured) / a.rate_hz for a, _ in both) / SEGMENT_S * SMOOTHED_LINES
        density[signal] = _smooth(np.mean(spectra, axis=0), grid) * (1 + 1 / averages)
    for signal in {name for r in observations for name in r.signals} - set(density):
        same_kind = [d for name, d in density.items() if name[:3] == signal[:3]]
        density[signal] = np.mean(same_kind, axis=0)
    return NoiseFloor(grid, density, REPEATS)


def noise_from_residual(
    observations: Sequence[Observation], errors: Sequence[FloatArray], band_hz: tuple[float, float]
) -> NoiseFloor:
    """Take white noise at the level of the residual above the model's band.

    errors : (n, m) an observation, measured − simulated.
    """
    grid = noise_grid(observations)
    high = (grid > 1.1 * band_hz[1]) & (grid < 0.95 * grid[-1])  # up to nearly the Nyquist frequency
    spectra = _spectra(observations, errors, grid)
    density = {signal: np.full(len(grid), np.median(np.mean(x, axis=0)[high])) for signal, x in spectra.items()}
    return NoiseFloor(grid, density, ABOVE)


def noise_of_sensors(observations: Sequence[Observation], density: Mapping[str, float | FloatArray]) -> NoiseFloor:
    """Take noise of known densities, unit²/Hz, white or (k,) at `noise_grid`; signals without one have hardly any."""
    grid = noise_grid(observations)
    signals = sorted({name for r in observations for name in r.signals})
    return NoiseFloor(grid, {name: np.full(len(grid), density.get(name, 0.0)) for name in signals}, SENSORS)


def scaled(floor: NoiseFloor, factor: float) -> NoiseFloor:
    """Return the floor with so many times the power, as the residual shows."""
    return NoiseFloor(floor.frequency_hz, {k: factor * x for k, x in floor.density.items()}, RESIDUAL)


def at_least(
    floor: NoiseFloor,
    observations: Sequence[Observation],
    band_hz: tuple[float, float],
    least: Mapping[str, float | FloatArray] | None = None,
) -> NoiseFloor:
    """Raise the floor of sensors that are quieter than any simulation is exact.

    Friction, belts and play never have our formulas: by the noise of a laboratory's sensors every fit would fail, and
    better data would get the weaker answer.

    least : of some signals, the density below which none is, unit²/Hz
    """
    held = {name: np.maximum(x, (least or {}).get(name, 0.0)) for name, x in floor.density.items()}
    if any(bool((held[name] > x).any()) for name, x in floor.density.items()):
        floor = replace(floor, density=held)
    whiten = whitener(observations, floor, band_hz)
    measured = whiten([o.measured for o in observations])
    parts = {name: whiten.of_signal(name) for name in floor.density if name[:3] == "acc"}
    # positions are nearly the command: no share of them says how exact a simulation is
    shares = {name: max(noise_share(whiten, measured, part), 1e-150) for name, part in parts.items()}
    factors = {name: (SIMULATION_ERROR / share) ** 2 for name, share in shares.items()}
    if max(factors.values(), default=0.0) <= 1.0:
        return floor
    raised = {name: density * max(1.0, factors.get(name, 0.0)) for name, density in floor.density.items()}
    return replace(floor, density=raised)


def raised_to_residual(
    floor: NoiseFloor, observations: Sequence[Observation], errors: Sequence[FloatArray]
) -> NoiseFloor:
    """Raise the floor to the smooth spectrum of what is left, measured − simulated, (n, m) an observation."""
    grid = floor.frequency_hz
    smooth = {signal: _smooth(np.mean(x, axis=0), grid) for signal, x in _spectra(observations, errors, grid).items()}
    return replace(floor, density={signal: np.maximum(x, smooth[signal]) for signal, x in floor.density.items()})


def stationary_noise(
    floor: NoiseFloor, observations: Sequence[Observation], errors: Sequence[FloatArray]
) -> NoiseFloor:
    """Raise the floor to what is left in quiet windows too, measured − simulated, (n, m) an observation.

    The noise of a sensor has its colour, and is the same however the axis moves; the force of an effect follows the
    motion. So a density is taken from the quiet quarter of all windows, and of the lines nearby, because a single line
    is no noise (minimum statistics; Martin 2001).
    """
    grid, density = floor.frequency_hz, dict(floor.density)
    near = round(LINE_HZ / 2 / (grid[1] - grid[0]))
    for signal, x in _spectra(observations, errors, grid).items():
        around = sliding_window_view(np.pad(x, ((0, 0), (near, near)), mode="reflect"), 2 * near + 1, axis=1)
        quiet = np.quantile(around, QUIET, axis=(0, 2)) / -np.log1p(-QUIET)  # a line's power is exponential
        density[signal] = np.maximum(density[signal], quiet)
    return NoiseFloor(grid, density, RESIDUAL)


def _spectra(
    observations: Sequence[Observation], errors: Sequence[FloatArray], grid: FloatArray
) -> dict[str, FloatArray]:
    """Return the density of each signal in every observation that has it, (n, k) unit²/Hz."""
    found: dict[str, list[FloatArray]] = {}
    for o, e in zip(observations, errors, strict=True):
        for name, column in zip(o.signals, e.T, strict=True):
            found.setdefault(name, []).append(density_of(fill_gaps(column), o.rate_hz, grid))
    return {name: np.array(found[name]) for name in sorted(found)}


def noise_share(whiten: Whitener, measured: FloatArray, part: slice | NDArray[np.bool_] = slice(None)) -> float:
    """Return the rms of the noise inside the band, of the signals'; `measured` : (rows,) whitened."""
    scale = whiten.scale[part]
    return float(np.linalg.norm(scale)) / max(float(np.linalg.norm(scale * measured[part])), 1e-300)


def _column(observation: Observation, signal: str) -> FloatArray:
    return fill_gaps(observation.measured[:, observation.signals.index(signal)])


def density_of(x: FloatArray, rate_hz: float, grid: FloatArray) -> FloatArray:
    """Return the one-sided power spectral density, (k,) unit²/Hz, at these frequencies (Welch)."""
    from scipy.signal import welch

    frequency, density = welch(x, rate_hz, nperseg=min(len(x), round(SEGMENT_S * rate_hz)))
    return np.interp(grid, frequency, density)


def _smooth(density: FloatArray, grid: FloatArray) -> FloatArray:
    """Average over SMOOTHING_HZ: the floor has no lines."""
    half = max(1, round(SMOOTHING_HZ / 2 / (grid[1] - grid[0])))
    kernel = np.ones(2 * half + 1)
    return np.convolve(density, kernel, "same") / np.convolve(np.ones_like(density), kernel, "same")


@dataclass(frozen=True, eq=False)
class Whitener:
    """Errors of all observations -> one vector of variance one; the rows of observation i are `rows[i]`."""

    observations: Sequence[Observation]
    floor: NoiseFloor
    rows: Sequence[slice]
    band_hz: tuple[float, float]

    def __call__(self, signals: Sequence[FloatArray], only: Sequence[int] | None = None) -> FloatArray:
        """Whiten (n, m) an observation, or of those in `only`: (rows,).

        One array for several is transformed once, and all that are alike at once.
        """
        chosen = [self._alike[i] for i in (range(len(self.observations)) if only is None else only)]
        alike: dict[int, dict[int, FloatArray]] = {}
        for kind, x in zip(chosen, signals, strict=True):
            alike.setdefault(kind, {})[id(x)] = x
        white = {kind: self._whitened(kind, arrays) for kind, arrays in alike.items()}
        parts = [white[kind][id(x)] for kind, x in zip(chosen, signals, strict=True)]
        return np.concatenate(parts) if parts else np.zeros(0)

    def _whitened(self, kind: int, signals: Mapping[int, FloatArray]) -> dict[int, FloatArray]:
        """Whiten arrays (n, m) that are alike: (rows,) each, by the same keys."""
        observation, together = self.observations[kind], np.stack([x.T for x in signals.values()])
        spectra = self._transformed(observation, together)
        white = np.empty((len(spectra), 2, *spectra.shape[1:]))
        np.divide(spectra.real, self._scales[kind], out=white[:, 0])
        np.divide(spectra.imag, self._scales[kind], out=white[:, 1])
        return dict(zip(signals, white.reshape(len(spectra), -1), strict=True))

    def _transformed(self, observation: Observation, signals: FloatArray) -> ComplexArray:
        """Transform signals (..., m, n): (..., m, k) inside the band."""
        faded = signals * taper(signals.shape[-1], observation.rate_hz)
        if observation.missing is not None:
            faded[..., observation.missing.T] = 0.0  # missing samples count on neither side
        return np.asarray(np.fft.rfft(faded)[..., lines(observation, self.band_hz)[1]])

    @cached_property
    def _alike(self) -> list[int]:
        """The first observation that is whitened in the same way, of each: as long, same signals, same gaps."""
        kinds = [(len(o.measured), o.rate_hz, o.signals, ~np.isfinite(o.measured)) for o in self.observations]
        return [
            next(k for k in range(i + 1) if kinds[k][:3] == kind[:3] and np.array_equal(kinds[k][3], kind[3]))
            for i, kind in enumerate(kinds)
        ]

    @cached_property
    def _scales(self) -> dict[int, FloatArray]:
        """The noise's standard deviation in the transform, (m, k), of each kind of observation."""
        return {i: self._scale(self.observations[i]) for i in set(self._alike)}

    def _scale(self, observation: Observation) -> FloatArray:
        frequency, power = lines(observation, self.band_hz)[0], self.power(observation)
        return np.stack([np.sqrt(self.floor.at(s, frequency) * power) for s in observation.signals])

    @cached_property
    def scale(self) -> FloatArray:
        """The noise's standard deviation in the transform, (rows,), of every entry of the vector."""
        return np.concatenate([np.tile(self._scales[kind].ravel(), 2) for kind in self._alike])

    def of_signal(self, name: str) -> NDArray[np.bool_]:
        """Tell which entries of the vector, (rows,), are of one signal."""
        each = [(len(lines(o, self.band_hz)[0]), np.array(o.signals) == name) for o in self.observations]
        return np.concatenate([np.tile(np.repeat(own, count), 2) for count, own in each])

    def power(self, observation: Observation) -> float:
        """Return the power of a real or imaginary part of the transform, per unit²/Hz of density."""
        window = taper(len(observation.measured), observation.rate_hz)
        return float(np.sum(window**2)) * observation.rate_hz / 4

    def spectrum(self, observation: Observation, x: FloatArray) -> tuple[ComplexArray, FloatArray]:
        """Transform the faded signals (n, m): (m, k) inside the band, and (k,) Hz."""
        return self._transformed(observation, x.T), lines(observation, self.band_hz)[0]

    def band_power(self, observation: Observation, x: FloatArray) -> FloatArray:
        """Return the power inside the band of each signal of x (n, m), not whitened: (m,)."""
        return np.asarray(np.sum(np.abs(self.spectrum(observation, x)[0]) ** 2, axis=1))

    def noise_power(self, observation: Observation, floor: NoiseFloor) -> FloatArray:
        """Return the power inside the band of each signal's noise, in the same unit: (m,)."""
        frequency, power = lines(observation, self.band_hz)[0], 2 * self.power(observation)
        return np.array([power * float(np.sum(floor.at(name, frequency))) for name in observation.signals])

    def frequencies(self) -> FloatArray:
        """Return the frequency of every entry of the vector, (rows,) Hz."""
        parts = [np.tile(lines(r, self.band_hz)[0], 2 * len(r.signals)) for r in self.observations]
        return np.concatenate(parts)


def whitener(
    observations: Sequence[Observation], floor: NoiseFloor, band_hz: tuple[float, float] = BAND_HZ
) -> Whitener:
    """Lay out the rows of all observations inside the band."""
    sizes = [2 * len(r.signals) * len(lines(r, band_hz)[0]) for r in observations]
    ends = np.cumsum([0, *sizes])
    return Whitener(observations, floor, [slice(a, b) for a, b in pairwise(ends.tolist())], band_hz)


def lines(observation: Observation, band_hz: tuple[float, float]) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return the frequencies inside the band, (k,) Hz, and a mask of them among all of the transform's."""
    return _lines(len(observation.measured), observation.rate_hz, band_hz)


@lru_cache(maxsize=64)
def _lines(n: int, rate_hz: float, band_hz: tuple[float, float]) -> tuple[FloatArray, NDArray[np.bool_]]:
    frequency = np.fft.rfftfreq(n, 1 / rate_hz)
    keep = (frequency >= band_hz[0]) & (frequency <= band_hz[1])
    inside = np.asarray(frequency[keep])
    inside.flags.writeable = keep.flags.writeable = False  # shared
    return inside, keep


@lru_cache(maxsize=64)
def taper(n: int, rate_hz: float) -> FloatArray:
    """Return Tukey's window, (n,): from 0 to 1 and back over TAPER_S."""
    ramp = min(round(TAPER_S * rate_hz), n // 2)
    edge = (1 - np.cos(np.pi * (np.arange(ramp) + 0.5) / ramp)) / 2
    window = np.ones(n)
    window[:ramp], window[n - ramp :] = edge, edge[::-1]
    window.flags.writeable = False  # shared
    return window
