"""The rivals' settings: found at least as good as calibrated, and their cost that of the motion they make."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from ffcomp.comparison.baselines import (
    CARRIAGES,
    INVERSE,
    LinearPrinter,
    VariantTuner,
    kind_and_variant,
    shaped_by_variant,
    shaper_variant,
)
from ffcomp.comparison.engine import Request, compare, names
from ffcomp.comparison.methods import COMPENSATED, NAMES, USUAL_NAMES, is_variant
from ffcomp.comparison.sampling import Print, Sampling
from models.file import load_machine
from tests.support.prints import squares

MACHINE = load_machine("mp-delta-pro")


@cache
def tuner() -> tuple[VariantTuner, LinearPrinter]:
    (stretch,), _ = Print(squares(), "squares.gcode", MACHINE).slices(Sampling(0, 0))
    linear = LinearPrinter(MACHINE, [stretch])
    return VariantTuner(MACHINE, MACHINE, linear), linear


@pytest.mark.parametrize(
    ("kind", "variant"),
    [("zv", "-z"), ("mzv", "-carriages"), ("smooth_ei", "-z"), ("smooth_mzv", "-inverse"), ("smooth_zv", "-inverse-z")],
)
def test_the_cost_of_settings_is_that_of_their_motion(kind: str, variant: str) -> None:
    own, linear = tuner()
    rival = shaper_variant(kind, variant, MACHINE)
    settings = own.calibrated(rival)
    assert len(settings) == len(rival.names)
    (motion,) = (shaped_by_variant(rival, each.motion, settings, MACHINE) for each in linear.slices)
    assert own.cost(rival, settings) == pytest.approx(linear.contour_rms_um([motion]), rel=0.01)


def test_the_search_beats_the_calibration() -> None:
    own, _ = tuner()
    rival = shaper_variant("2hump_ei", CARRIAGES, MACHINE)
    found = own.best(rival)
    assert found.cost < 0.9 * own.cost(rival, own.calibrated(rival))
    assert rival.settings_text(found.settings).count("carriage") == 3 and "damping ratio 0." in rival.settings_text(
        found.settings
    )


def test_an_inverse_beyond_the_carriages_limits_does_not_count() -> None:
    _, linear = tuner()
    weak = replace(MACHINE, limits=replace(MACHINE.limits, carriage_acceleration_mm_per_s2=4000.0))
    rival, settings = shaper_variant("smooth_mzv", INVERSE, MACHINE), np.array([200.0, 200.0, 35.0, 35.0, 0.1])
    assert VariantTuner(weak, weak, linear).cost(rival, settings) == float("inf")
    assert tuner()[0].cost(rival, settings) < 100.0


def test_every_rival_is_a_method_by_name_and_the_best_is_compared_unless_others_are() -> None:
    assert {"mzv-z", "zvddd-carriages", "smooth_si-inverse-z", "mzv-z-calibrated"} <= set(NAMES)
    assert [name for name in USUAL_NAMES if is_variant(name)] == ["mzv-z-calibrated", "mzv-z"]
    assert "mzv-inverse" not in NAMES and len(set(NAMES)) == len(NAMES) and "mzv-z-scheduled" not in USUAL_NAMES
    assert names(Request(only=("all",))) == NAMES
    assert kind_and_variant("smooth_mzv-inverse-z") == ("smooth_mzv", "-inverse-z")


def test_compare_evaluates_them_like_any_shaper() -> None:
    only = ("mzv-z", "mzv-carriages-calibrated")
    request = Request(Sampling(0, 0), quality_bound_um=0.0, only=only, predict=False)
    found = compare(Print(squares(), "squares.gcode", MACHINE), request=request)
    rms = {name: method.track.contour_rms_um for name, method in found.methods.items()}
    assert found.best_fixed == "mzv-z"
    assert rms[COMPENSATED] < rms["mzv-z"] < rms["none"] and rms["mzv-carriages-calibrated"] < rms["none"]
    assert ", z " in found.methods["mzv-z"].tuning


def test_one_clean_mode_is_inverted_where_a_delta_is_not() -> None:
    """On a cartesian whose axes are one mode each, nothing but the kernel's own smoothing is left."""
    machine = load_machine("ender-3")
    (stretch,), _ = Print(squares(), "squares.gcode", machine, (100.0, 100.0)).slices(Sampling(0, 0))
    straight = VariantTuner(machine, machine, LinearPrinter(machine, [stretch]))
    inverse, mzv = shaper_variant("smooth_mzv", INVERSE, machine), shaper_variant("mzv", "", machine)
    assert straight.cost(inverse, np.array([140.0, 140.0, 45.0, 35.0, 0.1])) < 0.3 * straight.best(mzv).cost
