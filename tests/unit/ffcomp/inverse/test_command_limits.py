"""What a command asks of the carriages, against dense sampling; the nearest that keeps the limits, against cvxpy."""

from __future__ import annotations

from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest

from ffcomp.inverse.command_limits import (
    ACCELERATION,
    TRAVEL,
    VELOCITY,
    CommandLimits,
    peak_utilisation,
    utilisation_from_rest,
)
from ffcomp.inverse.nearest import nearest_within_limits
from models.arrays import FloatArray
from models.machine import Machine

S = 0.004
DENSE = 400  # samples a segment


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


def test_the_nearest_command_is_the_one_cvxpy_finds(machine: Machine) -> None:
    """Velocity, acceleration and travel at once, at the ends of every segment."""
    rng = np.random.default_rng(5)
    n, delta = 12, machine.kinematics.compiled()
    command = np.zeros((n + 4, 3))
    rough = np.cumsum(np.cumsum(rng.normal(0, 0.04, (n, 3)), axis=0), axis=0)
    hump = np.linspace(0.0, np.pi, n)[:, None]
    command[2:-2] = rough - hump / np.pi * rough[-1] + 0.4 * np.sin(hump)
    command += delta.inverse(np.array([[0.0, 0.0, 5]]))
    path = np.linspace(command[1], command[-2], n + 2)
    top = 0.5 * float(command.max() + path.max())
    assert command.max() > path.max() + 0.02
    limits = replace(
        CommandLimits.of(machine, S),
        velocity_mm_per_s=np.full(3, 125.0),
        acceleration_mm_per_s2=9000.0,
        travel_mm=(0.0, top),
    )
    free = delta.forward(command[1:-1])
    assert (utilisation_from_rest(free, limits).max(axis=(0, 2)) > 1.0).sum() >= 2  # limits bind
    found = nearest_within_limits(free, delta.forward(path), limits, delta)

    d = cp.Variable((n, 3))
    u = cp.vstack([command[1:2], command[1:2], command[2:-2] + d, command[-2:-1], command[-2:-1]])
    margin = 1.0 - 2e-3
    held = [
        cp.abs(u[1:] - u[:-1]) / S <= margin * 125.0,
        cp.abs(u[2:] - 2 * u[1:-1] + u[:-2]) / S**2 <= margin * 9000.0,
        u[2:-2] <= top - 1e-3,
    ]
    problem = cp.Problem(cp.Minimize(cp.sum_squares(d)), held)
    problem.solve(solver=cp.CLARABEL)
    assert problem.status == cp.OPTIMAL
    moved = delta.inverse(found)[1:-1] - command[2:-2]
    np.testing.assert_allclose(moved, d.value, atol=2e-3)  # straight carriages are not straight lines
    assert peak_utilisation(found, limits) <= 1.0


def test_where_no_command_keeps_the_limits_the_nearest_exceeds_one(machine: Machine) -> None:
    delta = machine.kinematics.compiled()
    jump = np.repeat(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 50.0]]), 2, axis=0)  # two unknown knots for 50 mm
    limits = replace(CommandLimits.of(machine, S), velocity_mm_per_s=np.full(3, 100.0))
    found = nearest_within_limits(jump, np.zeros((4, 3)), limits, delta)
    np.testing.assert_allclose(found[[0, -1]], jump[[0, -1]], atol=1e-9)
    assert np.all(np.isfinite(found)) and peak_utilisation(found, limits) > 1.0
