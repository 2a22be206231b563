"""The input of the report: the diagnosis, its summary, proposals, and their origin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ffcomp.diagnose.next_experiment import Proposal
from ffcomp.diagnose.result import DiagnosisResult, ResidualSize
from ffcomp.diagnose.summary import DiagnosisSummary


@dataclass(frozen=True)
class Origin:
    """Origin of a diagnosis; files by name and hash, not by folder."""

    machine: str  # its name
    machine_file: str  # `my-delta.toml sha256:…`
    runs: Sequence[str]  # `a-1.csv sha256:…`
    date: str
    version: str
    seconds: float  # of computing
    written: str = ""  # the better machine file, if there is one


@dataclass(frozen=True, eq=False)
class ReportInput:
    """Everything that the report shows."""

    outcome: DiagnosisResult
    picture: DiagnosisSummary
    proposals: Sequence[Proposal]
    origin: Origin


def explained(before: ResidualSize, after: ResidualSize) -> float:
    """Return the explained share of the gap above the noise, in power."""
    gap, left = (size.nrms**2 - size.noise_nrms**2 for size in (before, after))
    return 1 - max(left, 0.0) / gap if gap > 0 else 0.0


def explained_elsewhere(found: DiagnosisSummary) -> float:
    """Return the explained share at positions that were left out of the fit in turn."""
    before, after = (sum(getattr(p, what) * p.rows for p in found.held_out) for what in ("before", "after"))
    return 1 - max(after, 0.0) / before if before > 0 else 0.0
