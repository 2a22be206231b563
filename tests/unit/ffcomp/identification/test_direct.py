"""The two ways from responses to numbers, on responses whose noise is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffcomp.identification.output_error import TOTAL_MASS, UNKNOWNS, fit_machine
from ffcomp.identification.paper import identify_as_paper
from models.file import load_machine
from models.kinds import delta_vibration, with_parts
from models.machine import Machine, value_of
from models.vibration.substructures import Drive
from tests.support.identification import measured, paper_bench, towers_bench

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
