"""The trace of a search: each fit with its start and status, and why it was kept or dropped."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path


@dataclass(frozen=True)
class TraceRecord:
    """One fit or one decision of a search."""

    step: str  # "fit, quickly", "fit", "fit at the end", "prune", "level", "drop", "accept"
    effects: tuple[str, ...]
    parameters: tuple[str, ...] = ()  # of the effects: which form of them
    evaluations: int = 0  # simulations since the record before
    evidence: float | None = None  # −2 ln Z
    left: float | None = None  # of the noise's power: the discrepancy
    outcome: str = ""  # "kept", "dropped", or how a fit ended
    reason: str = ""


@dataclass
class Trace:
    """All records of a search, in order."""

    records: list[TraceRecord] = field(default_factory=list)
    evaluations: int = 0  # simulations since the last record

    def add(
        self,
        step: str,
        effects: Sequence[str],
        parameters: Sequence[str] = (),
        *,
        evidence: float | None = None,
        left: float | None = None,
        outcome: str = "",
        reason: str = "",
    ) -> None:
        """Append a record."""
        count, self.evaluations = self.evaluations, 0
        names = tuple(effects), tuple(parameters)
        self.records.append(TraceRecord(step, *names, count, evidence, left, outcome, reason))

    def write(self, path: Path) -> None:
        """Write all records as a JSON list."""
        path.write_text(json.dumps([asdict(record) for record in self.records], indent=1) + "\n", encoding="utf-8")
