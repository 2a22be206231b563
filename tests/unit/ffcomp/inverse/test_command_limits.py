"""What a command asks of the carriages, against dense sampling; the programme that holds it, against cvxpy."""

from __future__ import annotations

from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse

from ffcomp.errors import SolverError
from ffcomp.inverse.command_limits import (
    ACCELERATION,
    TRAVEL,
    VELOCITY,
    CommandLimits,
    peak_utilisation,
    utilisation_from_rest,
)
from ffcomp.inverse.qp import constrained_step, solve_qp
from models.file import load_machine
from models.machine import Machine

FloatArray = NDArray[np.float64]

S = 0.004
DENSE = 400  # samples a segment


@pytest.fixture(scope="module")
def machine() -> Machine:
    return load_machine("mp-delta-pro")


def wild_command(seed: int, segments: int = 400) -> FloatArray:
    """A polygon with fast and slow parts all over the bed: with turning points of the carriages inside segments."""
    rng = np.random.default_rng(seed)
    steps = rng.normal(0, 1, (segments, 3)) * np.array([2.0, 2.0, 0.02])
    return rng.uniform([-20, -20, 0], [20, 20, 100]) + np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])


def sampled(vertices: FloatArray, machine: Machine) -> tuple[FloatArray, FloatArray]:
    """Heights (n, DENSE + 1, 3) mm of each segment's samples, and velocities between them (n, DENSE, 3) mm/s."""
    share = np.linspace(0.0, 1.0, DENSE + 1)[None, :, None]
    nozzle = vertices[:-1, None] + share * np.diff(vertices, axis=0)[:, None]
    heights = machine.kinematics.compiled().inverse(nozzle.reshape(-1, 3)).reshape(*nozzle.shape)
    return heights, np.diff(heights, axis=1) / (S / DENSE)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_every_instant_is_within_what_is_said_to_be_asked(machine: Machine, seed: int) -> None:
    vertices = wild_command(seed)
    limits = CommandLimits.of(machine, S)
    asked = limits.demand(vertices)
    heights, velocities = sampled(vertices, machine)
    np.testing.assert_allclose(asked.height[..., 1], heights.max(axis=1), atol=1e-5)
    np.testing.assert_allclose(asked.height[..., 0], heights.min(axis=1), atol=1e-9)
    turning = (asked.velocity[..., 0] > 0) & (asked.velocity[..., 1] < 0)
    assert turning.any()  # a highest point inside a segment
    np.testing.assert_allclose(asked.velocity.max(axis=2), velocities.max(axis=1), atol=0.2)
    np.testing.assert_allclose(asked.velocity.min(axis=2), velocities.min(axis=1), atol=0.2)
    changes = np.diff(velocities, axis=0) / S  # of any instant, to the one S later
    bends = asked.acceleration(S)
    slack = 1e-4 * np.abs(bends).max()
    assert np.all(changes.max(axis=1) <= bends.max(axis=2) + slack)
    assert np.all(changes.min(axis=1) >= bends.min(axis=2) - slack)
    assert np.abs(changes).max() == pytest.approx(np.abs(bends).max(), rel=1e-3)  # and it is asked for


def test_shares_name_the_limit_that_binds(machine: Machine) -> None:
    own = replace(
        machine.limits,
        carriage_velocity_mm_per_s=400.0,
        carriage_acceleration_mm_per_s2=2e4,
        carriage_travel_mm=(100.0, 400.0),
        step_rate_hz=16_000.0,  # 200 mm/s at 80 steps/mm: the tighter one
    )
    limits = CommandLimits.of(replace(machine, limits=own), S)
    assert limits.velocity_mm_per_s.tolist() == [200.0] * 3
    up = np.array([[0, 0, 0], [0, 0, 0.5], [0, 0, 0.9], [0, 0, 0.9]])  # all carriages alike: 125, 100 and 0 mm/s
    shares = utilisation_from_rest(up, limits)
    np.testing.assert_allclose(shares[1:4, VELOCITY, 0], [125 / 200, 100 / 200, 0], atol=1e-9)
    changes = np.array([125, 25, 100, 0]) / S / 2e4
    np.testing.assert_allclose(shares[1:, ACCELERATION, 2], changes, atol=1e-9)
    height = machine.kinematics.compiled().inverse(np.array([[0, 0, 0.9]]))[0, 0]
    np.testing.assert_allclose(shares[3, TRAVEL], np.abs(height - 250) / 150, atol=1e-9)
    assert peak_utilisation(up, limits) == shares.max() == pytest.approx(125 / S / 2e4)


def test_a_limited_step_is_the_one_cvxpy_finds(machine: Machine) -> None:
    """Velocity, acceleration and travel at once, at the ends of every segment."""
    rng = np.random.default_rng(5)
    n, delta = 12, machine.kinematics.compiled()
    start = delta.inverse(np.array([[20.0, -30, 5]]))
    command = start + np.cumsum(np.cumsum(rng.normal(0, 0.02, (n + 4, 3)), axis=0), axis=0)
    a = rng.normal(size=(60, 3 * n))
    hessian, gradient = a.T @ a, rng.normal(size=3 * n) * 40
    top = float(command.max()) + 0.2
    limits = replace(
        CommandLimits.of(machine, S),
        velocity_mm_per_s=np.full(3, 125.0),
        acceleration_mm_per_s2=9000.0,
        travel_mm=(0.0, top),
    )
    tried = command.copy()
    tried[2:-2] += np.linalg.solve(hessian, gradient).reshape(-1, 3)
    assert (limits.demand(delta.forward(tried)).utilisation(limits).max(axis=(0, 2)) > 1.0).sum() >= 2  # limits bind
    step = constrained_step(hessian, gradient, command, command, limits, delta)

    d = cp.Variable((n, 3))
    u = cp.vstack([command[:2], command[2:-2] + d, command[-2:]])
    margin = 1.0 - 2e-3
    held = [
        cp.abs(u[1:] - u[:-1]) / S <= margin * 125.0,
        cp.abs(u[2:] - 2 * u[1:-1] + u[:-2]) / S**2 <= margin * 9000.0,
        u[2:-2] <= top - 1e-3,
    ]
    flat = cp.reshape(d, (3 * n,), order="C")
    cp.Problem(cp.Minimize(0.5 * cp.sum_squares(a @ flat) - gradient @ flat), held).solve(solver=cp.CLARABEL)
    np.testing.assert_allclose(step.reshape(-1, 3), d.value, atol=2e-3)  # straight carriages are not straight lines
    tried[2:-2] = command[2:-2] + step.reshape(-1, 3)
    assert (
        limits.demand(delta.forward(tried)).utilisation(limits).max() <= 1.002
    )  # a step of mm changes what o and c are


def test_given_knots_that_leave_no_room_are_an_error(machine: Machine) -> None:
    delta = machine.kinematics.compiled()
    command = np.repeat(delta.inverse(np.zeros((1, 3))), 6, axis=0)
    command[3:] += 50.0  # two unknown knots for a jump of 50 mm
    flat = np.repeat(command[:1], 6, axis=0)
    limits = replace(CommandLimits.of(machine, S), velocity_mm_per_s=np.full(3, 100.0))
    with pytest.raises(SolverError, match="6 unknowns"):
        constrained_step(np.eye(6), np.zeros(6), command, flat, limits, delta)


# ---- qp ----


def problem(seed: int) -> tuple[FloatArray, FloatArray, sparse.csc_matrix, FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    n, m = 20, 35
    factor = rng.normal(size=(40, n))
    rows = np.where(rng.random((m, n)) < 0.3, rng.normal(size=(m, n)), 0.0) + np.eye(m, n)
    middle = rows @ rng.normal(0, 0.1, n)  # something is allowed
    low, high = middle - rng.uniform(0.05, 0.5, m), middle + rng.uniform(0.05, 0.5, m)
    low[:4], high[4:8] = -np.inf, np.inf
    return factor.T @ factor, 30.0 * rng.normal(size=n), sparse.csc_matrix(rows), low, high


def test_units_do_not_matter() -> None:
    """Unknowns in mm or nm, rows in any unit, an objective of any size: the same answer."""
    p, q, a, low, high = problem(4)
    rng = np.random.default_rng(9)
    unknown, row, size = 10.0 ** rng.uniform(-6, 6, len(q)), 10.0 ** rng.uniform(-4, 4, len(low)), 1e-7
    odd = sparse.csc_matrix(a.multiply(row[:, None]).multiply(unknown[None, :]))
    scaled = size * p * np.outer(unknown, unknown), size * q * unknown
    plain = solve_qp(p, q, a, low, high)
    found = unknown * solve_qp(*scaled, odd, low * row, high * row)
    np.testing.assert_allclose(found, plain, atol=1e-6)


def test_no_answer_is_an_error_with_solver_status_and_size() -> None:
    a = sparse.csc_matrix(np.array([[1.0, 0.0], [1.0, 0.0]]))
    low, high = np.array([1.0, -np.inf]), np.array([np.inf, -1.0])
    with pytest.raises(SolverError, match=r"2 unknowns and 2 rows ended in osqp as «.*infeasible.*»") as caught:
        solve_qp(np.eye(2), np.ones(2), a, low, high)
    assert caught.value.exit_code == 7
