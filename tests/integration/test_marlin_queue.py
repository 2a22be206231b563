"""The written file as Marlin's queue plays it, in whole steps, on plants that share no equation with ffcomp."""

from __future__ import annotations

import pytest

from studies.marlin import judge


@pytest.mark.parametrize(("case", "better"), [("tower", 3.0), ("star", 3.0)])
def test_marlin_leaves_what_is_predicted(case: str, better: float) -> None:
    """A cartesian printer, and a delta far from its centre: the contour error's p99 within 1.3 times the prediction."""
    (_, before, _), (_, after, predicted) = judge(case, 12.0)
    assert after.p99_um < 1.3 * predicted.contour_p99_um
    assert better * after.rms_um < before.rms_um
    assert after.seconds == pytest.approx(before.seconds, rel=0.03)
