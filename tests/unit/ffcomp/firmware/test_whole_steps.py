"""Ends of segments on whole motor steps: the machine hardly answers, and nothing else changes."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import cont2discrete, lfilter

from ffcomp.firmware.whole_steps import WholeSteps
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.settings import CUT, settings_for
from models.arrays import FloatArray
from models.file import load_machine

KNOT_S, FINE = 0.004, 16
MODES = {0: (50.7, 0.1), 1: (40.6, 0.1)}  # of prusa-mk3s, Hz and damping ratio


def whole_steps(name: str, free: tuple[bool, bool, bool]) -> WholeSteps:
    machine = load_machine(name)
    model = InverseModel(machine, settings_for(machine))
    return WholeSteps.of(model, np.array(machine.steps.per_motor), np.array(free), 6)


@pytest.fixture(scope="module")
def cartesian() -> WholeSteps:
    return whole_steps("prusa-mk3s", (True, True, False))


@pytest.fixture(scope="module")
def delta() -> WholeSteps:
    return whole_steps("mp-delta-pro", (True, True, True))


def circle(centre: tuple[float, float], knots: int) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Times in knots, points mm and which are fixed, of a circle at 60 mm/s: the first, the last, and at each cut."""
    at = np.arange(knots + 1, dtype=np.float64)
    turned = 0.012 * at
    points = np.column_stack(
        [centre[0] + 20 * np.cos(turned), centre[1] + 20 * np.sin(turned), np.full(len(at), 0.3001)]
    )
    fixed = at % CUT == 0
    fixed[-1] = True
    return at, points, fixed


def ends(
    own: WholeSteps, at: FloatArray, points: FloatArray, fixed: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
    """Which points end segments, when they are due and where, if all would without steps."""
    return own.ends(at, points, np.arange(len(at)), fixed)


def response(error: FloatArray, frequency_hz: float, damping: float) -> FloatArray:
    """What one mode makes of an error (n,) at the knots that is linear between them: the closed form, sampled."""
    omega, step_s = 2 * np.pi * frequency_hz, KNOT_S / FINE
    fine = np.interp(np.arange((len(error) - 1) * FINE) / FINE, np.arange(len(error)), error)
    b, a, _ = cont2discrete(([omega**2], [1.0, 2 * damping * omega, omega**2]), step_s, method="foh")
    return np.asarray(lfilter(b.ravel(), a, fine))


def test_modes_answer_far_less_than_to_plain_rounding(cartesian: WholeSteps) -> None:
    """Across the path, by the modes' closed form."""
    at, points, fixed = circle((125.0, 105.0), 3 * CUT)
    steps = cartesian.motors(points)
    outward = np.repeat((points[:-1, :2] - [125.0, 105.0]) / 20.0, FINE, axis=0)

    def across(chosen: FloatArray) -> float:
        off = np.column_stack([response(chosen[:, i] - steps[:, i], *MODES[i]) for i in MODES])
        return float(np.std(np.sum(off * outward, axis=1)))

    shaped = across(np.rint(cartesian.motors(ends(cartesian, at, points, fixed)[2])))
    assert shaped < 0.6 * across(np.rint(steps))


def test_a_slow_line_is_late_nowhere(cartesian: WholeSteps) -> None:
    """At 15 mm/s in any direction: an end is due when the command is there, within a third of a step at its side.

    An end that keeps its own time misses the command by up to half a step along it, 13 µm to either side of six steps.
    """
    at = 2.0 * np.arange(120.0)
    for slope in (0.1, 0.37, 0.8):
        way = 15.0 * KNOT_S * at
        points = np.column_stack([125.0 + way, 105.0 + slope * way, np.full(len(at), 0.3)])
        fixed = np.zeros(len(at), dtype=np.bool_)
        fixed[[0, -1]] = True
        _, due, placed = ends(cartesian, at, points, fixed)
        missed = np.array([np.interp(due, at, points[:, i]) for i in (0, 1)]).T - placed[:, :2]
        along = missed @ np.array([1.0, slope]) / np.hypot(1.0, slope)
        assert np.abs(along[1:-1]).max() < 1e-3
        assert np.diff(due).min() > 0.5 and due[0] == at[0] and due[-1] == at[-1]
        assert np.sqrt(np.mean(missed**2)) < 0.35 / cartesian.steps_per_mm[0]


@pytest.mark.parametrize("name", ["cartesian", "delta"])
def test_ends_are_whole_steps_near_the_command_and_none_is_dropped(name: str, request: pytest.FixtureRequest) -> None:
    own = request.getfixturevalue(name)
    at, points, fixed = circle((125.0, 105.0) if name == "cartesian" else (0.0, -60.0), CUT)
    _, _, placed = ends(own, at, points, fixed)
    steps = own.motors(placed)
    apart = np.abs(steps - np.rint(steps))[:, own.free]
    assert apart[~fixed].max() < 1e-6
    assert np.array_equal(placed[fixed], points[fixed])
    assert np.abs(np.diff(np.rint(steps), axis=0)).max(axis=1).min() >= 6
    assert np.abs(steps - own.motors(points)).max() < 6
    if name == "cartesian":
        assert np.array_equal(placed[:, 2], points[:, 2])


def test_a_part_that_begins_at_a_cut_says_what_the_whole_says(delta: WholeSteps) -> None:
    at, points, fixed = circle((0.0, 0.0), 3 * CUT)
    part = slice(CUT, 2 * CUT + 1)
    whole = ends(delta, at, points, fixed)[2][part]
    assert np.array_equal(ends(delta, at[part], points[part], fixed[part])[2], whole)


def test_motors_keep_their_acceleration_before_a_line_that_stays(delta: WholeSteps) -> None:
    """A fifth of a knot after a point that goes elsewhere, since six steps are too many at 10 mm/s."""
    at = np.sort(np.append(np.arange(1.0, 240.0), np.arange(9, 230, 11) + 0.2))
    turned = 0.002 * at
    points = np.column_stack([20 * np.cos(turned), 20 * np.sin(turned) - 60.0, np.full(len(at), 0.3)])
    fixed = np.append(at[:-1] % 1.0 != 0.0, True)
    _, due, placed = ends(delta, at, points, fixed)
    lasting = np.diff(due)[:, None]
    velocity = np.diff(delta.motors(placed), axis=0) / lasting
    change = np.abs(np.diff(velocity, axis=0)) / np.maximum(0.5 * (lasting[1:] + lasting[:-1]), 1.0)
    assert (change / delta.most).max() < 1.0
