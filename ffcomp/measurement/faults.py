"""Faults of a recording, not of the machine: every fault is one sentence with its remedy.

| fault | known by | function |
|---|---|---|
| a sensor that is dead, clipped or in another unit; gravity left in | its column, and the command | `sensors.py` |
| sensors swapped, reversed, turned, late or stuck | the command below 20 Hz | `sensors.py` |
| a chip whose scale is misread; axes as in a mirror | gravity at rest; its mounting | `SENTENCES` |
| samples that the chip lost; an axis that no chip feels | the file's header; the command below 20 Hz | `SENTENCES` |
| another motion, a shaken printer | the command, the rest before the motion | `SENTENCES` |
| repeats that are copies, lie apart in time, or do not repeat | each other, the command | `compare_repeats` |
| an input shaper left on | the response expected without one | `shaper_of_captures`, `shaper_in_gap` |
| a clipped sensor, one that holds the gap | a simulation | `clipped_against`, `BadSensor` |

Captures are judged before their machine file is fitted, so sizes stay free there; a diagnosis knows its noise floor and
what retuning explains. Both ask the same questions of the same spectra.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial

import numpy as np
from scipy.special import chdtri

from ffcomp.numerics.delay import delayed
from ffcomp.shapers.pulses import DAMPING_RATIO, SHAPERS, USUAL
from models.arrays import BoolArray, ComplexArray, FloatArray

SHAPER_REMEDY = (
    "It must be off: the plan's G-code switches it off (Klipper: SET_INPUT_SHAPER SHAPER_FREQ_X=0 SHAPER_FREQ_Y=0; "
    'RepRapFirmware: M593 P"none"; Marlin: M593 F0). Run that file unchanged, and record again.'
)

# ---- input shapers -------------------------------------------------------------------------------
#
# A shaper acts on the command, and a printer is nearly linear: what it would have measured without a shaper, filtered
# by the shaper's pulses, is what it measures with it. A machine that follows its command late is no shaper: shapers are
# centred on their command, so delays are tried too, and what they explain is no sign of a shaper.


@dataclass(frozen=True)
class ShaperOn:
    """One kind of input shaper at one frequency, on one axis or, if that is empty, on all."""

    kind: str
    frequency_hz: float
    axis: str = ""

    def __str__(self) -> str:
        """Say how its axis moved."""
        return (
            f"{self.axis or 'the nozzle'} moved as {self.kind.upper()} at about {self.frequency_hz:.0f} Hz makes it "
            "move"
        )


@dataclass(frozen=True)
class ShapersLeftOn:
    """Input shapers that were on while something was recorded."""

    shapers: tuple[ShaperOn, ...]
    explained: float  # share
    of: str = "gap"
    without: float | None = None  # the share that a delay alone explains

    @property
    def claim(self) -> str:
        """The shaper that was on, and the evidence."""
        alone = "" if self.without is None else f", and {self.without:.0%} are explained without it"
        return (
            f"The firmware's input shaper was on: {', and '.join(map(str, self.shapers))} (it explains "
            f"{self.explained:.0%} of the {self.of}{alone})."
        )

    def sentence(self) -> str:
        """Describe the fault and its remedy."""
        return f"{self.claim} {SHAPER_REMEDY}"


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Sums over signals of one frequency grid: how c expected columns X, filtered alike, are fitted to measured Y."""

    frequency_hz: FloatArray  # (k,)
    square: FloatArray  # (k, c, c) Re Σ conj(X) X
    cross: ComplexArray  # (k, c) Σ conj(X) Y
    power: float  # Σ |Y|²

    @staticmethod
    def of(frequency_hz: FloatArray, measured: ComplexArray, expected: ComplexArray) -> NormalEquations:
        """Sum up one signal (k,) and its expected columns (k, c)."""
        square = np.einsum("ki,kj->kij", expected.conj(), expected).real
        power = float((np.abs(measured) ** 2).sum())
        return NormalEquations(frequency_hz, square, expected.conj() * measured[:, None], power)

    def __add__(self, other: NormalEquations) -> NormalEquations:
        """Sum up signals of one grid."""
        return NormalEquations(
            self.frequency_hz, self.square + other.square, self.cross + other.cross, self.power + other.power
        )


Responses = Callable[[FloatArray], ComplexArray]  # of h hypotheses: (k,) Hz → (h, k)


def residual_power(
    equations: Sequence[NormalEquations], responses: Responses, free_gains: bool, late_s: FloatArray | None = None
) -> FloatArray:
    """Return Σ |Y − H X g|² of each hypothesis H, (h,), with the gains g of the columns fitted, or all one.

    late_s : (d,) delays, each hypothesis has the best
    """
    normal: FloatArray | float = 0.0
    right: FloatArray | float = 0.0
    late = np.zeros(1) if late_s is None else late_s
    for each in equations:
        response, early = responses(each.frequency_hz), delays(each.frequency_hz, -late)
        normal = normal + np.tensordot(np.abs(response) ** 2, each.square, axes=1)  # (h, c, c)
        cross = early.T[:, :, None] * each.cross[:, None, :]  # (k, d, c)
        right = right + (response.conj() @ cross.reshape(len(cross), -1)).real.reshape(
            -1, *cross.shape[1:]
        )  # (h, d, c)
    normal, right = np.asarray(normal), np.asarray(right)
    power = sum(each.power for each in equations)
    if free_gains:
        trace = np.trace(normal, axis1=1, axis2=2)[:, None, None]
        ridge = np.maximum(1e-9 * trace, 1e-30) * np.eye(right.shape[2])  # an axis may rest: all is zero then
        gains = np.linalg.solve(normal + ridge, right.swapaxes(1, 2)).swapaxes(1, 2)
        left = power - np.einsum("hdc,hdc->hd", right, gains)
    else:
        left = power - 2 * right.sum(axis=2) + normal.sum(axis=(1, 2))[:, None]
    return np.asarray(left.min(axis=1))


def delays(frequency_hz: FloatArray, delay_s: FloatArray) -> ComplexArray:
    """Return the responses of pure delays (h,), (h, k)."""
    return np.asarray(np.exp(-2j * np.pi * np.outer(delay_s, frequency_hz)))


def shapers(
    frequency_hz: FloatArray, kinds: Sequence[str], shaper_hz: FloatArray, causal: bool = False
) -> ComplexArray:
    """Return the responses (kinds · frequencies, k) of shapers: centred, or beginning with the command."""
    relative = frequency_hz / shaper_hz[:, None]
    grid = np.arange(0.0, float(relative.max()) + 0.01, 0.01)
    rows = [np.interp(relative, grid, _of_one_hertz(kind, len(grid), causal)) for kind in kinds]
    return np.concatenate(rows)


@cache
def _of_one_hertz(kind: str, count: int, causal: bool) -> ComplexArray:
    """Return the response of a shaper for 1 Hz every 0.01 Hz, (count,)."""
    shaper = SHAPERS[kind](1.0, DAMPING_RATIO)
    time = shaper.time - shaper.time[0] if causal else shaper.time
    return np.asarray(np.exp(-2j * np.pi * np.outer(0.01 * np.arange(count), time)) @ shaper.amplitude)


CAPTURES_BAND_HZ = (3.0, 80.0)
CAPTURES_HZ = np.geomspace(15.0, 130.0, 60)  # a shaper's frequency
CAPTURES_DELAYS_S = np.arange(-2.5e-3, 7.51e-3, 2.5e-4)  # all captures may be late, or their clocks early
MOST_UNEXPLAINED, TIMES_BETTER = 0.35, 2.5  # of the power; dampings off by 4, belts by 20 % or 120 g gave 1.4 times
MOST_UNEXPLAINED_ALONE, TIMES_BETTER_ALONE = 0.05, 5.0  # the same, of the captures of one experiment
LEAST_UNEXPLAINED_WITHOUT = 0.03  # of the power: less may be anything


def shaper_of_captures(experiments: Mapping[str, Sequence[NormalEquations]], axis: str) -> ShapersLeftOn | None:
    """Return the shaper that one axis has beyond doubt, by all captures, or else by those of one experiment.

    The commonest mistake of a recording. A shaper on one axis leaves so little of it in some motions that all there is
    came from the other axis.

    experiments : the captures of each, between `CAPTURES_BAND_HZ`; expected columns are the motion along the axis and
        what effects of unknown size add to it
    """
    together = [each for captures in experiments.values() for each in captures]
    by_one = (_shaper_of(each, axis, MOST_UNEXPLAINED_ALONE, TIMES_BETTER_ALONE) for each in experiments.values())
    return _shaper_of(together, axis, MOST_UNEXPLAINED, TIMES_BETTER) or next(filter(None, by_one), None)


def _shaper_of(captures: Sequence[NormalEquations], axis: str, most: float, better: float) -> ShapersLeftOn | None:
    """Return the likeliest shaper of an axis, if it leaves little enough of the power; None otherwise."""
    power = max(sum(each.power for each in captures), 1e-300)
    kinds = [*SHAPERS]
    hypotheses = partial(shapers, kinds=kinds, shaper_hz=CAPTURES_HZ)
    unexplained = residual_power(captures, hypotheses, True, CAPTURES_DELAYS_S[::5]) / power
    without = float(residual_power(captures, partial(delays, delay_s=CAPTURES_DELAYS_S), True).min()) / power
    best = _likeliest(unexplained)
    if unexplained[best] > most or without < max(better * unexplained[best], LEAST_UNEXPLAINED_WITHOUT):
        return None
    kind, at = divmod(best, len(CAPTURES_HZ))
    shaper = ShaperOn(kinds[kind], float(CAPTURES_HZ[at]), axis)
    return ShapersLeftOn((shaper,), 1.0 - float(unexplained[best]), "motion", 1.0 - without)


def _likeliest(unexplained: FloatArray) -> int:
    """Choose the candidate that leaves least; one of the usual kinds where it leaves hardly more."""
    usual = np.repeat([kind in USUAL for kind in SHAPERS], len(CAPTURES_HZ))
    best, common = int(unexplained.argmin()), int(np.where(usual, unexplained, np.inf).argmin())
    return common if unexplained[common] < 1.5 * unexplained[best] + 0.01 else best


GAP_HZ = np.arange(15.0, 120.25, 0.5)  # a shaper's frequency
GAP_DELAYS_S = np.arange(-8e-3, 8.1e-3, 2.5e-4)
EXPLAINED = 0.95  # of the excess must a shaper explain
RETUNED_SHARE = 0.25  # of what retuning, or a delay alone, leaves may a shaper leave


@dataclass(frozen=True, eq=False)
class GapSpectra:
    """Some whitened signals against their simulation: its one column has the gain one."""

    equations: tuple[NormalEquations, ...]  # one a frequency grid
    noise: float  # what |r|² is if only noise is left

    def residual(self, responses: Responses) -> FloatArray:
        """Return |r|² with each response, (h,)."""
        return residual_power(self.equations, responses, free_gains=False)

    @property
    def plain(self) -> float:
        """|r|² without a filter."""
        return float(self.residual(partial(delays, delay_s=np.zeros(1)))[0])

    @property
    def excess(self) -> float:
        """|r|² beyond noise."""
        return self.plain - self.noise

    @property
    def delayed(self) -> float:
        """What the best delay alone takes off |r|²."""
        return self.plain - float(self.residual(partial(delays, delay_s=GAP_DELAYS_S)).min())

    def best_shaper(self, axis: str) -> tuple[ShaperOn, float]:
        """Return the shaper that takes most off |r|², and how much."""
        tried = [self.residual(partial(shapers, kinds=USUAL, shaper_hz=GAP_HZ, causal=c)) for c in (False, True)]
        left = np.min(tried, axis=0)
        kind, at = divmod(int(left.argmin()), len(GAP_HZ))
        return ShaperOn(USUAL[kind], float(GAP_HZ[at]), axis), self.plain - float(left.min())


def shaper_in_gap(everything: GapSpectra, axes: Mapping[str, GapSpectra], retuned: float) -> ShapersLeftOn | None:
    """Return the shaper that explains most of a gap far better than retuning does; None if none does.

    It is tried on all axes, then on each its own, as firmware has them, by the sensors that feel one axis.

    retuned : |r|² that is left when the machine file's numbers are fitted
    """
    before, noise = everything.plain, everything.noise

    def judged(on: Sequence[ShaperOn], gain: float, by_delays: float) -> ShapersLeftOn | None:
        explained = 1 - max(before - gain - noise, 0.0) / (before - noise)
        poor = explained < EXPLAINED or before - gain > RETUNED_SHARE * min(retuned, before - by_delays)
        at_the_edge = any(shaper.frequency_hz in (GAP_HZ[0], GAP_HZ[-1]) for shaper in on)
        return None if poor or at_the_edge or not on else ShapersLeftOn(tuple(on), explained)

    shaper, gain = everything.best_shaper("")
    both = judged([shaper], gain, everything.delayed)
    loud = {axis: each for axis, each in axes.items() if each.excess > (1 - EXPLAINED) * (before - noise)}
    alone = {axis: each.best_shaper(axis) for axis, each in loud.items()}
    if both is not None or any(gain < EXPLAINED * loud[axis].excess for axis, (_, gain) in alone.items()):
        return both
    gained, by_delays = sum(gain for _, gain in alone.values()), sum(each.delayed for each in loud.values())
    return judged([shaper for shaper, _ in alone.values()], gained, by_delays)


# ---- repeats -------------------------------------------------------------------------------------
#
# What repeats of one experiment differ by is noise only if they were recorded on one clock, and if the printer did the
# same twice: a repeat that lies a millisecond late, or a printer that warms up, differs by far more than its sensors'
# noise. Noise knows nothing of the command, and a machine that changed answers the command in another way: what of the
# difference is coherent with the command is a change, and the rest of it is the noise, frequency by frequency, coloured
# and louder in motion as it may be.

LARGE_LAG_S = 1e-4  # lag between repeats above which it is reported and fitted
SEARCHED_LAG_S, LAG_STEP_S = 0.012, 2e-4
LAG_BAND_HZ, REPEATS_BAND_HZ = (2.0, 60.0), (2.0, 200.0)  # where lags show best; where repeats are compared
SIGNIFICANT_LAG = 5.0  # standard deviations
LARGE_SHARE = 0.1  # of the signals: by that a printer changes whose frequencies move by some 3 %
FALSE_ALARM, CONFIDENCE_SD = 1e-3, 3.1  # of noise alone; the same in standard deviations of many lines
LINES = 20  # of a spectrum, over which noise is even and the ratio of response and command nearly a straight line
SAME_COMMAND = 1e-2  # singular value below which one column of a command says what the others do
COPY_SHARE = 1e-9  # of the signals: no two measurements are so alike
REPEATS_REMEDY = (
    "The printer itself changed between them (it warmed up, something is loose, slips or rubs now and then), or they "
    "are not of the same motion. Let the printer warm up for five minutes, tighten the sensor and what else is loose, "
    "and record both again"
)


@dataclass(frozen=True)
class RepeatComparison:
    """What repeats of one experiment differ by."""

    lag_s: tuple[float, ...]  # of each behind their mean
    lags_significant: bool
    share: float  # rms difference of one from their mean, of the signals, lags taken out, noise included
    least_change: float  # the least part of the signals that follows the command in another way, up to FALSE_ALARM

    @property
    def apart(self) -> bool:
        """Whether they lie so far apart in time that it matters."""
        return self.lags_significant and max(self.lag_s) - min(self.lag_s) > LARGE_LAG_S

    @property
    def differ(self) -> bool:
        """Whether the machine answered the command in another way, by more than noise explains."""
        return self.least_change > LARGE_SHARE

    @property
    def copied(self) -> bool:
        """Whether it is one measurement under several names."""
        return self.share < COPY_SHARE

    @property
    def difference(self) -> str:
        """How much they differ, in words."""
        return f"{self.share:.0%} of the signals, and {self.least_change:.0%} at least is not noise"


def compare_repeats(
    signals: Sequence[FloatArray],
    command: FloatArray,
    rate_hz: float,
    known: BoolArray | None = None,
    units: Sequence[str] = (),
) -> RepeatComparison:
    """Compare repeats of one experiment on one clock.

    signals : (n, m) each, without their means, gaps bridged
    command : (n, k) speeds, mm/s
    known : (n,) where all of them were measured
    units : of each signal; none named: all have one
    """
    scale = np.maximum(np.std(signals[0], axis=0), 1e-12)
    weights = scale
    for _ in range(2):  # then signals weigh by what they differ by: of one that feels no motion, noise alone is known
        lags, significant = _lags([np.fft.rfft(x / weights, axis=0) for x in signals], len(command), rate_hz)
        moved = lags if significant else [0.0] * len(lags)  # a lag that noise alone makes would be a change
        together = np.stack([delayed(x, -lag, rate_hz) for x, lag in zip(signals, moved, strict=True)])
        if known is not None:
            together = together * known[:, None]  # what one of them lacks shows nothing
        differences = _in_band(together - together.mean(axis=0), rate_hz) * np.sqrt(len(signals) / (len(signals) - 1))
        weights = np.maximum(np.sqrt(np.mean(differences**2, axis=(0, 1))), 1e-9 * scale)
    powers = np.mean(_in_band(np.stack(signals), rate_hz) ** 2, axis=(0, 1))
    of_unit = [[k for k in range(len(scale)) if not units or units[k] == unit] for unit in dict.fromkeys(units or "1")]
    apart = np.mean(differences**2, axis=(0, 1))
    share = np.sqrt(np.mean([apart[k].sum() / max(powers[k].sum(), 1e-24) for k in of_unit]))
    changes = [_least_change(together[:, :, k], command, rate_hz) for k in of_unit]
    return RepeatComparison(tuple(lags), significant, float(share), max(changes))


def _least_change(signals: FloatArray, command: FloatArray, rate_hz: float) -> float:
    """Return the least share of signals (r, n, m) in one unit of the difference of their responses to a command (n, k).

    The spectra of r - 1 contrasts between the repeats are regressed on the command's, over LINES lines at a time, with
    complex gains that are straight lines over frequency. The part explained beyond the share that noise explains by
    chance is the change, and the rest is the noise. Lines count by the share of their power that is no noise
    (Wiener), or those without any motion would drown the change. The mean of the repeats is row 0, followed by
    the contrasts.
    """
    r, n = signals.shape[:2]
    frequency = np.fft.rfftfreq(n, 1 / rate_hz)
    inside = np.flatnonzero((frequency >= REPEATS_BAND_HZ[0]) & (frequency <= REPEATS_BAND_HZ[1]))
    contrasts = np.linalg.qr(np.column_stack([np.ones(r), np.eye(r)[:, 1:]]))[0].T  # orthonormal; 0: the mean's
    spectra = np.einsum("cr,rkm->kcm", contrasts, np.fft.rfft(signals, axis=1)[:, inside])
    commanded = np.fft.rfft(command, axis=0)[inside]
    change, chance, of_chance, of_change, power = np.zeros(5)
    for lines in np.array_split(np.arange(len(inside)), max(len(inside) // LINES, 1)):
        basis, part = _basis(commanded[lines]), spectra[lines]
        p = basis.shape[1]
        free = len(lines) - p
        if free < 1:
            continue
        total = np.sum(np.abs(part) ** 2, axis=0)
        explained = np.sum(np.abs(np.einsum("kp,kcm->pcm", basis.conj(), part)) ** 2, axis=0)
        noise = ((total - explained) / free)[1:]  # of a line
        excess = explained[1:] - p * noise
        signal = np.maximum(total[0] - len(lines) * noise.mean(axis=0), 0.0)
        weight = signal / np.maximum(total[0], 1e-300)
        change += np.sum(weight * excess)
        chance += np.sum(weight * p * noise)
        of_chance += np.sum((weight * noise) ** 2) * free / (free + 1) * (p + p**2 / free)
        of_change += np.sum(weight**2 * 2 * noise * np.maximum(excess, 0.0))
        power += np.sum(weight * signal)
    if change <= 0.0:
        return 0.0
    freedom = max(2 * chance**2 / max(of_chance, 1e-300), 1e-3)  # of the chi-square of this mean and variance
    by_chance = chance * (chdtri(freedom, FALSE_ALARM) / freedom - 1)
    least = (change - np.hypot(by_chance, CONFIDENCE_SD * np.sqrt(of_change))) / (r - 1) / max(power / r, 1e-300)
    return float(np.sqrt(max(least, 0.0)))


def _basis(commanded: ComplexArray) -> ComplexArray:
    """Return an orthonormal basis (l, p) of spectra (l, k) of commands, times straight lines over frequency."""
    along = np.linspace(-1.0, 1.0, len(commanded))[:, None]
    columns = np.hstack([commanded, commanded * along])
    size = np.linalg.norm(columns, axis=0)
    left, values, _ = np.linalg.svd(columns / np.maximum(size, 1e-300), full_matrices=False)
    return np.asarray(left[:, values > SAME_COMMAND * max(float(values.max(initial=0.0)), 1e-300)])


def _lags(spectra: Sequence[ComplexArray], n: int, rate_hz: float) -> tuple[list[float], bool]:
    """Return each repeat's lag behind the mean of all, s, and whether they are more than noise."""
    w: FloatArray = 2 * np.pi * np.asarray(np.fft.rfftfreq(n, 1 / rate_hz), dtype=np.float64)
    keep = (w >= 2 * np.pi * LAG_BAND_HZ[0]) & (w <= 2 * np.pi * LAG_BAND_HZ[1])
    pairs = [(0.0, 0.0), *(_lag(spectra[0][keep], other[keep], w[keep]) for other in spectra[1:])]
    middle = float(np.mean([lag for lag, _ in pairs]))
    return [lag - middle for lag, _ in pairs], any(abs(lag) > SIGNIFICANT_LAG * sd for lag, sd in pairs[1:])


def _lag(reference: ComplexArray, other: ComplexArray, w: FloatArray) -> tuple[float, float]:
    """Return how much later `other` (k, m) is than the reference, and its standard deviation, s."""
    cross = np.sum(np.conj(other) * reference, axis=1)
    tries = np.arange(-SEARCHED_LAG_S, SEARCHED_LAG_S + LAG_STEP_S / 2, LAG_STEP_S)
    lag = float(tries[int(np.argmax([float(np.sum((cross * np.exp(-1j * w * x)).real)) for x in tries]))])
    for _ in range(4):  # Newton's steps to the maximum
        turned = cross * np.exp(-1j * w * lag)
        slope, curvature = float(np.sum(w * turned.imag)), -float(np.sum(w**2 * turned.real))
        if curvature >= 0:
            break
        lag -= float(np.clip(slope / curvature, -LAG_STEP_S, LAG_STEP_S))
    residual = np.sum(np.abs(other * np.exp(1j * w * lag)[:, None] - reference) ** 2, axis=1)
    information = np.sum(w**2 * np.sum(np.abs(reference) ** 2, axis=1))
    return lag, float(np.sqrt(np.sum(w**2 * residual) / 2) / max(information, 1e-300) * np.sqrt(w @ w))


def _in_band(x: FloatArray, rate_hz: float) -> FloatArray:
    """Keep signals (…, n, m) within the band."""
    frequency = np.fft.rfftfreq(x.shape[-2], 1 / rate_hz)
    inside = (frequency >= REPEATS_BAND_HZ[0]) & (frequency <= REPEATS_BAND_HZ[1])
    return np.asarray(np.fft.irfft(np.fft.rfft(x, axis=-2) * inside[:, None], x.shape[-2], axis=-2))


# ---- sensors against a simulation ----------------------------------------------------------------

BEYOND, LEAST_ROWS = 1.4, 40  # times a sensor's largest value; rows of a simulation beyond that: it is clipped
FLATNESS = 0.15  # of that value: variation allowed there
DWELLING = 0.45  # of the rows near a level: of a resonance a third, of a clipped signal three fifths and more
FOLLOWING = 0.75  # of a row's share of its simulation: an unclipped signal grows by this share with it


@dataclass(frozen=True)
class BadSensor:
    """One signal that does not measure what the others do."""

    signal: str
    what: str  # "clipped" or "holds the gap"
    share: float  # of the excess in it
    files: tuple[str, ...] = ()

    def sentence(self) -> str:
        """Describe the fault and its remedy."""
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


def clipped_against(measured: FloatArray, simulated: FloatArray) -> bool:
    """Return whether a sensor (n,) stands at its largest value while its simulation goes far beyond."""
    known = np.isfinite(measured)
    if not known.any():
        return False
    sizes = np.abs(measured[known])
    limit = float(np.percentile(sizes, 99.8))
    beyond = known & (np.abs(simulated) > BEYOND * limit)
    if beyond.sum() < LEAST_ROWS:
        return False
    there, expected = np.abs(measured[beyond]), np.abs(simulated[beyond])
    level = float(np.median(there))
    if level < (1 - FLATNESS) * limit or np.std(there) > FLATNESS * limit:
        return False
    dwells = np.sum(np.abs(sizes - level) < 0.05 * level) > DWELLING * np.sum(sizes > 0.8 * level)
    # a signal that grows with its simulation is of a machine that is gentler than its file says
    follows = np.polyfit(expected, there, 1)[0] > FOLLOWING * np.median(there / expected)
    return bool(dwells and not follows)


# ---- captures ------------------------------------------------------------------------------------

SENTENCES = {
    "lost samples": "The chip lost samples ({overflows} overflows or drops), so its times are wrong. Record it again, "
    "with less load on the printer's host, or at a lower rate of the chip.",
    "no gravity": "At rest it measures {size:.3g} m/s², and gravity is 9.81: its numbers are {ratio:.2g} times as "
    "large as they should be. The range, the scale or the unit of the chip is misread, or gravity was taken out. Check "
    "the chip's type and range in the firmware's configuration, and record it again.",
    "mirrored": "The accelerometer's axes are {axes}, as in a mirror, and no chip's are: either axes_map in the "
    "firmware's configuration is wrong, or the printer moves x or y the wrong way. Command a single move to the right, "
    "and look.",
    "deaf": "No chip feels the motion along {axis}, so it is not judged. A bed slinger's bed needs a chip of its own: "
    "give `ffcomp record plan` both (--chip adxl345 --chip bed), and here the captures of both.",
    "deaf check": "No chip feels the motion along {axis}, and a check compares all axes: give the captures of both "
    "chips, on the toolhead and on the bed.",
    "alike": "Its name {stem!r} holds none of the plan's experiments, as {first!r} does, and their motions do not "
    "distinguish them: each excites one tower or axis in the same way. Name the capture after its experiment, as the "
    "firmware does.",
    "unlike": "It does not fit the motion of {experiment} below 20 Hz: correlation {correlation:.2f}, and {least:g} is "
    "needed. It is of another motion (another plan, a speed factor, lower limits of the firmware, lost steps, a bump), "
    "of another machine, or of a sensor that is loose or not on the nozzle holder; or its axes are others than "
    "--axes-map says. Check these, and record it again.",
    "shaken": "It does not fit the motion of {experiment} below 20 Hz: correlation {correlation:.2f}, and {least:g} is "
    "needed. It shakes by {rest:.2g} m/s² at rest already, {share:.0%} of what it does in motion: something else "
    "shakes the printer or its table, or the sensor is loose. Stop that, and record it again.",
    "copy": "Its rows are those of {other}: one recording under two names shows no noise. Give the capture that was "
    "made when the experiment was repeated, or leave this one out, with --without-repeats.",
}


def fault(name: str, **values: object) -> str:
    """Report a fault of a capture, and what to do."""
    return SENTENCES[name].format(**values)
