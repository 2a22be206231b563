"""The tables of the report, as text."""

from __future__ import annotations

from dataclasses import dataclass

from ffcomp.diagnose.acceptance import HeldOut
from ffcomp.diagnose.result import DiagnosisResult
from ffcomp.diagnose.summary import DiagnosisSummary
from ffcomp.report.diagnose.words import digits, evidence, interval, percent, times, times_noise, title, together
from ffcomp.report.drawing import AFTER, BEFORE, SOFT


@dataclass(frozen=True, slots=True)
class Tile:
    """One of the big numbers on top."""

    label: str
    number: str
    below: str
    colour: str
    share: float  # of the largest, %


def tiles(found: DiagnosisResult) -> list[Tile]:
    """Return the error of the simulation before and after, and that of noise alone."""
    names = " + ".join(found.effects)
    after = {"effects": f"with {names}", "none": "retuned", "unknown": f"with {names or 'retuning'}, refused"}
    before, noise = found.before.nrms, found.before.noise_nrms
    most = max(before, found.after.nrms, noise, 1e-12)
    given = [
        ("as the file is", before, f"{times(before / noise)} the noise", BEFORE),
        (after[found.verdict], found.after.nrms, f"{times(found.after.nrms / noise)} the noise", AFTER),
        ("noise alone", noise, "as two runs of one experiment differ", SOFT),
    ]
    return [Tile(label, percent(x), below, colour, 100 * x / most) for label, x, below, colour in given]


@dataclass(frozen=True, slots=True)
class EvidenceRow:
    """One hypothesis."""

    effects: str
    titles: str
    left: str  # error, times the noise
    behind: str  # in −2 ln Z
    numbers: int
    named: bool


def evidence_rows(found: DiagnosisSummary) -> list[EvidenceRow]:
    """Return the hypotheses, the likeliest first."""
    return [
        EvidenceRow(
            together(e.effects),
            "; ".join(title(name) for name in e.effects),
            digits(times_noise(e.left)),
            evidence(e.against_best),
            e.parameters,
            e.named,
        )
        for e in sorted(found.evidence, key=lambda e: e.against_best)
    ]


@dataclass(frozen=True, slots=True)
class PromiseRow:
    """One effect in the score test."""

    name: str
    title: str
    gain: str
    strength: str
    visible: bool


def promise_rows(found: DiagnosisSummary) -> list[PromiseRow]:
    """Return the effects in the score test, visible ones first."""
    return [
        PromiseRow(
            p.name,
            title(p.name),
            evidence(p.gain),
            _sigmas(p.strength),
            p.visible,
        )
        for p in sorted(found.promises, key=lambda p: (not p.visible, -p.gain))
    ]


def _sigmas(strength: float) -> str:
    return digits(strength, 2) if strength < 100 else evidence(strength)


@dataclass(frozen=True, slots=True)
class RetunedRow:
    """One retuned parameter."""

    name: str
    start: str
    now: str
    allowed: str  # relative standard deviation; absolute, where the file says zero
    moved: bool
    sds: str


def retuned_rows(found: DiagnosisSummary) -> list[RetunedRow]:
    """Return the retuned parameters."""
    return [
        RetunedRow(
            r.name,
            digits(r.start, 5),
            interval(r.now),
            percent(r.sd / abs(r.start)) if r.start else digits(r.sd),
            r.moved,
            f"{(r.now.value - r.start) / r.sd:+.1f}",
        )
        for r in found.retuned
    ]


@dataclass(frozen=True, slots=True)
class PlaceRow:
    """One position left out of the fit."""

    label: str
    before: str  # error, times the noise
    after: str
    left: str  # of the excess


def place_rows(found: DiagnosisSummary, labels: list[str]) -> list[PlaceRow]:
    """Return the positions left out of the fit."""
    return [
        PlaceRow(
            label,
            digits(times_noise(p.before)),
            digits(times_noise(p.after)),
            _left(p),
        )
        for label, p in zip(labels, found.held_out, strict=True)
    ]


def _left(p: HeldOut) -> str:
    if p.before <= 0:
        return "–"
    share = max(p.after, 0.0) / p.before
    return percent(share) if share >= 1e-3 else "< 0.1 %"
