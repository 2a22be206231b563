"""The input of the report: the diagnosis, its summary, proposals, and their origin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ffcomp.diagnose.next_experiment import Proposal
from ffcomp.diagnose.residuals import ResidualSize
from ffcomp.diagnose.result import DiagnosisResult
from ffcomp.diagnose.result import explained as share_explained
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
    gain: str = ""  # how much prints would gain, in a sentence


def explained(before: ResidualSize, after: ResidualSize) -> float:
    """Return the explained share of the gap above the noise, in power."""
    return share_explained(before.nrms, after.nrms, before.noise_nrms)
