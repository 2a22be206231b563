"""What the diagnosis asks of a machine: one small interface, whatever is driven and measured."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from models.arrays import FloatArray


@dataclass(frozen=True)
class Number:
    """A number that a fit may move, with what is believed of it before the data: normal about `start`."""

    name: str  # as in the machine file: carriage.belt_stiffness_n_per_m, effects.coulomb_friction.force_n
    start: float
    sd: float
    low: float = float("-inf")
    high: float = float("inf")


@dataclass(frozen=True)
class Candidate:
    """An effect that may be missing. Its amplitudes vanish at their `start`; its shapes begin at one of `grid`."""

    name: str
    amplitudes: tuple[Number, ...]
    probe: Mapping[str, float]  # amplitudes at which its signature is taken
    shapes: tuple[Number, ...] = ()
    grid: tuple[Mapping[str, float], ...] = ({},)
    finer: tuple[Number, ...] = ()  # shapes that have a usual value: fitted only once the effect is chosen
    other: Candidate | None = None  # the same effect with a number for each tower, or alike in all directions
    switch: bool = False  # there or not: its one amplitude is 1 or 0

    @property
    def numbers(self) -> tuple[Number, ...]:
        return (*self.amplitudes, *self.shapes)

    @property
    def shaped(self) -> Candidate:
        """With its finer shapes free."""
        return replace(self, shapes=(*self.shapes, *self.finer), finer=())


@dataclass(frozen=True, eq=False)
class Observation:
    """What was measured in one run: n samples of m signals, all in one unit a signal; NaN where nothing was."""

    name: str
    repeat_of: str  # recordings that share it repeat one experiment
    place: tuple[float, ...]  # on the bed, mm; of an axis the stretch of time, s: what generalises is tested by place
    rate_hz: float
    signals: tuple[str, ...]
    measured: FloatArray  # (n, m)
    speed: FloatArray  # (n, m) of the part each signal is measured on, in the wanted motion; for the maps


class Impossible(ValueError):
    """A machine of such numbers does not hold together; a fit must not go there."""


class Plant(ABC):
    """A machine, its recordings, and how it would have answered with other numbers."""

    band_hz: tuple[float, float]  # where measurement and model are compared
    observations: Sequence[Observation]
    numbers: Sequence[Number]  # what may be retuned within its uncertainty: not a missing effect
    candidates: Sequence[Candidate]

    @abstractmethod
    def simulate(
        self, values: Mapping[str, float], only: Sequence[int] | None = None, *, coarse: bool = False
    ) -> list[FloatArray]:
        """(n, m) for each recording (or those in `only`); what `values` does not name stays as it is.

        coarse : quicker, with kinks rounded off: good enough to choose who is looked at closely.

        Raises
        ------
        Impossible
        """

    def simulate_many(
        self, many: Sequence[Mapping[str, float]], only: Sequence[int] | None = None, *, coarse: bool = False
    ) -> Iterator[list[FloatArray] | Impossible]:
        """The same for many; a plant that is quicker with many at once has its own way."""
        for values in many:
            try:
                yield self.simulate(values, only, coarse=coarse)
            except Impossible as error:
                yield error
