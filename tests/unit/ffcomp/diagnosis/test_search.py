"""The beam search: what it fits, what it keeps, and what its trace says of it."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from ffcomp.diagnosis.candidates import machine_parameters, printer_candidates
from ffcomp.diagnosis.diagnosis import Diagnosis, diagnose
from ffcomp.diagnosis.fit import Fit
from ffcomp.diagnosis.hypotheses import Hypothesis, held
from ffcomp.diagnosis.settings import SETTINGS, SearchSettings
from ffcomp.diagnosis.trace import Trace
from models.effects.catalogue import CATALOGUE
from models.file import load_machine
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


def test_a_number_of_the_file_is_held_where_an_effect_is_the_same_number() -> None:
    """A belt 16 % softer and the file's own stiffness are one number: fitted together, neither is determined."""
    machine = load_machine("kossel")
    command = np.column_stack([np.linspace(0, 50, 100)] * 3) + np.array([0.0, 5.0, 9.0])
    found = {c.name: c for c in printer_candidates(machine, [command, command[::-1] + 30.0], tuple(CATALOGUE))}
    assert found["belt_stiffness"].replaces.keys() == {"carriage.belt_stiffness_n_per_m"}
    assert len(found["extruder_mount"].replaces) == 6 and not found["center_of_mass"].replaces
    assert not found["cogging"].replaces
    file = tuple(machine_parameters(machine))
    belts, cogging = found["belt_stiffness"], found["cogging"]
    machine_held = held(file, [belts, cogging])
    fixed = [n for n in machine_held if n.low == n.high == n.start]
    assert [n.name for n in fixed] == ["carriage.belt_stiffness_n_per_m"]
    parameters = (*machine_held, *belts.parameters, *cogging.parameters)
    z = np.zeros(len(parameters))
    z[len(file)] = 0.03 / belts.amplitudes[0].sd  # belts that are 3 % stiffer
    both = Hypothesis((belts, cogging), Fit(parameters, z, np.zeros(3), np.zeros((3, len(z)))))
    assert both.without(belts, file).machine_parameters == file
    stiffness = both.without(belts, file).fit.values["carriage.belt_stiffness_n_per_m"]
    assert stiffness == pytest.approx(1.03 * fixed[0].start)
    assert both.without(cogging, file).machine_parameters == machine_held
