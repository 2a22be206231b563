"""What `identify fit` returns: one result for each kind of measurement, its JSON object and its machine file."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import date
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from ffcomp.errors import MeasurementError
from ffcomp.identification.axes import IdentifiedAxes
from ffcomp.identification.belts import BeltComparison
from ffcomp.identification.direct import scale_is_weak
from ffcomp.identification.from_resonances import ResonanceStart
from ffcomp.identification.modal_fit import AxisFit
from ffcomp.identification.output_error import Fitted
from ffcomp.identification.paper import PaperIdentification
from ffcomp.identification.uncertainty import Estimate
from ffcomp.numerics.serialise import keys
from ffcomp.result import Fact, Result
from ffcomp.shapers.calibration import ShaperAdvice, in_words
from gcode.atomic_write import replace_atomically
from models.file import check_text, updated_text
from models.machine import Machine, value_of

SMALLEST_SD = 0.002  # relative: no frequency of a printer is more constant from day to day


@dataclass(frozen=True)
class Origin:
    """What a new machine file comes from."""

    start: Machine  # of the starting file
    name: str  # of the new machine
    data: Sequence[str] = ()  # file names with hashes
    day: str = field(default_factory=lambda: date.today().isoformat())

    def note(self, estimates: Sequence[Estimate], verb: str) -> str:
        """Say where the value of a key, or its list, is from."""
        intervals = ", ".join(f"{e.low:.4g} to {e.high:.4g}" for e in estimates)
        return f"identified {self.day} by ffcomp identify {verb}; 90 % interval {intervals}"

    def table(self, **more: Any) -> dict[str, Any]:
        """Return the table of a file's `[provenance]`, with more that a verb states."""
        return {"date": self.day, "started_from": Path(self.start.path).stem, "data": list(self.data), **more}

    def text_of(
        self,
        parameters: Mapping[str, Estimate | Sequence[Estimate]],
        verb: str,
        others: Mapping[str, Any] | None = None,
        provenance: Mapping[str, str] | None = None,
        **identified: Any,
    ) -> str:
        """Write the starting file's text with what a verb has identified, one by one or as lists, and other values."""
        by_key: dict[str, list[Estimate]] = {}
        values = dict[str, Any]()
        for key, found in parameters.items():
            values[key] = _rounded(found) if isinstance(found, Estimate) else [_rounded(each) for each in found]
            by_key.setdefault(key.partition("[")[0], []).extend([found] if isinstance(found, Estimate) else found)
        spreads = {key: max(min(e.relative_sd, 10.0) for e in each) for key, each in by_key.items()}
        least = {key: SMALLEST_SD if key.startswith("axes.") else 0.0 for key in by_key}
        uncertainty = {key: float(f"{max(least[key], spread):.2g}") for key, spread in spreads.items()}
        notes = {key: self.note(each, verb) for key, each in by_key.items()}
        sources = {**notes, **(provenance or {}), "identified": self.table(**identified)}
        values |= others or {}
        return updated_text(Path(self.start.path), values, name=self.name, uncertainty=uncertainty, provenance=sources)


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class MachineFit(Result):
    """A machine file's parameters as measurements give them."""

    method: ClassVar[str] = ""
    schema: ClassVar[str] = "ffcomp-identify-fit/1"
    json_keys: ClassVar[dict[str, str]] = {"data": "origin.data"} | keys(
        "skipped", "method", "advice", "output", started_from="origin.start", shapers="shapers?"
    )
    page_by = "ffcomp.report.identify:page_of"
    drawn_by = {"fit": "ffcomp.report.identify:figure_of"}  # noqa: RUF012 (the base states its type)

    origin: Origin
    text: str = ""  # of the new machine file; empty: the data do not make one
    skipped: Sequence[str] = ()  # sentences on data that were not used
    advice: Sequence[str] = ()  # sentences
    refusal: Sequence[str] = ()  # sentences: why there is no machine file
    belts: BeltComparison | None = None
    shapers: tuple[ShaperAdvice, ...] = ()  # for those who stay with one
    output: Path | None = None  # the machine file that was written

    @property
    def found(self) -> Sequence[Fact]:
        """What the method found."""
        return ()

    @property
    def facts(self) -> list[Fact]:
        """What the method found, about belts and input shapers too, and the file that was written."""
        facts = [*self.found, *(() if self.belts is None else belt_facts(self.belts))]
        facts += [("Input shaper", in_words(self.shapers)), ("Machine file", str(self.output or ""))]
        return [(name, value) for name, value in facts if value not in ("", self.headline)]

    @property
    def warnings(self) -> list[str]:
        """Sentences on data that were not used, on weak numbers, and on the next measurement."""
        return list(dict.fromkeys([*self.skipped, *self.advice]))

    @property
    def next_steps(self) -> list[str]:
        """Look at the machine file."""
        return [f"Look at it: ffcomp machines show {self.output}"] if self.output else []

    def write(self, path: Path) -> Self:
        """Write the machine file, whole or not at all, and return the result with its path.

        Raises MachineFileError if the text is no valid machine file; MeasurementError if the data do not make a machine
        file.
        """
        if not self.text:
            reasons = self.refusal or ("These data hold no resonance, so there is no machine file to write.",)
            raise MeasurementError(str(path), list(reasons))
        check_text(self.text, str(path))
        replace_atomically(path, [line.encode() for line in self.text.splitlines(keepends=True)])
        return replace(self, output=path)


WITH_BELTS = MachineFit.json_keys | keys(belts="belts?")


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class ParametersFit(MachineFit):
    """All parameters of a delta, fitted to all frequency responses."""

    method = "direct"
    json_keys = WITH_BELTS | keys(
        numbers="result.estimates",
        delays_s="result.delays_s",
        rotation_deg="result.rotation_deg",
        kept="result.kept",
        weak="result.weak",
        misfit="result.misfit",
        model_error="result.model_error",
        responses="result.explained",
        **{"common_scale.sd": "result.common_scale_sd", "common_scale.numbers": "beside_scale"},
    )

    result: Fitted

    @property
    def beside_scale(self) -> Mapping[str, Estimate]:
        """The parameters where the common scale of masses, stiffnesses and dampings is weak, that scale being known."""
        return self.result.beside_scale if scale_is_weak(self.result) else {}

    @property
    def headline(self) -> str:
        """How many responses are explained, and which one worst."""
        fitted, count = self.result, len(self.result.responses)
        pairs = [(float(e), i) for i, e in enumerate(fitted.model_errors) if e > 0]
        if not pairs:
            which = f"all {count} responses to their" if count > 1 else "the response to its"
            return f"The model explains {which} noise (misfit {fitted.misfit:.2f})."
        error, i = max(pairs)
        return (
            f"The model explains {count - len(pairs)} of {count} responses to their noise, the others to "
            f"{100 * min(pairs)[0]:.1f}-{100 * error:.1f} % of their values; worst {fitted.responses[i].input} to "
            f"{fitted.responses[i].output}."
        )

    @property
    def found(self) -> list[Fact]:
        """Every parameter."""
        fitted, kept = self.result, self.result.kept
        numbers = {key: e for key, e in {**fitted.estimates, **self.beside_scale}.items() if key not in kept}
        unchanged = "unchanged: the data do not determine it"
        return [*number_facts(numbers), *((key, f"{value_of(fitted.machine, key):.5g}, {unchanged}") for key in kept)]


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class StepwiseFit(MachineFit):
    """The same by the paper's method."""

    method = "stepwise"
    json_keys = WITH_BELTS | keys(steps="result.steps")

    result: PaperIdentification

    @property
    def headline(self) -> str:
        """How well the steps agree with themselves."""
        worst = max(self.result.steps, key=lambda step: step.consistency)
        return (
            f"{len(self.result.steps)} steps of the paper's method; their redundant equations agree worst in "
            f"{worst.title} (χ² {worst.consistency:.2f} per degree of freedom)."
        )

    @property
    def found(self) -> list[Fact]:
        """The parameters of each step."""
        facts = list[Fact]()
        for step in self.result.steps:
            agreed = (step.title, f"χ² {step.consistency:.2f} per degree of freedom")
            facts += [agreed, *number_facts(step.estimates)]
        return facts


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class AxesFit(MachineFit):
    """The modes of cartesian and CoreXY axes."""

    method = "axes"
    json_keys = WITH_BELTS | keys("axes", exchange="result.exchange.delta")

    result: IdentifiedAxes

    @property
    def axes(self) -> dict[str, AxisFit]:
        """The axes by name."""
        return {axis.name: axis for axis in self.result.axes}

    @property
    def headline(self) -> str:
        """Where each axis resonates."""
        return _resonances(self.result.axes)

    @property
    def found(self) -> list[Fact]:
        """Modes of each axis, and how well they explain its data."""
        return [fact for axis in self.result.axes for fact in _axis_facts(axis)]


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class BeltsFit(MachineFit):
    """Belts compared; they make no machine file."""

    method = "belts"
    json_keys = WITH_BELTS

    @property
    def headline(self) -> str:
        """The finding."""
        return "" if self.belts is None else self.belts.sentence


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class ResonancesFit(MachineFit):
    """Resonances of a delta where nothing else is known, and a starting file of them."""

    method = "modes"
    json_keys = WITH_BELTS | keys("axes", numbers="started.estimates?")

    axes: Mapping[str, AxisFit]
    started: ResonanceStart | None = None

    @property
    def headline(self) -> str:
        """Where it resonates."""
        if self.started is not None:
            hz = " and ".join(f"{f:.1f}" for f in self.started.predicted_hz)
            return f"The machine's modes are moved to {hz} Hz."
        if not self.axes and self.belts is not None:
            return self.belts.sentence
        return _resonances(self.axes.values()) if self.axes else "These spectra have no clear resonance."

    @property
    def found(self) -> list[Fact]:
        """Modes of each axis, and the parameters of a starting file."""
        facts = [fact for axis in self.axes.values() for fact in _axis_facts(axis)]
        return facts if self.started is None else [*facts, *number_facts(self.started.estimates)]


def number_facts(numbers: Mapping[str, Estimate]) -> list[Fact]:
    """Return each parameter with its 90 % interval."""
    facts = []
    for key, e in numbers.items():
        percent = f" ± {100 * e.sd / abs(e.value):.2g} %" if e.value else ""
        facts.append((key, f"{e.value:.5g}{percent} (90 %: {e.low:.4g} to {e.high:.4g})"))
    return facts


def _resonances(axes: Iterable[AxisFit]) -> str:
    each = (f"{a.name} at {' and '.join(f'{mode.frequency_hz.value:.1f}' for mode in a.modes)} Hz" for a in axes)
    return f"Resonances: {', '.join(each)}."


def _axis_facts(axis: AxisFit) -> Iterator[Fact]:
    for mode in axis.modes:
        share = f", share {mode.share}" if len(axis.modes) > 1 else ""
        yield f"Along {axis.name}", f"{mode.frequency_hz} Hz, ζ {mode.damping_ratio}{share}"
    yield f"Along {axis.name}", axis.verdict
    for each in axis.explained:
        explained = f"{100 * each.model_error:.1f} %" if each.model_error else "its noise"
        yield each.source, f"explained to {explained} ({each.lines} frequencies)"


def belt_facts(belts: BeltComparison) -> Iterator[Fact]:
    """Yield the finding, each belt against the others, and how well each test is explained."""
    yield "Belts", belts.sentence
    for name, e in belts.relative_stiffness.items():
        what = f"tower {name}" if belts.kind == "tower" else f"belt of axis={name}"
        interval = f"90 %: {100 * e.low:+.0f} to {100 * e.high:+.0f} %"
        yield what, f"{100 * e.value:+.1f} % ({interval}) against the mean of the others"
    yield "Head", f"resonates at {' and '.join(f'{e} Hz' for e in belts.modes_hz)}"
    for each in belts.tests:
        yield each.test.spectrum.source, f"explained to {100 * each.model_error:.1f} %"


def hash_of(path: Path) -> str:
    """Return a file's name with the hash of its content, for provenance."""
    return f"{path.name} sha256:{hashlib.sha256(path.read_bytes()).hexdigest()}"


def _rounded(estimate: Estimate) -> float:
    """Round to a tenth of the standard uncertainty."""
    if not estimate.sd > 0 or not np.isfinite(estimate.sd):
        return float(f"{estimate.value:.6g}")
    digits = int(np.clip(np.ceil(np.log10(abs(estimate.value) / estimate.sd)) + 2, 3, 8))
    return float(f"{estimate.value:.{digits}g}")


def axes_file_text(origin: Origin, result: IdentifiedAxes) -> str:
    """Write the file of a machine of modal axes: `[axes.x]` and its like, of the axes that were measured."""
    parameters: dict[str, Estimate | Sequence[Estimate]] = {}
    others: dict[str, Any] = {f"axes.{axis.name}.share": _shares(axis) for axis in result.axes}
    for axis in result.axes:
        parameters[f"axes.{axis.name}.frequency_hz"] = [mode.frequency_hz for mode in axis.modes]
        parameters[f"axes.{axis.name}.damping_ratio"] = [mode.damping_ratio for mode in axis.modes]
    notes = {f"axes.{axis.name}": axis.verdict for axis in result.axes}
    notes |= {f"axes.{a.name}.share": origin.note([mode.share for mode in a.modes], "fit") for a in result.axes}
    if result.exchange is not None:
        delta = result.exchange.delta
        others["axes.exchange"] = round(delta.value, 4)
        notes["axes.exchange"] = origin.note([delta], "fit")
    model_errors = {axis.name: float(f"{max(axis.errors):.3g}") for axis in result.axes}
    return origin.text_of(parameters, "fit", others, notes, model_error_share=model_errors)


def _shares(axis: AxisFit) -> list[float]:
    """Round to three decimals, and to a sum of one."""
    if len(axis.modes) == 1:
        return [1.0]
    first = round(axis.modes[0].share.value, 3)
    return [first, round(1.0 - first, 3)]
