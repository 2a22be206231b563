"""benchmarks/PERFORMANCE.md and the scripts that write it are in step; methods that only they have are right."""

from __future__ import annotations

import itertools
import re

import numpy as np
import pytest

from benchmarks import performance, performance_figures, performance_methods, performance_page, performance_where
from benchmarks.performance_methods import LINES, REACH, ZeroPhase, dense, left_over, sampled, unstable_zeros, whole_run
from benchmarks.performance_prints import LAYER, repeated
from benchmarks.performance_ways import LABELS, MACHINE, PRINTS, pattern
from ffcomp.firmware.program import plan_program
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.settings import Settings
from gcode.reader import read_program
from models.file import load_machine
from models.kinds import delta_vibration
from models.machine import Machine
from studies.effects_compensated import machines_effects
from tests.support.exact_inverse import FreeWindow

FOLDER = performance.FOLDER
PAGE = performance.PAGE.read_text(encoding="utf-8")
PLACE = np.array([60.0, -40.0])


@pytest.fixture(scope="module")
def machine() -> Machine:
    return load_machine(MACHINE)


# ---- the page ------------------------------------------------------------------------------------


def test_every_section_has_its_numbers_and_its_place_on_the_page() -> None:
    titles = [title for title, _ in performance_page.WRITERS.values()]
    found = re.findall(r"^## (.+)$", PAGE, re.MULTILINE)
    assert found == [*titles, "What limits it now"], "python -m benchmarks.performance --keep DIR --write"
    assert set(performance_page.WRITERS) == set(performance.SECTIONS) == set(performance.QUICK)


def test_every_figure_is_shown_and_none_is_left_over() -> None:
    shown = re.findall(r"\]\((performance_\w+\.png)\)", PAGE)
    assert sorted(shown) == sorted(path.name for path in FOLDER.glob("performance_*.png"))
    assert len(shown) == len(performance_figures.FIGURES)


def test_every_way_is_in_the_table_of_every_print_and_every_effect_in_its_own() -> None:
    tables = [PAGE.split(f"### {name}\n")[1].split("\n## ")[0] for name in PRINTS]
    for label in LABELS.values():
        assert all(f"| {label} |" in table for table in tables), label
    effects = PAGE.split("## Effects that are not linear")[1]
    assert set(re.findall(r"^\| `(\w+)` \|", effects, re.MULTILINE)) == set(machines_effects())


def test_the_operations_told_are_those_of_the_gains() -> None:
    counts = performance_where.per_knot()
    assert counts["sweep_back"] == 2 * 33 * 27 and counts["sweep_forward"] == 2 * 27 * 24
    assert all(f"{number:,}" in PAGE for number in counts.values())


# ---- zero-phase-error tracking -------------------------------------------------------------------


def test_the_plant_has_six_zeros_outside_the_unit_circle(machine: Machine) -> None:
    """The drive's zero at 674 rad/s, from 4 ms to 4 ms, once a tower; and three negative ones, of the sampling."""
    zeros = unstable_zeros(*sampled(machine, PLACE))
    drive = delta_vibration(machine).carriage.drive
    assert drive is not None and np.abs(zeros.imag).max() == 0.0
    expected = np.exp(-drive.d0_per_s2 / drive.d1_per_s * performance_methods.SAMPLE_S)
    np.testing.assert_allclose(np.sort(zeros.real)[3:], expected, rtol=0.1)
    assert np.sort(zeros.real)[:3].max() < -2.0


def test_the_answer_has_no_phase_and_the_gain_of_the_zeros_left_over(machine: Machine) -> None:
    """Filter times plant on the unit circle is |β|² times the unit matrix, up to what the cut-off filter lacks."""
    z = np.exp(2j * np.pi * np.arange(LINES // 3) / LINES)  # up to 83 Hz
    a, b, c, d = sampled(machine, PLACE)
    plant = c @ np.linalg.solve(z[:, None, None] * np.eye(len(a)) - a, b) + d
    kernel = performance_methods.taps(machine, PLACE).reshape(3, 2 * REACH + 1, 3)  # input, sample, output
    delays = z[:, None] ** (np.arange(2 * REACH + 1) - REACH)  # of a window's oldest sample first
    answer = plant @ np.einsum("ft,itj->fji", delays, kernel)
    gain = left_over(unstable_zeros(a, b, c, d), z)
    np.testing.assert_allclose(answer, gain[:, None, None] * np.eye(3), atol=2e-3)
    assert gain[0] == pytest.approx(1.0) and np.all(np.diff(gain) < 0.0)


def test_rest_stays_rest(machine: Machine) -> None:
    nozzle = np.repeat([[60.0, -40.0, 5.0]], 50, axis=0)
    np.testing.assert_allclose(ZeroPhase(machine).command(nozzle), nozzle, atol=1e-9)


# ---- dense, repeated, timed ----------------------------------------------------------------------


def test_the_dense_formulation_agrees_with_a_window_of_the_whole_run(machine: Machine) -> None:
    text = b"G28\nM83\nG1 Z5 F6000\nG1 E1 F3000\nG1 X6 Y3 E.2 F6000\nG1 X-12 Y28 E.2\nG1 E1 F3000\n"
    planned = plan_program(read_program(text, "corner", flavor="klipper"), machine)
    inverter = InverseModel(machine, Settings(corrections=2))
    run = [run for run in planned.sections if run.travels][-1]
    window = whole_run(planned, run, inverter)
    exact = FreeWindow(window.iterate, window.at, window.state, window.commit_end, window.unknowns, window.stretch.end)
    exact.solve()
    expected = window.iterate.vertices
    np.testing.assert_allclose(dense(whole_run(planned, run, inverter)), expected, atol=1e-4)
    assert len(expected) > 30


def test_layers_are_repeated_until_the_time_is_up() -> None:
    a, b = LAYER + b"\na\n", LAYER + b"\nb\n"
    begin, end = b"begin\n", b";TYPE:Custom\nend\n"
    assert b"".join(repeated(begin + a + b + end, [2.0, 3.0], 6.0)) == begin + a + b + a + end


def test_the_pattern_is_the_same_wherever_it_is(machine: Machine) -> None:
    near, far = (plan_program(read_program(pattern(r, 4.0), "pattern"), machine) for r in (0.0, 100.0))
    assert len(near.trajectory) == len(far.trajectory)
    assert np.hypot(*far.trajectory.origin[-1, :2]) == pytest.approx(100.0, abs=10.0)


def test_a_stage_that_another_calls_is_not_counted_twice() -> None:
    seconds = itertools.count()
    watch = performance_where.Stopwatch(clock=lambda: float(next(seconds)))
    inner = watch.timed("inner", lambda: None)
    outer = watch.timed("outer", lambda: inner())
    outer()
    watch.switch()
    assert watch.seconds == {performance_where.REST: 2.0, "outer": 2.0, "inner": 1.0}


def test_stages_name_functions_that_are_there() -> None:
    for paths in performance_where.STAGES.values():
        for path in paths:
            owner, name = performance_where.named(path)
            assert callable(getattr(owner, name)), path


def test_every_stage_is_where_the_product_looks_it_up() -> None:
    for paths in performance_where.STAGES.values():
        for path in paths:
            owner, name = performance_where.named(path)
            assert callable(getattr(owner, name)), path
