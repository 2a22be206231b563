"""The interface between the diagnosis and a machine, whatever is driven and measured."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import inf

import numpy as np
from numpy.typing import NDArray

from ffcomp.measurement.faults import REPEATS_REMEDY, RepeatComparison
from models.arrays import FloatArray
from models.effects.catalogue import CATALOGUE, catalogue_of
from models.effects.effect import Effect, EffectParameter
from models.machine import Machine
from models.quantities import Quantities

REACH_SD = 3.0  # standard deviations: the range for retuning the file's numbers; further off, something is missing


@dataclass(frozen=True)
class Parameter:
    """A parameter that a fit may move; its prior is normal about `start`."""

    name: str  # as in the machine file: carriage.belt_stiffness_n_per_m, effects.coulomb_friction.force_n
    start: float
    sd: float
    low: float = float("-inf")
    high: float = float("inf")

    @classmethod
    def near(cls, name: str, start: float, sd: float) -> Parameter:
        """Return a parameter that stays within `REACH_SD` of its start; a positive one stays positive."""
        low = start - REACH_SD * sd
        return cls(name, start, sd, max(low, 0.001 * start) if start > 0 else low, start + REACH_SD * sd)


def stem_of(name: str) -> str:
    """Return a parameter's name without the tower or axis that it is of."""
    return name.partition("[")[0]


def declared_parameter(n: Parameter) -> EffectParameter:
    """Return the declaration of an effect's parameter."""
    _, effect, key = stem_of(n.name).split(".")
    return CATALOGUE[effect].by_name[key]


def number_of(name: str) -> str:
    """Return an effect's parameter without its law: laws of one cause share the numbers of one name."""
    first, _, rest = name.partition(".")
    law, _, own = rest.partition(".")
    return f"{CATALOGUE[law].cause}.{own}" if first == "effects" else name


def carried_over(values: Mapping[str, float], name: str) -> float | None:
    """Return a parameter from values of another form or law of its effect; None if they do not have it.

    One for all towers serves each, and the mean of the towers' serves all.
    """
    own = number_of(name)
    known = {number_of(key): x for key, x in values.items() if stem_of(number_of(key)) == stem_of(own)}
    if (x := known.get(own, known.get(stem_of(own)))) is not None:
        return x
    return float(np.mean(list(known.values()))) if known else None


@dataclass(frozen=True)
class Candidate:
    """An effect that may be missing. Its amplitudes vanish at their `start`; its shapes begin at one of `grid`."""

    name: str
    amplitudes: tuple[Parameter, ...]
    probe: Mapping[str, float]  # its signature is taken at these amplitudes
    shapes: tuple[Parameter, ...] = ()
    grid: tuple[Mapping[str, float], ...] = ({},)
    finer: tuple[Parameter, ...] = ()  # shapes that have a usual value: fitted only once the effect is chosen
    alternative: tuple[Parameter, ...] = ()  # shapes in place of the finer ones: of another kind of the same effect
    other: Candidate | None = None  # the same effect with a parameter for each tower, or alike in all directions
    switch: bool = False  # there or not: its one amplitude is 1 or 0
    # numbers of the file that do what its amplitudes do: by how much with each amplitude's z, (a,)
    replaces: Mapping[str, FloatArray] = field(default_factory=dict)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Amplitudes, then shapes."""
        return (*self.amplitudes, *self.shapes)

    @property
    def shaped(self) -> Candidate:
        """The same effect with its finer shapes free."""
        return replace(self, shapes=(*self.shapes, *self.finer), finer=(), alternative=())

    @property
    def of_alternative_kind(self) -> Candidate:
        """The same effect with the shapes of its alternative kind."""
        if not self.alternative:
            return self
        return replace(self, shapes=(*self.shapes, *self.alternative), finer=(), alternative=())


@dataclass(frozen=True, eq=False)
class Observation:
    """One recording, prepared for comparison: n samples of m signals, NaN where nothing was measured."""

    name: str
    repeat_of: str  # observations that share it repeat one experiment
    position: tuple[float, ...]  # on the bed, mm; of an axis the window of time, s: held out together
    rate_hz: float
    signals: tuple[str, ...]
    measured: FloatArray  # (n, m), all in one unit a signal
    speed: FloatArray  # (n, m) of the part each signal is measured on, in the reference motion
    clocks: tuple[str, ...] = ()  # the clock of each signal: "" the first; none named: all of one

    @cached_property
    def by_clock(self) -> Mapping[str, list[int]]:
        """The signals of each of its clocks, by index."""
        signals: dict[str, list[int]] = {}
        for i, clock in enumerate(self.clocks or ("",) * len(self.signals)):
            signals.setdefault(clock, []).append(i)
        return signals

    @cached_property
    def missing(self) -> NDArray[np.bool_] | None:
        """(n, m) where nothing was measured; None if nothing is missing."""
        missing = ~np.isfinite(self.measured)
        return missing if missing.any() else None


class InfeasibleParameters(ValueError):
    """Raised for parameters that the machine cannot be simulated with; a fit must not go there."""


@dataclass(frozen=True, kw_only=True)
class Repeats(RepeatComparison):
    """One experiment that was recorded several times."""

    members: tuple[int, ...]  # indices of its observations
    files: tuple[str, ...]
    signals: tuple[str, ...]  # that were compared, of one clock

    def late(self) -> str:
        """Say how far apart they lie, in a sentence."""
        first, last = (self.files[int(f(self.lag_s))] for f in (np.argmin, np.argmax))
        apart = 1e3 * (max(self.lag_s) - min(self.lag_s))
        return f"{last} lies {apart:.2g} ms late against {first}, which repeats the same motion"

    def trouble(self) -> str:
        """Say that they do not repeat, and what to do, in full sentences."""
        return (
            f"{' and '.join(self.files[:2])} are named as repeats, but these repeats do not repeat: they differ by "
            f"{self.difference}. {REPEATS_REMEDY}; and leave these files out."
        )


@dataclass
class Work:
    """The simulations so far, and how much may be before a search tries nothing more.

    Integration steps are counted and not seconds, so that the same recordings get the same verdict on every computer,
    however busy.
    """

    limit: float = inf
    steps: float = 0.0
    cut: bool = False  # something was left untried

    def add(self, steps: float) -> None:
        """Count what is simulated."""
        self.steps += steps

    def allows(self) -> bool:
        """Tell whether another thing may be tried; where it may not, that is remembered."""
        spent = self.steps >= self.limit
        self.cut = self.cut or spent
        return not spent

    def begin(self, limit: float) -> None:
        """Begin a search that may simulate so much from now on."""
        self.limit, self.cut = self.steps + limit, False


class Problem(ABC):
    """A machine, its observations, and what it would have measured with other parameters."""

    machine: Machine
    band_hz: tuple[float, float]  # where measurement and model are compared
    observations: Sequence[Observation]
    motions: Sequence[int]  # the number of each observation's motion: repeats share one, and its simulation
    parameters: Sequence[Parameter]  # retuned within their uncertainty: no missing effect
    candidates: Sequence[Candidate]
    repeats: Sequence[Repeats] = ()
    commands: Sequence[FloatArray] = ()  # (n, 3) mm of a printer's carriages, of each observation
    commanded: bool = True  # by a position, which a firmware may shape; else by a force
    forces: bool = False  # compared are the drive's force and the one that the measured motion needs, not signals
    least_density: Mapping[str, float | FloatArray] = {}  # of a signal's noise, unit²/Hz (at `noise_grid`), at least

    @cached_property
    def work(self) -> Work:
        """The simulations so far."""
        return Work()

    @property
    def quantities(self) -> Quantities:
        """Keys, units and scales of the machine's file."""
        return self.machine.vibration.quantities

    @property
    def catalogue(self) -> Mapping[str, Effect]:
        """The effects in the words of the machine's kind."""
        return catalogue_of(self.quantities, self.machine.vibration.moves)

    @abstractmethod
    def simulate(
        self, values: Mapping[str, float], only: Sequence[int] | None = None, *, coarse: bool = False
    ) -> list[FloatArray]:
        """Simulate every observation, or those in `only`, (n, m) each; InfeasibleParameters where it cannot.

        values : parameters by name; the others keep their values.
        coarse : quicker, with kinks rounded off: good enough to rank candidates.
        """

    def stated(self, values: Mapping[str, float], name: str) -> float:
        """Return a number of the machine as the file states it; some values limit others."""
        return values[name]

    @abstractmethod
    def only(self, chosen: Sequence[int]) -> Problem:
        """Return the problem with some of its observations, by index: all that are of one motion, or none."""

    def excerpt(self) -> Problem | None:
        """Return the problem on a part of its observations, which is quicker; None if there is none."""
        return None

    def compared(self) -> Problem:
        """Return the problem by which the recordings are judged: of forces, where they drive a free axis; else this."""
        return self

    def by_force(self) -> Problem:
        """Return the problem whose residual is a force, where force and motion are measured; else this one."""
        return self

    def moved(self, i: int) -> Mapping[str, FloatArray]:
        """Return what the residual of an observation may depend on: `pos`, `vel`, `acc` or `force`, (n, m) each."""
        return {"vel": self.observations[i].speed}

    def simulate_many(
        self, many: Sequence[Mapping[str, float]], only: Sequence[int] | None = None, *, coarse: bool = False
    ) -> Iterator[list[FloatArray] | InfeasibleParameters]:
        """Simulate several sets of values in order; override it where a batch is quicker."""
        for values in many:
            try:
                yield self.simulate(values, only, coarse=coarse)
            except InfeasibleParameters as error:
                yield error
