from __future__ import annotations

from math import cos, hypot, isclose, pi, sin

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gcode.arcs import MAX_CHORD_MM, Arc, arc_by_centre, arc_by_radius
from gcode.errors import GcodeError

radii = st.floats(0.05, 200)
angles = st.floats(-pi, pi)


def on_circle(radius: float, angle: float) -> tuple[float, float]:
    return radius * cos(angle), radius * sin(angle)


def vertices(arc: Arc, tolerance: float) -> np.ndarray:
    return np.vstack((arc.start, arc.chords(tolerance)[:, :2]))


@settings(deadline=None)  # the first call may have to be compiled
@given(radii, angles, st.floats(0.01, 2 * pi - 0.01), st.booleans(), st.floats(0.001, 0.1))
def test_chords_stay_within_the_tolerance(
    radius: float, begin: float, sweep: float, clockwise: bool, tolerance: float
) -> None:
    end = on_circle(radius, begin + (-sweep if clockwise else sweep))
    arc = Arc(on_circle(radius, begin), end, (0.0, 0.0), clockwise)
    points = vertices(arc, tolerance)
    lengths = np.hypot(*np.diff(points, axis=0).T)
    sagitta = radius - np.sqrt(np.maximum(0, radius**2 - lengths**2 / 4))
    assert isclose(abs(arc.sweep), sweep, abs_tol=1e-6)
    assert sagitta.max() <= tolerance * (1 + 1e-6) + 1e-9
    assert lengths.max() <= MAX_CHORD_MM + 1e-6
    assert np.ptp(lengths) < 1e-6
    assert np.abs(np.hypot(*points.T) - radius).max() < 1e-6
    n = len(lengths)
    assert isclose(lengths.sum(), 2 * n * radius * sin(sweep / 2 / n), rel_tol=1e-6)


def test_length_converges_with_the_tolerance() -> None:
    """The chords of a sweep are shorter than the arc by r sweep³ / (24 n²)."""
    arc = Arc((0.5, 0.0), (-0.5, 0.0), (0.0, 0.0), False)
    lacking = []
    for tolerance in (1e-3, 1e-4, 1e-5):
        points = vertices(arc, tolerance)
        n = len(points) - 1
        lacking.append(0.5 * pi - np.hypot(*np.diff(points, axis=0).T).sum())
        assert isclose(lacking[-1], 0.5 * pi**3 / 24 / n**2, rel_tol=0.02)
    assert lacking == sorted(lacking, reverse=True)


@pytest.mark.parametrize("clockwise", [True, False])
def test_a_full_circle_goes_once_round(clockwise: bool) -> None:
    arc = arc_by_centre((5.0, 2.0), (5.0, 2.0), (-3.0, 0.0), clockwise)
    points = vertices(arc, 0.005)
    x, y = points[:-1].T
    after_x, after_y = points[1:].T
    area = 0.5 * np.sum(x * after_y - after_x * y)
    assert isclose(area, (-1 if clockwise else 1) * pi * 9, rel_tol=0.01)


@settings(deadline=None)
@given(radii, angles, st.floats(0.2, 2 * pi - 0.2), st.booleans())
def test_radius_and_centre_give_the_same_arc(radius: float, begin: float, sweep: float, clockwise: bool) -> None:
    start = on_circle(radius, begin)
    end = on_circle(radius, begin + (-sweep if clockwise else sweep))
    arc = arc_by_radius(start, end, radius if sweep <= pi else -radius, clockwise)
    # At half a turn the centre depends on the root of a rounding error.
    assert hypot(*arc.centre) < 1e-3 * radius if abs(sweep - pi) > 0.01 else hypot(*arc.centre) < 0.02 * radius
    assert isclose(abs(arc.sweep), sweep, abs_tol=0.05)


def test_an_end_far_off_the_circle_is_reached_straight_as_klipper_does() -> None:
    """FLSUN's start line G3 X0 Y-130 I150 from X-150: round at 150 mm, and the last millimetre goes 20 mm inwards."""
    points = arc_by_centre((-150.0, 0.0), (0.0, -130.0), (150.0, 0.0), False).chords()
    assert np.hypot(*points[:-1, :2].T) == pytest.approx(150.0)
    assert points[-1].tolist() == [0.0, -130.0, 1.0]
    assert hypot(*(points[-2, :2] - (0.0, -150.0))) < MAX_CHORD_MM


@pytest.mark.parametrize(
    ("make", "rule"),
    [
        (lambda: arc_by_centre((1.0, 1.0), (2.0, 2.0), (0.0, 0.0), True, 3), "radius must be positive"),
        (lambda: arc_by_radius((0.0, 0.0), (9.0, 0.0), 3.0, True, 3), "cannot span"),
        (lambda: arc_by_radius((1.0, 1.0), (1.0, 1.0), 3.0, True, 3), "full circle needs"),
    ],
)
def test_impossible_arcs_are_refused(make, rule: str) -> None:
    with pytest.raises(GcodeError, match=rule) as caught:
        make()
    assert caught.value.line == 3
