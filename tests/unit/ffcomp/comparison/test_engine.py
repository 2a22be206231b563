"""The whole comparison on a small print: what it finds, that it is repeatable, and that its judge is not its model."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from ffcomp.comparison.engine import compare
from ffcomp.comparison.methods import COMPENSATED
from ffcomp.comparison.result import Comparison
from ffcomp.comparison.sampling import Print, Sampling
from models.effects.catalogue import with_effect
from models.file import load_machine
from tests.support.prints import squares

MACHINE = load_machine("mp-delta-pro")
ONLY = ("mzv", "zv-calibrated", "fbs-lti")


PRINTED = Print(squares(), "squares.gcode", MACHINE)
FIRST_LAYER: dict[str, Any] = {"sampling": Sampling(0, 0), "quality_um": 0.0, "only": ("mzv",), "predict": False}


@cache
def found() -> Comparison:
    return compare(PRINTED, only=ONLY)


@cache
def of_first_layer() -> Comparison:
    return compare(PRINTED, **FIRST_LAYER)


def test_the_methods_rank_as_they_should() -> None:
    rms = {name: method.track.contour_rms_um for name, method in found().methods.items()}
    assert rms["none"] > rms["zv-calibrated"] > rms["mzv"] > rms[COMPENSATED]
    assert rms["none"] > 20 * rms[COMPENSATED]  # 23.5; segments are joined as far as the path allows, up to 1 µm
    assert rms["mzv"] > 3 * rms[COMPENSATED]


def test_every_sample_is_accounted_for() -> None:
    for method in found().methods.values():
        s = method.samples
        assert sum(error.share for error in method.by_layer.values()) == pytest.approx(1.0)
        assert sum(error.share for error in method.by_feature.values()) == pytest.approx(1.0)
        assert len(s.due) == len(s.reference) == len(s.nozzle) == len(s.contour) == len(s.layer)
        assert set(method.by_layer) == {0, 1, 2}
        assert method.track.contour_rms_um == pytest.approx(1e3 * np.sqrt(np.mean(s.contour**2)))
        assert np.any(s.extruding) and not np.all(s.extruding)
        assert method.peaks.within_limits


def test_what_compensate_would_slow_down_is_slowed_here_too_and_its_time_counts() -> None:
    limits = replace(MACHINE.limits, carriage_velocity_mm_per_s=60.0)
    methods = compare(Print(squares(), "", replace(MACHINE, limits=limits)), **FIRST_LAYER).methods
    assert not methods["mzv"].peaks.within_limits
    assert methods[COMPENSATED].peaks.within_limits
    assert methods[COMPENSATED].track.print_time_s > 1.03 * methods["mzv"].track.print_time_s


def test_equal_quality_holds_its_bound_and_orders_the_methods() -> None:
    quality = {name: method.equal_quality for name, method in found().methods.items()}
    for each in quality.values():
        assert each.p99_um <= 25.0 or not each.reached
    assert quality["none"].acceleration_mm_per_s2 < quality["mzv"].acceleration_mm_per_s2
    assert quality["mzv"].acceleration_mm_per_s2 < 0.6 * quality[COMPENSATED].acceleration_mm_per_s2
    assert quality[COMPENSATED].print_time_s < quality["mzv"].print_time_s < quality["none"].print_time_s


def test_a_plant_with_an_effect_judges_and_is_named() -> None:
    stuck, free = (
        compare(PRINTED, with_effect(MACHINE, "coulomb_friction", force_n=4.0), **FIRST_LAYER),
        of_first_layer(),
    )
    assert list(stuck.plant.effects) == ["coulomb_friction"] and not stuck.machine.effects
    assert stuck.methods[COMPENSATED].track.contour_rms_um > 2 * free.methods[COMPENSATED].track.contour_rms_um
