"""The diagnosis of one axis: a position or a force in; positions or an acceleration out.

An axis has one place only; windows of time are held out instead, the same of all runs at once.

Its file states no pitch of a ripple, so pitches are looked for in the data. A ripple repeats every pitch along the way:
a cos(2π u/p) in the order, or in the force. The axis answers it linearly, so that for every pitch the two numbers of
amplitude and phase follow from one 2 × 2 system (Lomb 1976, for the place in place of the time). From one try to the
next the ripple shifts by a quarter of a turn over the whole travel, or a short pitch falls between them. Where a
simulation begins anew all the time, it leaves too little of a ripple. There the force is known, and what of it inertia
and friction do not explain is searched line by line (matching pursuit; Mallat and Zhang 1993).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import uniform_filter1d

from ffcomp.diagnosis.candidates import axis_candidates, effect_tables, machine_parameters
from ffcomp.diagnosis.observations import quick_length
from ffcomp.diagnosis.problem import InfeasibleParameters, Observation, Parameter, Problem
from ffcomp.identification.axis_shots import Shots, band_of, noise_sd, scales_of, shots_of, windows
from ffcomp.measurement.axis_run import AxisRun
from models.arrays import ComplexArray, FloatArray
from models.effects.catalogue import CATALOGUE, catalogue_of, with_effects
from models.kinds import driven_axis
from models.machine import Machine, with_values
from models.printer.one_axis import simulate_axis
from models.vibration.driven_axis import DrivenAxis

OFFSET, OFFSET_SHARE = "axis.offset_n", 0.1  # of the force, by which its zero may be off
EXACT = 0.003  # of what the forces do in a shot: no simulation is nearer than that
KEPT = 6  # motions that are held
STEP_COST = 2.0  # of a printer's steps: these take no lanes
RIPPLES = frozenset(name for name, effect in CATALOGUE.items() if any(p.is_pitch for p in effect.shapes))
LINES = 6  # of a force that repeats along the axis
PITCHES = 4  # at which a search for a ripple begins

_Key = tuple[tuple[tuple[str, float], ...], bool, int]


@dataclass(frozen=True)
class Window:
    """A part of a run that is compared."""

    run: int
    rows: slice


class AxisProblem(Problem):
    """The machine file of an axis, and its runs."""

    def __init__(self, machine: Machine, runs: Sequence[AxisRun], names: Sequence[str] = tuple(CATALOGUE)) -> None:
        self.machine, self.recordings = machine, runs
        self.name, self.path, self.quantities = machine.name, machine.path, machine.vibration.quantities
        self.catalogue = catalogue_of(self.quantities, machine.vibration.moves)
        self.commanded = not driven_axis(machine).by_force
        self.shots = shots_of(machine, runs)
        self.band_hz = band_of(self.shots)
        self.windows = [Window(i, part) for i, one in enumerate(self.shots) for part in _parts(one)]
        self.observations = [_observation(self.shots[w.run], w.rows) for w in self.windows]
        scales = replace(scales_of(machine, self.shots), highest_hz=self.band_hz[1])
        self.parameters = (*machine_parameters(machine), *_offset(machine, scales.force_n))
        signals = {name for run in runs for name in run.signals}
        self._same = [_first_equal(self.shots, i) for i in range(len(runs))]
        ripples = bool(RIPPLES & set(names))
        lines = self._lines() if ripples and self._begins_anew else []
        pitches = self._pitches() if ripples and not self._begins_anew else []
        self.candidates = axis_candidates(machine, scales, sorted(signals), names, pitches, lines)
        self.least_density = self._least_density(sorted(signals))
        self._kept: dict[_Key, dict[str, FloatArray]] = {}

    @property
    def motions(self) -> Sequence[int]:
        """Return the run whose simulation serves each window."""
        return [self._same[window.run] for window in self.windows]

    @property
    def _begins_anew(self) -> bool:
        return any(one.length for one in self.shots)

    def _distinct(self) -> list[Shots]:
        return [self.shots[i] for i in sorted(set(self._same))]

    def _pitches(self) -> list[float]:
        """Look for pitches in what a simulation from beginning to end leaves."""
        return likely_pitches(self.machine, self._distinct(), self.band_hz, PITCHES)

    def _lines(self) -> list[float]:
        """Look for them in the force: a simulation that begins anew all the time leaves too little of them."""
        return pitches_of_force(self.machine, self._distinct(), LINES)

    def _least_density(self, signals: Sequence[str]) -> dict[str, float]:
        """Return the least density of each position's noise: of its sensor, and of how exact a simulation can be."""
        found: dict[str, float] = {}
        for name in (s for s in signals if s.startswith("pos")):
            own = [one for one in self.shots if name in one.run.signals]
            rate = min(one.run.sample_rate_hz for one in own)
            each = [noise_sd(x[np.isfinite(x)]) for x in (one.run.position[name] for one in own)]
            # of a free axis a quick run's bends would pass for noise, and by that hide what its shots show
            sensor = float(np.median(each) if driven_axis(self.machine).free else np.max(each))
            motion = float(np.sqrt(np.mean([np.nanmean(_told(one, name) ** 2) for one in own])))
            found[name] = 2 * sensor**2 / rate + (EXACT * motion) ** 2 / (self.band_hz[1] - self.band_hz[0])
        return found

    def simulate(
        self, values: Mapping[str, float], only: Sequence[int] | None = None, *, coarse: bool = False
    ) -> list[FloatArray]:
        """Simulate windows of the runs: (n, m) each."""
        machine = self.machine_with(values)
        chosen = range(len(self.windows)) if only is None else only
        key = (tuple(sorted(values.items())), coarse)
        told: dict[int, FloatArray] = {}
        for run in dict.fromkeys(self.windows[i].run for i in chosen):
            one, felt = self.shots[run], self._felt(machine, (*key, self._same[run]))
            own = one.told({s: felt[s] for s in one.run.signals})
            told[run] = np.stack(list(own.values()), axis=1)
        return [told[self.windows[i].run][self.windows[i].rows] for i in chosen]

    def _felt(self, machine: Machine, key: _Key) -> dict[str, FloatArray]:
        """Return what the sensors of a run would read; the last few are kept, for windows ask one by one."""
        if key not in self._kept:
            try:
                motion = self.shots[key[2]].simulate(machine, coarse=key[1])
            except ValueError as error:
                raise InfeasibleParameters(str(error)) from None
            self.work.add(STEP_COST * motion.steps)
            self._kept[key] = motion.sensed(machine)
            for old in list(self._kept)[: -KEPT * len(self.shots)]:
                del self._kept[old]
        return self._kept[key]

    def machine_with(self, values: Mapping[str, float]) -> Machine:
        """Return the machine file's axis with these parameters and effects."""
        plain = {name: x for name, x in values.items() if not name.startswith("effects.")}
        return with_effects(with_values(self.machine, plain), effect_tables(values))

    def place_name(self, position: tuple[float, ...]) -> str:
        """Name a window of time."""
        return f"from {position[0]:g} s"


def _told(one: Shots, name: str) -> FloatArray:
    """Return what of a position its shots tell: beyond where each began; or beyond its command."""
    return one.told(one.run.signals)[name] if one.length else one.own_motion(name)


def _parts(one: Shots) -> list[slice]:
    """Cut windows to lengths that are transformed quickly."""
    return [slice(p.start, p.start + quick_length(p.stop - p.start)) for p in windows(one)]


def _first_equal(shots: Sequence[Shots], i: int) -> int:
    """Return the first run that the same input drives from the same states: repeats need one simulation."""

    def alike(a: Shots, b: Shots) -> bool:
        return np.array_equal(a.run.drive, b.run.drive) and np.array_equal(a.begin, b.begin, equal_nan=True)

    return next(k for k in range(i + 1) if alike(shots[k], shots[i]))


def _observation(one: Shots, rows: slice) -> Observation:
    run, signals = one.run, tuple(one.run.signals)
    began = round(float(run.time_s[rows.start] - run.time_s[0]), 3)
    measured = np.stack(list(one.told(run.signals).values()), axis=1)[rows]
    speed = np.tile(one.speed[rows, None], (1, len(signals)))
    name, repeat = f"{run.source} from {began:g} s", f"{run.repeat_of} from {began:g} s"
    return Observation(name, repeat, (began,), run.sample_rate_hz, signals, measured, speed)


def _offset(machine: Machine, force_n: float) -> list[Parameter]:
    if not driven_axis(machine).by_force:
        return []
    return [Parameter(OFFSET, driven_axis(machine).offset_n, OFFSET_SHARE * force_n)]


# ---- pitches -----------------------------------------------------------------------------------------


A_TURN = 4  # tries for each turn over the travel
FASTEST = 2.0  # times the usual speed over the highest frequency compared: the shortest pitch is passed in no less
MOST_TRIES = 1500
SMOOTH = 31  # lines of a spectrum over which its level is taken
PULSE = 64  # samples before a pulse
MOST_ROWS = 2500  # of a run, of which a force's lines are found
SHORTEST_SHARE, MOST_LINES_A_TURN = 0.005, 400  # of the travel, a pitch; lines a turn
APART, LEAST_LINE = 0.04, 0.1  # relative, lines; of the first line's size, what counts as another
LEAST_SHARE = 0.15  # of what is left, that a line explains


@dataclass(frozen=True, eq=False)
class _Part:
    """One motion: its place, and what is left of its acceleration."""

    place: FloatArray  # (n,) mm
    left: ComplexArray  # (lines,) inside the band, weighted
    answer: ComplexArray  # (lines,) of the acceleration to the input, weighted
    taper: FloatArray  # (n,)
    lines: slice  # of the band


def likely_pitches(machine: Machine, shots: Sequence[Shots], band_hz: tuple[float, float], most: int) -> list[float]:
    """Return the pitches, mm, at which a ripple explains most of what the file leaves, the best first.

    Parameters
    ----------
    shots : runs that are simulated from beginning to end; each motion once.
    """
    parts = [part for one in shots if (part := _part(machine, one, band_hz)) is not None]
    if not parts:
        return []
    travel = max(float(np.ptp(part.place)) for part in parts)
    speed = float(np.sqrt(np.mean(np.concatenate([one.speed for one in shots]) ** 2)))
    if min(travel, speed) <= 0.0:
        return []
    first, last = 2.0 / travel, FASTEST * band_hz[1] / speed
    count = min(max(int((last - first) * travel * A_TURN), 0), MOST_TRIES)
    turns = first + np.arange(count) / (A_TURN * travel)
    return [float(1.0 / turns[i]) for i in _peaks(_gains(parts, turns), most)]


def pitches_of_force(machine: Machine, shots: Sequence[Shots], most: int) -> list[float]:
    """Return the pitches, mm, whose lines together explain most of the measured force, the strongest first.

    None where no line stands out.

    Parameters
    ----------
    shots : runs whose force and place are known; each motion once.
    """
    axis = driven_axis(machine)
    columns, forces, places = list[FloatArray](), list[FloatArray](), list[FloatArray]()
    for one in shots:
        place = one.run.position.get("pos_q", one.run.position.get("pos_motor"))
        if place is None or not np.isfinite(place).all():
            return []
        v = one.speed / 1e3
        change = np.gradient(v, 1 / one.run.sample_rate_hz)
        thin = slice(None, None, max(len(v) // MOST_ROWS, 1))
        columns.append(np.column_stack([change, v, np.sign(v), np.ones(len(v))])[thin])
        forces.append(axis.force_of(one.run.drive, one.run.supply_v)[thin])
        places.append(np.asarray(place)[thin])
    place, force, known = np.concatenate(places), np.concatenate(forces), np.concatenate(columns)
    turns, first = _tries(axis, places), 0.0
    found: list[int] = []
    while len(found) < min(most, len(turns)):
        left = force - known @ np.linalg.lstsq(known, force, rcond=1e-9)[0]
        gains = np.array([abs(np.exp(2j * np.pi * turn * place) @ left) for turn in turns])
        gains[[i for i in range(len(turns)) if any(abs(turns[i] / turns[j] - 1) < APART for j in found)]] = 0.0
        best = int(np.argmax(gains))
        if gains[best] <= LEAST_LINE * first or gains[best] ** 2 < LEAST_SHARE * len(left) * (left @ left) / 2:
            break
        first = max(first, float(gains[best]))
        found.append(best)
        angle = 2 * np.pi * turns[best] * place
        known = np.column_stack([known, np.sin(angle), np.cos(angle)])
    return [float(1.0 / turns[i]) for i in found]


def _tries(axis: DrivenAxis, places: Sequence[FloatArray]) -> FloatArray:
    """Return how often a millimetre lines may repeat: of what turns, a whole number of times a turn."""
    travel = float(np.ptp(np.concatenate(places)))
    if axis.quantities.turns:
        turn = 2e3 * np.pi
        return np.arange(max(int(np.ceil(2 * turn / max(travel, 1e-9))), 1), MOST_LINES_A_TURN + 1) / turn
    count = min(int((1 / SHORTEST_SHARE - 2) * A_TURN), MOST_TRIES)
    return np.asarray((2 + np.arange(count) / A_TURN) / max(travel, 1e-9))


def _part(machine: Machine, one: Shots, band_hz: tuple[float, float]) -> _Part | None:
    try:
        motion = one.simulate(machine).sensed(machine)
    except ValueError:
        return None
    run, n, rate = one.run, len(one.run.drive), one.run.sample_rate_hz
    name = next((s for s in ("acc_q", *run.signals) if s in run.signals and np.isfinite(run.signals[s]).all()), None)
    if name is None:
        return None
    frequency, taper = np.fft.rfftfreq(2 * n, 1 / rate), np.hanning(n)
    error = np.fft.rfft(taper * (run.signals[name] - motion[name]), 2 * n)
    if name != "acc_q":  # mm, to m/s²
        error = -1e-3 * (2 * np.pi * frequency) ** 2 * error
    lines = slice(*np.searchsorted(frequency, band_hz).tolist())
    weight = 1 / np.maximum(np.sqrt(uniform_filter1d(np.abs(error) ** 2, SMOOTH)), 1e-12)[lines]
    place = run.drive if not run.by_force else np.asarray(run.signals[next(s for s in run.signals if "pos" in s)])
    return _Part(place, weight * error[lines], weight * _answer(machine, rate, n)[lines], taper, lines)


def _answer(machine: Machine, rate_hz: float, n: int) -> ComplexArray:
    """Return the response of the last mass' acceleration to the input, (lines,), by that to a smooth pulse."""
    k = np.arange(2 * n)
    pulse = np.exp(-0.5 * ((k - PULSE) / 1.5) ** 2)
    felt = simulate_axis(machine, pulse, 1 / rate_hz).sensed(machine)["acc_q"]
    driven = np.fft.rfft(pulse)
    small = np.abs(driven) < 1e-6 * np.abs(driven[0])
    return np.asarray(np.where(small, 0.0, np.fft.rfft(felt) / np.where(small, 1.0, driven)))


def _gains(parts: Sequence[_Part], turns: FloatArray) -> FloatArray:
    """Return for each number of turns a millimetre what a ripple of any amplitude and phase explains."""
    waves = [part.taper * np.exp(2j * np.pi * turns[0] * part.place) for part in parts]
    steps = [np.exp(2j * np.pi * (turns[1] - turns[0]) * part.place) if len(turns) > 1 else None for part in parts]
    gains = np.zeros(len(turns))
    for k in range(len(turns)):
        normal, slope = np.zeros((2, 2)), np.zeros(2)
        for i, part in enumerate(parts):
            both = _spectra(waves[i], part.lines) * part.answer
            normal += (both.conj() @ both.T).real
            slope += (both.conj() @ part.left).real
            if k + 1 < len(turns):
                waves[i] = waves[i] * steps[i]
        gains[k] = slope @ np.linalg.lstsq(normal, slope, rcond=1e-9)[0]
    return gains


def _spectra(wave: ComplexArray, lines: slice) -> ComplexArray:
    """Return the spectra of the cosine and the sine, (2, lines), of one complex wave."""
    whole = np.fft.fft(wave, 2 * len(wave))
    here, mirrored = whole[lines], np.conj(np.roll(whole[::-1], 1)[lines])
    return np.stack([(here + mirrored) / 2, (here - mirrored) / 2j])


def _peaks(gains: FloatArray, most: int) -> list[int]:
    """Return the highest points that are not on the slope of a higher one."""
    found: list[int] = []
    for i in np.argsort(-gains).tolist():
        if all(abs(i - j) > A_TURN for j in found):
            found.append(i)
        if len(found) == most:
            break
    return found
