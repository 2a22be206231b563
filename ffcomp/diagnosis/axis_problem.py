"""The diagnosis of one axis: a position or a force in; positions or an acceleration out.

An axis has one place only; windows of time are held out instead, the same of all runs at once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ffcomp.diagnosis.candidates import axis_candidates, effect_tables, machine_parameters
from ffcomp.diagnosis.observations import quick_length
from ffcomp.diagnosis.pitches import likely_pitches, pitches_of_force
from ffcomp.diagnosis.problem import InfeasibleParameters, Observation, Parameter, Problem
from ffcomp.identification.axis_shots import Shots, band_of, noise_sd, scales_of, shots_of, windows
from ffcomp.measurement.axis_run import AxisRun
from models.arrays import FloatArray
from models.effects.catalogue import CATALOGUE, catalogue_of, with_effects
from models.kinds import driven_axis
from models.machine import Machine, with_values

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
