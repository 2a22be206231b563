"""The diagnosis of one axis: a position or a force in; positions or an acceleration out.

An axis has one place only; windows of time are held out instead, the same of all runs at once.

Its file states no pitch of a ripple, so pitches are looked for in the data. A ripple repeats every pitch along the way:
a cos(2π u/p) in the order, or in the force. The axis answers it linearly, so that for every pitch the two numbers of
amplitude and phase follow from one 2 × 2 system (Lomb 1976, with position in place of time). From one try to the
next the ripple shifts by a quarter of a turn over the whole travel, or a short pitch falls between them. Where a
simulation restarts all the time, it leaves too little of a ripple. There the force is known, and what of it inertia
and friction do not explain is searched line by line (matching pursuit; Mallat and Zhang 1993).

A known force that drives an axis is as much the answer to its motion as its cause: under feedback the axis may hardly
move while its drive holds all that is missing, and simulated from that force alone it runs away. So `ForceBalance`
compares the force with the one that the measured motion needs (inverse dynamics, as robots are identified; Gautier
1986), by the noise that an encoder makes in it. Of a motor and its load each is compared by itself: the force that the
one needs, and the place to which its motion takes the other: the friction of the motor would hide the load.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import uniform_filter1d

from ffcomp.diagnosis.candidates import axis_candidates, machine_parameters, machine_with
from ffcomp.diagnosis.noise import SIMULATION_ERROR, density_of, noise_grid
from ffcomp.diagnosis.observations import quick_length
from ffcomp.diagnosis.problem import InfeasibleParameters, Observation, Parameter, Problem
from ffcomp.identification.axis_shots import (
    Shots,
    band_of,
    load_began,
    noise_sd,
    scales_of,
    shots_of,
    speed_of,
    windows,
)
from ffcomp.measurement.axis_run import AxisRun
from ffcomp.record.clock import peaks
from models.arrays import ComplexArray, FloatArray
from models.effects.catalogue import CATALOGUE
from models.kinds import driven_axis
from models.machine import Machine, with_values
from models.printer.one_axis import axis_parameters, simulate_axis, simulate_load
from models.vibration.driven_axis import DrivenAxis

OFFSET, LATENESS = "axis.offset_n", "axis.drive.delay_s"
FORCE_OFFSET = 0.3  # of the force: a constant one, or the error of a sensor's zero, which no file states
MOST_LINES = 6  # of a force that repeats along an axis
MOST_PITCHES = 4  # where a search for a ripple begins
HELD = 0.5  # of a sample: a force that a controller holds acts so much later than a straight line between samples
KEPT = 6  # motions that are held
HEAVY_KG = 1e9  # of a mass that forces leave where it is
STEP_COST = 2.0  # of a printer's steps: these take no lanes
RIPPLES = frozenset(name for name, effect in CATALOGUE.items() if any(p.is_pitch for p in effect.shapes))

_Key = tuple[tuple[tuple[str, float], ...], bool, int]


@dataclass(frozen=True)
class Window:
    """A part of a run that is compared."""

    run: int
    rows: slice


class AxisProblem(Problem):
    """The machine file of an axis, and its runs."""

    def __init__(self, machine: Machine, runs: Sequence[AxisRun], names: Sequence[str] = tuple(CATALOGUE)) -> None:
        self.machine, self.commanded = machine, not driven_axis(machine).by_force
        self.shots = shots_of(machine, runs)
        self.places = [one.run.place for one in self.shots]
        self.band_hz = band_of(self.shots)
        self.windows = [
            Window(i, slice(rows.start, rows.start + quick_length(rows.stop - rows.start)))
            for i, one in enumerate(self.shots)
            for rows in windows(one)
        ]
        self.observations = [_observation(self.shots[w.run], w.rows) for w in self.windows]
        scales = replace(scales_of(machine, self.shots), highest_hz=self.band_hz[1])
        self.parameters = tuple(machine_parameters(machine))
        if not self.commanded:  # the zero of a measured force may be off, and no file states when in a sample it acts
            axis, late = driven_axis(machine), HELD / min(run.sample_rate_hz for run in runs)
            self.parameters += (
                Parameter.near(OFFSET, axis.offset_n, FORCE_OFFSET * scales.force_n),
                Parameter.near(LATENESS, axis.drive.delay_s, late),
            )
        signals = sorted({name for run in runs for name in run.signals})
        self._same = [_first_equal(self.shots, i) for i in range(len(runs))]
        self.motions = [self._same[window.run] for window in self.windows]
        lines: list[float] = []
        pitches: list[float] = []
        if RIPPLES & set(names):
            distinct = [self.shots[i] for i in sorted(set(self._same))]
            if any(one.length for one in self.shots):  # it restarts all the time, and leaves too little of a ripple
                lines = pitches_of_force(machine, distinct, MOST_LINES)
            else:
                pitches = likely_pitches(machine, distinct, self.band_hz, MOST_PITCHES)
        self.candidates = axis_candidates(machine, scales, signals, names, pitches, lines)
        self.least_density = self._least_density(signals)
        self._kept: dict[_Key, dict[str, FloatArray]] = {}

    def _least_density(self, signals: Sequence[str]) -> dict[str, float | FloatArray]:
        """Return the least density of each position's noise: of its sensor, and of how exact a simulation can be."""
        density: dict[str, float | FloatArray] = {}
        for name in (s for s in signals if s.startswith("pos")):
            shots = [one for one in self.shots if name in one.run.signals]
            rate = min(one.run.sample_rate_hz for one in shots)
            each = [noise_sd(x[np.isfinite(x)]) for x in (one.run.position[name] for one in shots)]
            # of a free axis a quick run's bends would pass for noise, and by that hide what its shots show
            sensor = float(np.median(each) if driven_axis(self.machine).free else np.max(each))
            # the motion that a position signal adds to the start of each shot, or to its command
            moved = [
                one.without_beginnings(one.run.signals)[name] if one.length else one.forced_motion(name)
                for one in shots
            ]
            motion = float(np.sqrt(np.mean([np.nanmean(x**2) for x in moved])))
            error = (SIMULATION_ERROR * motion) ** 2 / (self.band_hz[1] - self.band_hz[0])
            density[name] = 2 * sensor**2 / rate + error
        return density

    def simulate(
        self, values: Mapping[str, float], only: Sequence[int] | None = None, *, coarse: bool = False
    ) -> list[FloatArray]:
        """Simulate windows of the runs: (n, m) each."""
        machine = self.machine_with(values)
        chosen = range(len(self.windows)) if only is None else only
        key = (tuple(sorted(values.items())), coarse)
        compared: dict[int, FloatArray] = {}
        for run in dict.fromkeys(self.windows[i].run for i in chosen):
            one, sensed = self.shots[run], self._sensed(machine, (*key, self._same[run]))
            signals = one.without_beginnings({s: sensed[s] for s in one.run.signals})
            compared[run] = np.stack(list(signals.values()), axis=1)
        return [compared[self.windows[i].run][self.windows[i].rows] for i in chosen]

    def only(self, chosen: Sequence[int]) -> AxisProblem:
        """Return the problem with some of its windows, see `Problem.only`."""
        part = copy(self)
        part.windows = [self.windows[i] for i in chosen]
        part.observations = [self.observations[i] for i in chosen]
        part.motions = [self.motions[i] for i in chosen]
        return part

    def _sensed(self, machine: Machine, key: _Key) -> dict[str, FloatArray]:
        """Return what the sensors of a run would read; the last few are kept, for windows ask one by one."""
        if key not in self._kept:
            try:
                self._kept[key] = self._read(machine, *key[1:])
            except ValueError as error:
                raise InfeasibleParameters(str(error)) from None
            for old in list(self._kept)[: -KEPT * len(self.shots)]:
                del self._kept[old]
        return self._kept[key]

    def _read(self, machine: Machine, coarse: bool, run: int) -> dict[str, FloatArray]:
        motion = self.shots[run].simulate(machine, coarse=coarse)
        self.work.add(STEP_COST * motion.steps)
        return motion.sensed(machine)

    def compared(self) -> AxisProblem:
        """Return the problem of the forces, where a known force drives an axis without a spring to the ground."""
        driven = driven_axis(self.machine).free and any(bool(one.run.drive.any()) for one in self.shots)
        return self.by_force() if driven else self

    def by_force(self) -> AxisProblem:
        """Return the problem of the forces, where the drive's is known, and where each mass is at every sample."""
        needed = ("pos_q", "pos_motor") if driven_axis(self.machine).load_mass_kg else ()
        places = [*self.places, *(one.run.position.get(s, np.array(np.nan)) for one in self.shots for s in needed)]
        known = not (self.commanded or self.forces) and all(bool(np.isfinite(place).all()) for place in places)
        return ForceBalance(self) if known else self

    def moved(self, i: int) -> Mapping[str, FloatArray]:
        """Return position, speed, and the drive's force or the acceleration of a window, (n, m) each."""
        window, axis = self.windows[i], driven_axis(self.machine)
        one, place, signals = self.shots[window.run], self.places[window.run], len(self.observations[i].signals)
        moved = {"pos": place, "vel": one.speed}
        if self.commanded:
            moved["acc"] = 1e-3 * np.gradient(one.speed, 1 / one.run.sample_rate_hz)
        else:
            moved["force"] = axis.force_of(one.run.drive, one.run.supply_v)
        return {name: np.tile(x[window.rows, None], (1, signals)) for name, x in moved.items()}

    def machine_with(self, values: Mapping[str, float]) -> Machine:
        """Return the machine file's axis with these parameters and effects."""
        return machine_with(self.machine, values)


class ForceBalance(AxisProblem):
    """The force of the drive next to the one that the measured motion needs: at every sample, from its state there."""

    forces = True

    def __init__(self, problem: AxisProblem) -> None:
        self.__dict__.update(problem.__dict__)
        axis, shots = driven_axis(self.machine), problem.shots
        self._driven = [replace(one, length=1, begin=_states(one), began={}) for one in shots]
        self._accelerations = [_acceleration(one.begin[:, 2], one.run.sample_rate_hz) for one in self._driven]
        self.shots = [self._compared(one, axis) for one in shots]
        self.band_hz = (0.0, band_of([replace(one, length=0) for one in self.shots])[1])  # a constant force is one too
        self.observations = [_observation(self.shots[w.run], w.rows) for w in self.windows]
        self.least_density, self._kept = self._densities(problem, axis), {}
        self.band_hz = (0.0, min(self.band_hz[1], self._last_heard(self.least_density["force"])))

    def _densities(self, problem: AxisProblem, axis: DrivenAxis) -> dict[str, FloatArray]:
        """Return the density of the noise of forces and of a load's place, (k,) N²/Hz and mm²/Hz at `noise_grid`.

        Encoders' noise becomes a force by the axis' inverse response, m s² + c s + k; that of a motor moves its load.
        """
        s, mass = 2j * np.pi * noise_grid(self.observations), axis.load_mass_kg or 0.0
        pull = (axis.coupling_stiffness_n_per_m or 0.0) + axis.coupling_damping_n_s_per_m * s if mass else 0.0 * s
        response = axis.mass_kg * s**2 + axis.ground_damping * s + axis.spring_n_per_m + pull

        def density(columns: Sequence[FloatArray]) -> float:
            rates = [one.run.sample_rate_hz for one in self.shots]
            return float(np.median([2 * noise_sd(x) ** 2 / rate for x, rate in zip(columns, rates, strict=True)]))

        def error(name: str) -> float:
            known = [one.without_beginnings(one.run.signals)[name] for one in self.shots]
            return float(np.mean([np.mean(x**2) for x in known]) * SIMULATION_ERROR**2 / self.band_hz[1])

        motor = density([one.run.position.get("pos_motor", one.run.place) for one in problem.shots])
        load = density(problem.places) if mass else 0.0
        encoders = 1e-6 * (np.abs(response) ** 2 * motor + np.abs(pull) ** 2 * load)
        found = {"force": encoders + density([one.run.signals["force"] for one in self.shots]) + error("force")}
        if mass:  # in a shot it has no time to ring up
            begun = s + (self.shots[0].run.sample_rate_hz / self.shots[0].length if self.shots[0].length else 0.0)
            found["pos_q"] = load + np.abs(pull / (mass * begun**2 + pull)) ** 2 * motor + error("pos_q")
        return found

    def _last_heard(self, noise: FloatArray) -> float:
        """Return the frequency, Hz, beyond which the drive's force is below the noise of what the motion needs."""
        grid = noise_grid(self.observations)
        signal = np.mean([density_of(one.run.signals["force"], one.run.sample_rate_hz, grid) for one in self.shots], 0)
        return float(grid[max(int(np.argmax(np.cumsum(signal - noise))), 2)])

    def _compared(self, one: Shots, axis: DrivenAxis) -> Shots:
        """Return the drive's force, and the place of a load from its motor's, as signals."""
        force = axis.force_of(one.run.drive, one.run.supply_v)
        run = replace(one.run, acceleration={}, position={}, other={"force": force})
        if not axis.load_mass_kg:
            return replace(one, run=run, began={})
        twist = one.run.position["pos_q"] - one.run.position["pos_motor"]
        apart = float(np.mean(twist))  # of two encoders' zeros
        run = replace(run, position={"pos_q": twist - apart})
        begin = one.begin - np.array([apart, 0.0, 0.0, 0.0])
        return replace(one, run=run, begin=begin, began={"pos_q": load_began(axis, one)} if one.length else {})

    def _read(self, machine: Machine, coarse: bool, run: int) -> dict[str, FloatArray]:
        """Return the drive's force F̂ that the measured motion of a run needs, and where that takes a load.

        Friction in proportion μ to the load grows with that force itself: F̂ = F₀ + μ t |F̂ − F_e|, where t is the
        direction of motion, F₀ the force that everything else needs, and F_e the part of it that the back EMF takes.
        The measured force must not stand on this side: with it, a share of one would explain any force.
        """
        axis, one, drive = axis_parameters(machine), self._driven[run], driven_axis(machine).drive
        needed = self._needed(machine, one, run, coarse)
        if share := axis.load_share:
            emf = 1e-3 * axis.back_emf * one.speed
            by_unit = driven_axis(machine).force_of(np.ones_like(emf), one.run.supply_v)
            load = np.abs(driven_axis(machine).force_of(one.run.drive, one.run.supply_v) - emf)
            without = self._needed(machine, replace(one, run=replace(one.run, drive=emf / by_unit)), run, coarse)
            direction = np.clip((needed - without) / np.maximum(load, 1e-12), -share, share)
            needed = emf + (without - emf) / (1 - direction * np.sign(without - emf))
        late = axis.delay * one.run.sample_rate_hz + (HELD if drive.hold == "steps" else 0.0)
        k = np.arange(len(needed))
        signals = {"force": np.interp(k + late, k, needed)}  # what acts later was recorded now
        compared = self.shots[run]
        if "pos_q" in compared.run.position:
            motor, dt_s = one.run.position["pos_motor"], 1 / one.run.sample_rate_hz
            motion = simulate_load(machine, motor, dt_s, compared.length, compared.begin)
            self.work.add(STEP_COST * motion.steps)
            signals["pos_q"] = motion.position_mm - motor
        return signals

    def _needed(self, machine: Machine, one: Shots, run: int, coarse: bool) -> FloatArray:
        """Return the force, (n,) N, that the motion needs while the drive presses as in these shots.

        It moves as measured, so that bristles bend by that motion. The mass is heavy because otherwise the integrator
        would make dry friction less steep; its own is put in afterwards.
        """
        motion = one.simulate(with_values(machine, {"axis.mass_kg": HEAVY_KG}), coarse=coarse)
        self.work.add(STEP_COST * motion.steps)
        mass = axis_parameters(machine).mass
        return mass * self._accelerations[run] + motion.force - HEAVY_KG * motion.motor_acceleration


def _states(one: Shots) -> FloatArray:
    """Return where the last mass and the first one are at every sample, and how fast: (n, 4) mm and mm/s."""
    place = one.run.place
    motor = one.run.position.get("pos_motor", place)
    motor_speed = one.speed if motor is place else speed_of(motor, one.run.sample_rate_hz)
    return np.column_stack([place, one.speed, motor, motor_speed])


def _acceleration(place_mm: FloatArray, rate_hz: float) -> FloatArray:
    """Return the second derivative of a place, (n,) m/s², by five points: not smoothed, for its noise is known."""
    padded = np.pad(1e-3 * place_mm, 2, mode="reflect", reflect_type="odd")
    return np.asarray(np.convolve(padded, np.array([-1.0, 16.0, -30.0, 16.0, -1.0]) / 12 * rate_hz**2, "valid"))


def _first_equal(shots: Sequence[Shots], i: int) -> int:
    """Return the first run that the same input drives from the same states: repeats need one simulation."""

    def alike(a: Shots, b: Shots) -> bool:
        return np.array_equal(a.run.drive, b.run.drive) and np.array_equal(a.begin, b.begin, equal_nan=True)

    return next(k for k in range(i + 1) if alike(shots[k], shots[i]))


def _observation(one: Shots, rows: slice) -> Observation:
    run, signals = one.run, tuple(one.run.signals)
    began = round(float(run.time_s[rows.start] - run.time_s[0]), 3)
    measured = np.stack(list(one.without_beginnings(run.signals).values()), axis=1)[rows]
    speed = np.tile(one.speed[rows, None], (1, len(signals)))
    name, repeat = f"{run.source} from {began:g} s", f"{run.repeat_of} from {began:g} s"
    return Observation(name, repeat, (began,), run.sample_rate_hz, signals, measured, speed)


# ---- pitches -----------------------------------------------------------------------------------------


A_TURN = 4  # tries for each turn over the travel
MOST_TRIES = 1500


@dataclass(frozen=True, eq=False)
class _Part:
    """One motion: its place, and what is left of its acceleration."""

    place: FloatArray  # (n,) mm
    left: ComplexArray  # (lines,) inside the band, weighted
    answer: ComplexArray  # (lines,) of the acceleration to the input, weighted
    taper: FloatArray  # (n,)
    lines: slice  # of the band


def likely_pitches(machine: Machine, shots: Sequence[Shots], band_hz: tuple[float, float], most: int) -> list[float]:
    """Return the pitches, mm, whose ripple explains most of what the file leaves, the best first.

    shots : runs that are simulated from beginning to end; each motion once.
    """
    parts = [part for one in shots if (part := _part(machine, one, band_hz)) is not None]
    if not parts:
        return []
    travel = max(float(np.ptp(part.place)) for part in parts)
    speed = float(np.sqrt(np.mean(np.concatenate([one.speed for one in shots]) ** 2)))
    if min(travel, speed) <= 0.0:
        return []
    first, last = 2.0 / travel, 2.0 * band_hz[1] / speed  # passed at twice the highest frequency compared
    count = min(max(int((last - first) * travel * A_TURN), 0), MOST_TRIES)
    turns = first + np.arange(count) / (A_TURN * travel)
    return [float(1.0 / turns[i]) for i in peaks(_gains(parts, turns), A_TURN, most)]


def pitches_of_force(machine: Machine, shots: Sequence[Shots], most: int) -> list[float]:
    """Return the pitches, mm, whose lines together explain most of the measured force, the strongest first.

    None where no line stands out.

    shots : runs whose force and place are known; each motion once.
    """
    axis = driven_axis(machine)
    columns, forces, places = list[FloatArray](), list[FloatArray](), list[FloatArray]()
    for one in shots:
        if not np.isfinite(one.run.place).all():
            return []
        v = one.speed / 1e3
        change = np.gradient(v, 1 / one.run.sample_rate_hz)
        thin = slice(None, None, max(len(v) // 2500, 1))  # some thousand rows show the lines
        columns.append(np.column_stack([change, v, np.sign(v), np.ones(len(v))])[thin])
        forces.append(axis.force_of(one.run.drive, one.run.supply_v)[thin])
        places.append(one.run.place[thin])
    place, force, known = np.concatenate(places), np.concatenate(forces), np.concatenate(columns)
    turns, first = _tries(axis, places), 0.0
    lines: list[int] = []
    while len(lines) < min(most, len(turns)):
        left = force - known @ np.linalg.lstsq(known, force, rcond=1e-9)[0]
        gains = np.array([abs(np.exp(2j * np.pi * turn * place) @ left) for turn in turns])
        gains[[i for i in range(len(turns)) if any(abs(turns[i] / turns[j] - 1) < 0.04 for j in lines)]] = 0.0
        best = int(np.argmax(gains))
        # a tenth of the first line, and 15 % of what is left, or it is none
        if gains[best] <= 0.1 * first or gains[best] ** 2 < 0.15 * len(left) * (left @ left) / 2:
            break
        first = max(first, float(gains[best]))
        lines.append(best)
        angle = 2 * np.pi * turns[best] * place
        known = np.column_stack([known, np.sin(angle), np.cos(angle)])
    return [float(1.0 / turns[i]) for i in lines]


def _tries(axis: DrivenAxis, places: Sequence[FloatArray]) -> FloatArray:
    """Return how often a millimetre lines may repeat: of what turns, a whole number of times a turn."""
    travel = float(np.ptp(np.concatenate(places)))
    if axis.quantities.turns:
        turn = 2e3 * np.pi
        return np.arange(max(int(np.ceil(2 * turn / max(travel, 1e-9))), 1), 401) / turn  # to 400 lines a turn
    return np.arange(2 * A_TURN, 200 * A_TURN) / A_TURN / max(travel, 1e-9)


def _part(machine: Machine, one: Shots, band_hz: tuple[float, float]) -> _Part | None:
    try:
        motion = one.simulate(machine).sensed(machine)
    except ValueError:
        return None
    run, n, rate = one.run, len(one.run.drive), one.run.sample_rate_hz
    name = next((s for s in ("acc_q", *run.signals) if s in run.signals and np.isfinite(run.signals[s]).all()), None)
    known = (x for x in run.position.values() if np.isfinite(x).all())
    place = next(known, None) if run.by_force else run.drive
    if name is None or place is None:
        return None
    frequency, taper = np.fft.rfftfreq(2 * n, 1 / rate), np.hanning(n)
    error = np.fft.rfft(taper * (run.signals[name] - motion[name]), 2 * n)
    if name != "acc_q":  # mm, to m/s²
        error = -1e-3 * (2 * np.pi * frequency) ** 2 * error
    lines = slice(*np.searchsorted(frequency, band_hz).tolist())
    weight = 1 / np.maximum(np.sqrt(uniform_filter1d(np.abs(error) ** 2, 31)), 1e-12)[lines]
    return _Part(place, weight * error[lines], weight * _answer(machine, rate, n)[lines], taper, lines)


def _answer(machine: Machine, rate_hz: float, n: int) -> ComplexArray:
    """Return the response of the last mass' acceleration to the input, (lines,), by that to a smooth pulse."""
    k = np.arange(2 * n)
    pulse = np.exp(-0.5 * ((k - 64) / 1.5) ** 2)
    sensed = simulate_axis(machine, pulse, 1 / rate_hz).sensed(machine)["acc_q"]
    driven = np.fft.rfft(pulse)
    small = np.abs(driven) < 1e-6 * np.abs(driven[0])
    return np.asarray(np.where(small, 0.0, np.fft.rfft(sensed) / np.where(small, 1.0, driven)))


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
