"""The two ways from responses to numbers, on responses whose noise is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffcomp.errors import MeasurementError, SolverError
from ffcomp.identification.direct import Identified
from ffcomp.identification.machine_fit import ParametersFit
from ffcomp.identification.output_error import TOTAL_MASS, UNKNOWNS, Fitted, fit_machine
from ffcomp.identification.paper import carriage_step, identify_as_paper
from ffcomp.identification.predict import predicted
from ffcomp.identification.uncertainty import lognormal
from models.file import load_machine
from models.kinds import delta_vibration, with_parts
from models.machine import Machine, value_of
from models.vibration.substructures import Drive
from tests.support.identification import blank, measured, paper_bench, towers_bench

TRUTH = load_machine("mp-delta-pro")
WEIGHED = {TOTAL_MASS: (0.651, 0.0005)}
COARSE = np.arange(2.0, 200.1, 2.0)


def somewhere_else() -> Machine:
    """Another printer's numbers on this one's kinematics: 40 % and more off, every one."""
    other = load_machine("kossel")
    drive = Drive(2.5e5, -50.0, 100.0)
    carriage = replace(
        delta_vibration(other).carriage, arm_pair_mass_kg=delta_vibration(TRUTH).carriage.arm_pair_mass_kg, drive=drive
    )
    return with_parts(replace(other, kinematics=TRUTH.kinematics), carriage=carriage)


def test_step_by_step_within_2_percent_and_dampings_within_10() -> None:
    found = identify_as_paper(somewhere_else(), measured(TRUTH, paper_bench(COARSE), 43.0, 0), 0.651, 0.0005)
    for name in UNKNOWNS:
        close = 0.10 if "damping" in name else 0.02
        assert value_of(found.machine, name) == pytest.approx(value_of(TRUTH, name), rel=close), name
    assert found["carriage"].consistency < 3.0


def test_step_by_step_says_what_is_missing() -> None:
    bench = measured(TRUTH, paper_bench(COARSE), 60.0, 0)
    with pytest.raises(MeasurementError, match=r"setup 'carriage\+mass' is there"):
        identify_as_paper(TRUTH, [r for r in bench if r.setup != "carriage+mass"], 0.651)
    with pytest.raises(MeasurementError, match="effector alone"):
        identify_as_paper(TRUTH, [r for r in bench if r.setup != "effector"], 0.651)
    moved = [replace(r, position_mm=(-80.0, 0.0, 30.0)) if r.setup == "assembly" else r for r in bench]
    with pytest.raises(MeasurementError, match="centre"):
        identify_as_paper(TRUTH, moved, 0.651)


def test_an_added_mass_that_changes_nothing_is_refused() -> None:
    alone = measured(TRUTH, paper_bench()[:1], 60.0, 0)[0]
    with pytest.raises(SolverError, match="must fall"):
        carriage_step(alone, replace(alone, setup="carriage+mass", added_mass_kg=0.2))


def test_direct_intervals_cover_the_truth() -> None:
    """90 % intervals over 12 noise draws: 83 to 97 % of all of them, no number far from it."""
    bench = paper_bench(np.arange(2.0, 200.1, 8.0))
    inside = []
    for seed in range(12):
        found = fit_machine(TRUTH, measured(TRUTH, bench, 40.0, seed), WEIGHED, starts=[{}])
        inside.append([found.estimates[n].low < value_of(TRUTH, n) < found.estimates[n].high for n in UNKNOWNS])
    coverage = np.mean(inside, axis=0)
    assert 0.83 <= np.mean(inside) <= 0.97  # of 180 intervals, three standard deviations
    assert coverage.min() >= 0.5  # 6 of 12 or fewer come by chance once in two thousand draws


def test_an_unknown_start_of_the_capture_is_found_with_the_numbers() -> None:
    late = 2.345e-3
    bench = [
        replace(r, value=r.value * np.exp(-2j * np.pi * r.frequency_hz * late), clock="capture")
        for r in measured(TRUTH, towers_bench(0.0, 0.0, COARSE), 50.0, 0)
    ]
    found = fit_machine(TRUTH, bench, WEIGHED, starts=[{}])
    delay = found.delays_s["capture"]
    # A delay of the capture and a delay of the drive are told apart by little more than the drive's own resonance.
    assert delay.value == pytest.approx(late, abs=max(3 * delay.sd, 2e-5))
    assert value_of(found.machine, "carriage.belt_stiffness_n_per_m") == pytest.approx(1.039e5, rel=0.03)


def test_a_number_nobody_has_is_refused() -> None:
    with pytest.raises(SolverError, match=r"'carriage\.colour' is no parameter of this fit"):
        fit_machine(TRUTH, measured(TRUTH, paper_bench(COARSE), 40.0, 0), {"carriage.colour": (1.0, 0.1)})


def test_a_response_the_model_does_not_have_is_refused() -> None:
    for wrong in ({"input": "voltage"}, {"output": "pos_Q"}, {"output": "sound_A"}):
        with pytest.raises(MeasurementError, match=r"voltage|Q|sound"):
            predicted(TRUTH, [replace(blank(COARSE, input="cmd_A", output="pos_A"), **wrong)])


def test_a_number_that_is_kept_is_shown_with_the_files_value() -> None:
    kept, told = "carriage.mass_kg", "carriage.belt_stiffness_n_per_m"
    found = {name: lognormal(1.3 * value_of(TRUTH, name), 0.2) for name in (kept, told)}
    fitted = Fitted(TRUTH, found, {kept: 0.9, told: 0.1}, {}, {}, {}, 0.0, found, 1.0, 0.0, np.zeros(0), [], [])
    facts = dict(ParametersFit(start=TRUTH, data=[], name="better", result=Identified(fitted, (kept,), ())).found)
    assert facts[kept] == f"{value_of(TRUTH, kept):.5g}, unchanged: the data do not determine it"
    assert facts[told].startswith(f"{1.3 * value_of(TRUTH, told):.5g} ± 20 %")
