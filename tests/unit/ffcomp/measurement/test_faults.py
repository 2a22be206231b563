"""Faults by what they look like in spectra; those of whole captures are in `record/test_refusals.py`."""

from __future__ import annotations

from functools import partial

import numpy as np

from ffcomp.measurement.faults import NormalEquations, shaper_of_captures, shapers

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
