"""Faults by what they look like in spectra; those of whole captures are in `record/test_refusals.py`."""

from __future__ import annotations

from functools import partial

import numpy as np

from ffcomp.measurement.faults import NormalEquations, residual_power, shaper_of_captures, shapers

FREQUENCY_HZ = np.arange(3.0, 80.0, 0.4)


def spectrum(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.standard_normal((len(FREQUENCY_HZ), 2)) @ [1.0, 1j]


def capture(expected: np.ndarray, measured: np.ndarray) -> NormalEquations:
    return NormalEquations.of(FREQUENCY_HZ, measured, expected[:, None])


def test_one_motion_may_show_a_shaper_that_all_together_do_not() -> None:
    """A shaper on one axis leaves so little of it in most motions that what is measured came from the other axis."""
    on = partial(shapers, kinds=["3hump_ei"], shaper_hz=np.array([75.0]))(FREQUENCY_HZ)[0]
    clear, loud = spectrum(1), spectrum(2)
    from_y = [capture(loud, on * loud + 2.0 * spectrum(seed)) for seed in (3, 4)]
    assert shaper_of_captures({"multisine-2": from_y}, "x") is None
    found = shaper_of_captures({"multisine-2": from_y, "zigzag-0": [capture(clear, on * clear)] * 2}, "x")
    assert found is not None
    (shaper,) = found.shapers
    assert (shaper.axis, shaper.kind) == ("x", "3hump_ei") and abs(shaper.frequency_hz / 75.0 - 1.0) < 0.03
    assert "SET_INPUT_SHAPER SHAPER_FREQ_X=0" in found.sentence()


def test_a_shaper_is_told_apart_whatever_the_delay() -> None:
    """Two columns with unknown gains, through an EI of 50 Hz, and 1.5 ms late: of a grid of both nothing else fits."""
    f, rng = np.arange(3.0, 80.0, 0.25), np.random.default_rng(1)
    expected = rng.normal(size=(len(f), 2)) + 1j * rng.normal(size=(len(f), 2))
    kinds, shaper_hz, late = ("mzv", "ei"), np.array([40.0, 50.0]), np.array([-1.5e-3, 0.0, 1.5e-3, 3e-3])
    hypotheses = partial(shapers, kinds=kinds, shaper_hz=shaper_hz)
    measured = hypotheses(f)[3] * np.exp(-2j * np.pi * f * 1.5e-3) * (expected @ [0.7, -0.2])
    equations = [NormalEquations.of(f, measured, expected)]
    left = residual_power(equations, hypotheses, True, late) / equations[0].power
    assert left[3] < 1e-6 and left[:3].min() > 0.02
    of_each = [residual_power(equations, hypotheses, True, late[[k]])[3] for k in range(4)]
    assert np.argmin(of_each) == 2 and sorted(of_each)[1] > 0.02 * equations[0].power


def test_an_axis_that_rests_has_no_shaper() -> None:
    """One experiment excites x alone, another y alone: the expected motion of the other axis is exactly zero."""
    assert shaper_of_captures({"x": [capture(0.0 * spectrum(1), spectrum(2))]}, "y") is None
