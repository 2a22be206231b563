"""The beam search: what it fits, what it keeps, and what its trace says of it."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

from ffcomp.diagnosis.diagnosis import Diagnosis, diagnose
from ffcomp.diagnosis.settings import SETTINGS, SearchSettings
from ffcomp.diagnosis.trace import Trace
from tests.unit.ffcomp.diagnosis.test_work import problem

NAMES = ("coulomb_friction", "belt_hardening", "guide_damping")


@cache
def asked(settings: SearchSettings = SETTINGS) -> tuple[Diagnosis, Trace]:
    trace = Trace()
    return diagnose(problem(NAMES), settings=settings, trace=trace), trace


def test_every_fit_and_every_decision_is_in_the_trace(tmp_path: Path) -> None:
    found, trace = asked()
    assert found.named is not None and found.named.names == ("coulomb_friction",)
    fits = [r for r in trace.records if r.step.startswith("fit")]
    assert {"coulomb_friction", "guide_damping"} <= {name for r in fits for name in r.effects}
    assert all(r.evidence is not None and r.left is not None and r.parameters for r in fits)
    assert sum(r.evaluations for r in trace.records) > 100
    pruned = [r for r in trace.records if r.step == "prune"]
    assert {r.outcome for r in pruned} == {"kept", "dropped"}
    assert [(r.effects, r.outcome) for r in trace.records if r.step == "accept"] == [(("coulomb_friction",), "kept")]
    trace.write(tmp_path / "trace.json")
    written = json.loads((tmp_path / "trace.json").read_text(encoding="utf-8"))
    assert len(written) == len(trace.records) and written[-1]["effects"] == ["coulomb_friction"]
