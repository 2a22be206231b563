"""The preview inverse, against the least squares of windows, brute force, closed forms and a second solver."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ffcomp.firmware.program import plan_program
from ffcomp.inverse import solve as fast
from ffcomp.inverse.command_limits import ACCELERATION, TRAVEL, VELOCITY, peak_utilisation, utilisation_from_rest
from ffcomp.inverse.gains import REST_ROWS, TO_THE_END, PreviewGains, SegmentPlant
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.reference import Reference
from ffcomp.inverse.settings import Settings, settings_for
from ffcomp.inverse.solve import Solution, solve
from ffcomp.inverse.time_scaling import solution_violations
from ffcomp.planner.limits import planner_limits
from ffcomp.planner.lookahead import plan_moves
from ffcomp.planner.trajectory import split_sections
from gcode.reader import read_program
from models.arrays import FloatArray
from models.machine import Machine
from tests.support.exact_inverse import solve_exactly

SETTINGS = Settings()
CORNER = b"G1 X-60 Y20 F9000\nG1 X-50 Y20\nG1 X-50 Y24\nG1 X-57 Y26\n"


@pytest.fixture(scope="module")
def inverter(machine: Machine) -> InverseModel:
    return InverseModel(machine, SETTINGS)


def reference_of(
    gcode: bytes, machine: Machine, settings: Settings, start: tuple[float, float, float] = (-60, 20, 0.3)
) -> Reference:
    program = read_program(gcode, start=start, flavor="klipper")
    stops = np.zeros(len(program.moves), dtype=np.bool_)
    trajectory = plan_moves(program.moves, planner_limits(machine), stop_before=stops, wait_before=np.zeros(len(stops)))
    (run,) = split_sections(trajectory, stops)
    return Reference(trajectory, run, settings)


def response(inverter: InverseModel, reference: Reference, solution: Solution) -> FloatArray:
    state = inverter.machine.equilibrium(reference.at_knots(np.array([0]))[0])
    return inverter.respond(reference, inverter.executed(reference, solution.vertices), state)[0]


@pytest.mark.parametrize("exact", [True, False])
def test_the_response_is_the_path(machine: Machine, exact: bool) -> None:
    inverter = InverseModel(machine, SETTINGS)
    reference = reference_of(CORNER, machine, SETTINGS)
    state = machine.equilibrium(np.array([-60.0, 20, 0.3]))
    solved = solve_exactly(inverter, reference, state) if exact else None
    result = solved or solve(inverter, reference, state)
    nozzle, velocity = reference.substeps(reference.knots)
    plain, _ = inverter.plant.respond(nozzle, velocity, state, SETTINGS.substeps)
    error = np.sqrt(np.mean(np.sum((response(inverter, reference, result) - nozzle[1:]) ** 2, axis=1)))
    without = np.sqrt(np.mean(np.sum((plain - nozzle[1:]) ** 2, axis=1)))
    assert error < without / 60
    assert result.utilisation < 1.0


@pytest.mark.parametrize("limit", [ACCELERATION, VELOCITY, TRAVEL])
def test_a_limit_between_plan_and_free_answer_is_held(machine: Machine, limit: int) -> None:
    """The free answer asks for more than the plan; half of that is allowed, and no more is taken at any instant."""
    late_s = 0.006 if limit == VELOCITY else 0.004  # a late start asks for much
    settings = replace(SETTINGS, bandwidth_hz=112.0, lead_s=late_s)
    state = machine.equilibrium(np.array([-60.0, 20, 0.3]))
    gcode = {VELOCITY: b"G1 X-20 Y0 Z20 F9000\n", TRAVEL: b"G1 X-50 Y20 F9000\n"}.get(limit, CORNER)
    reference = reference_of(gcode, machine, settings)
    inverter = InverseModel(machine, settings)
    free = solve(inverter, reference, state)
    plan = reference.at_knots(np.arange(reference.knots + 1))
    asked, given = (utilisation_from_rest(v, inverter.limits) for v in (free.vertices, plan))
    own = machine.limits
    if limit == TRAVEL:
        highest = [float(inverter.kinematics.inverse(v).max()) for v in (free.vertices, plan)]
        assert highest[0] > highest[1] + 4e-4, "the free answer must go beyond the plan, or this tests nothing"
        bound = replace(own, carriage_travel_mm=(0.0, 0.5 * sum(highest)))
    else:
        most = [float(shares[:, limit].max()) for shares in (asked, given)]
        assert most[0] > 1.002 * most[1], "the free answer must ask for more than the plan, or this tests nothing"
        share = 0.5 * sum(most)
        names = ("carriage_velocity_mm_per_s", "carriage_acceleration_mm_per_s2")
        bound = replace(own, **{names[limit]: share * getattr(own, names[limit])})
    held_inverter = InverseModel(replace(machine, limits=bound), settings)
    again = solve(held_inverter, reference, state)
    held = fast.held(held_inverter, reference, state, again)
    assert held.limited
    assert peak_utilisation(free.vertices, held_inverter.limits) > 1.0
    assert held.utilisation <= 1.0
    nozzle, _ = reference.substeps(reference.knots)
    assert np.abs(response(held_inverter, reference, held) - nozzle[1:]).max() < 0.1  # it still follows
    worst = max(each.error_mm for each in held.limited)
    beyond = utilisation_from_rest(free.vertices, held_inverter.limits)[1:-1]
    for share, slows in ((1.1, False), (0.9, True)):  # the tolerance decides between an error and a delay
        assert any(solution_violations(held, beyond, share * worst)) == slows
    assert len(again.limited) == 0
    np.testing.assert_array_equal(again.vertices, free.vertices)


PRINTS = Path(__file__).parents[4] / "sample_prints"


@pytest.fixture(scope="module")
def preview(machine: Machine) -> PreviewGains:
    return InverseModel(machine, Settings()).gains


def references(name: str, machine: Machine, settings: Settings, seconds: float) -> list[Reference]:
    """The first runs of a print that move in the plane, `seconds` of them."""
    planned = plan_program(read_program((PRINTS / f"{name}.gcode").read_bytes(), flavor="klipper"), machine)
    found, left = [], seconds
    for run in planned.sections:
        moves = planned.program.moves
        flat = (moves.start[run.first : run.last, 2] == moves.end[run.first : run.last, 2]).all()
        if run.travels and flat and left > 0:
            found.append(Reference(planned.trajectory, run, settings))
            left -= run.end_t - run.begin_t
    return found


def solved(inverter: InverseModel, reference: Reference) -> Solution:
    return solve(inverter, reference, inverter.machine.equilibrium(reference.at_knots(np.array([0]))[0]))


def at_rows(response: FloatArray, settings: Settings) -> FloatArray:
    stride = settings.substeps // settings.rows_per_segment
    return response[stride - 1 :: stride]


@pytest.mark.parametrize("name", ["far_star"])
def test_it_is_the_exact_inverse_within_a_micrometre(machine: Machine, name: str) -> None:
    settings = settings_for(machine)
    inverter = InverseModel(machine, settings)
    apart = []
    for reference in references(name, machine, settings, 2.5):
        state = machine.equilibrium(reference.at_knots(np.array([0]))[0])
        pair = solved(inverter, reference), solve_exactly(inverter, reference, state, preview=40)
        nozzles = [at_rows(response(inverter, reference, each), settings) for each in pair]
        apart.append(np.sqrt(((nozzles[0] - nozzles[1]) ** 2).sum(axis=1)))
    micrometres = 1e3 * np.concatenate(apart)
    assert len(micrometres) > 1000
    assert np.sqrt(np.mean(micrometres**2)) < 0.3  # 1 is asked for
    assert micrometres.max() < 3.0


def test_the_gains_solve_the_riccati_equation(preview: PreviewGains) -> None:
    """With and without an end: the finite problem's gains become the steady ones, far before the end."""
    slots, steady = preview.at(np.array([[0.0, 0.0], [-95.0, 41.0]]))
    for slot in slots:
        ending = preview.end(int(slot))
        assert len(ending.forward) == TO_THE_END + REST_ROWS
        for finite, endless in ((ending.forward, steady.forward), (ending.backward, steady.backward)):
            apart, size = np.abs(finite[0] - endless[slot]).max(axis=1), np.abs(endless[slot]).max(axis=1)
            assert np.all(apart <= 1e-4 * size)  # in each row, an input: they differ in size by powers of ten


def test_both_sweeps_are_the_dense_least_squares(machine: Machine, preview: PreviewGains) -> None:
    """At one place: the answer to a random error of a command, by the sweeps and by a matrix of all responses."""
    rng = np.random.default_rng(3)
    knots, place = 30, np.array([[40.0, -30.0]])
    intervals = knots + REST_ROWS
    (slot,), _ = preview.at(place)
    at = preview.segment_plant(np.array([slot]))
    problem = SegmentPlant(at.a[0], at.b[0], at.c[0], at.d[0])
    # γ of the knots 1 … knots-1 are free; z holds x and two coefficients
    free = 3 * (knots - 1)
    gamma = np.zeros((intervals + 1, 3, free))
    gamma[1:knots] = np.eye(free).reshape(knots - 1, 3, free)
    rows, x = [], np.zeros((18, free))
    for k in range(intervals):
        w = gamma[k + 1] - 2 * gamma[k] + (gamma[k - 1] if k else 0.0)
        z = np.concatenate([x, gamma[k], gamma[k - 1] if k else np.zeros((3, free))])
        rows += [problem.c @ z + problem.d @ w, np.sqrt(preview.control_weight) * w]
        x = (problem.a @ z + problem.b @ w)[:18]
    error = rng.normal(size=(intervals, 6)) * 1e-3
    present = np.zeros((intervals + 2, 3))  # from the knot before the first on
    present[2 : knots + 1] = rng.normal(size=(knots - 1, 3)) * 1e-3
    effort = np.sqrt(preview.control_weight) * np.diff(present, 2, axis=0)
    right = np.hstack([error, -effort]).ravel()
    dense = np.linalg.lstsq(np.concatenate(rows), right, rcond=None)[0].reshape(-1, 3)

    node, steady, ending = preview.along(np.repeat(place, intervals, axis=0))
    psi = fast.sweep_back(steady.backward, ending.backward, node, error, present)
    swept, _ = fast.sweep_forward(steady.forward, ending.forward, node, psi, intervals)
    np.testing.assert_allclose(swept[: knots - 1], dense, atol=1e-6 * np.abs(dense).max())
    np.testing.assert_allclose(swept[knots - 1 :], 0.0, atol=1e-12)  # at rest after the end


def test_the_beginning_is_what_a_slow_motion_needs(machine: Machine) -> None:
    """C and τ are the real and imaginary parts of the FRF's inverse, at a frequency where little more is in it."""
    inverter = InverseModel(machine, Settings())
    place, s = np.array([40.0, -30.0]), 2 * np.pi * 0.5
    inverse = np.linalg.inv(machine.vibration.frequency_response(place, np.array([0.5]))[0])
    found = inverter.compliance_at(place[None])[0]
    np.testing.assert_allclose(found, (np.eye(3) - inverse.real) / s**2, atol=2e-3 * np.abs(found).max())
    np.testing.assert_allclose(np.diag(inverse.imag) / s, inverter.delay_s, rtol=1e-3)
