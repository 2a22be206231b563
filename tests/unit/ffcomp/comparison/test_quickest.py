"""How long a print takes at equal error: the same rules for all, and an answer that its numbers bear out."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from ffcomp.comparison.methods import none
from ffcomp.comparison.quickest import QuickestRequest, quickest
from ffcomp.comparison.quickest_plans import TRAVEL, BoundedSlice, SettingSearch, WholePrint, seconds_of
from ffcomp.comparison.result import Quickest
from ffcomp.comparison.sampling import Print, Sampling
from ffcomp.faster.bound import Bound
from ffcomp.report.compare.words import duration
from ffcomp.report.quickest.words import answer, sentences
from models.file import load_machine
from tests.support.prints import squares

MACHINE = load_machine("mp-delta-pro")
KLIPPER_PRINT = b"; gcode_flavor = klipper\n" + squares(2)
BOUND = Bound(25.0, max_flow_mm3_per_s=20.0, min_layer_time_s=0.0, change_speed=("first layer",))


@cache
def printed() -> Print:
    return Print(KLIPPER_PRINT, "squares.gcode", MACHINE)


def stretch(bound: Bound = BOUND) -> BoundedSlice:
    return BoundedSlice.of(printed().whole(), printed().labels.features, bound)


@cache
def found() -> Quickest:
    certain = {"kinematics.arm_length_mm": 0.0, "kinematics.delta_radius_mm": 0.0}
    machine = replace(MACHINE, uncertainty={"default": 0.02, **certain})
    request = QuickestRequest(BOUND, Sampling(1, 1), ("mzv",), 0.1, 2)
    return quickest(Print(KLIPPER_PRINT, "squares.gcode", machine), request=request)


def test_feeds_and_acceleration_change_only_what_is_free() -> None:
    usual = stretch(replace(BOUND, change_speed=()))
    own, quick = usual.print_slice, usual.at(2.0, 20_000.0)
    first, free = own.layer == 0, usual.free
    before, after = own.planned.program.moves, quick.planned.program.moves
    assert first.any() and not usual.free[first].any() and free.any()
    assert np.array_equal(after.speed[first], before.speed[first])
    assert (after.acceleration[first] <= before.acceleration[first]).all()
    assert (after.acceleration[free] == 20_000.0).all()
    slow = usual.at(0.5, 1000.0).planned.program.moves
    travels = np.any(before.end[:, :3] != before.start[:, :3], axis=1)
    assert np.allclose(slow.speed[first & travels], 0.5 * before.speed[first & travels])


def test_no_method_exceeds_the_flow() -> None:
    own = stretch(replace(BOUND, max_flow_mm3_per_s=12.0))
    quick = own.at(3.5, 20_000.0)
    flowing = quick.extrudes & own.free
    filament = quick.trajectory.direction[:, 3]
    flow = (quick.planned.program.moves.speed * filament)[flowing] * 0.25 * np.pi * 1.75**2
    assert flow.max() == pytest.approx(12.0)


def test_the_whole_is_what_its_slices_say_and_layers_are_not_too_short() -> None:
    whole = WholePrint(printed(), BOUND)
    faster = seconds_of(whole.bounded.at(2.0, 10_000.0).trajectory)
    assert whole.at(2.0, 10_000.0).sum() == pytest.approx(faster.sum())
    assert whole.from_slices([whole.bounded], [faster]).sum() == pytest.approx(faster.sum())
    assert sum(whole.by_feature(faster).values()) == pytest.approx(faster.sum())
    assert TRAVEL in whole.by_feature(faster)
    layer = whole.bounded.print_slice.layer
    sliced = np.bincount(layer, whole.bounded.seconds)
    cooling = WholePrint(printed(), replace(BOUND, min_layer_time_s=float(0.9 * sliced.min())))
    assert np.bincount(layer, cooling.cooled(faster)).min() == pytest.approx(0.9 * sliced.min())
    never = WholePrint(printed(), replace(BOUND, min_layer_time_s=1e3))
    assert np.allclose(np.bincount(layer, never.cooled(faster)), sliced)  # not slower than it was sliced
    assert whole.actuator_limit_s() < faster.sum()


def test_the_search_finds_the_quickest_setting_that_keeps_the_bound() -> None:
    own = stretch()
    search = SettingSearch(none(), [own], MACHINE, 60.0)
    setting = search.setting((1.0, 0.5))
    assert setting.reached and search._keeps(setting.feed, setting.acceleration_mm_per_s2)
    assert not search._keeps(setting.feed, 1.1 * setting.acceleration_mm_per_s2)
    assert not SettingSearch(none(), [own], MACHINE, 0.1).setting((1.0,)).reached


def test_the_answer() -> None:
    said, every = answer(found()), found().methods
    assert list(every) == ["none", "mzv", "fbs-lpv", "faster"]
    assert duration(found().sliced.print_time_s) in said and duration(found().faster.print_time_s) in said
    assert found().actuator_limit_s < min(each.print_time_s for each in every.values())
    assert every["faster"].reached and every["faster"].print_time_s < every["none"].print_time_s
    assert every["faster"].print_time_s < found().sliced.print_time_s
    for each in every.values():
        assert each.contour_p99_um <= 25.0 or not each.reached
        assert sum(each.by_feature_s.values()) == pytest.approx(each.print_time_s)
    assert sum(every["faster"].limited_by.values()) == pytest.approx(every["faster"].print_time_s)
    assert all(len(each.off_p99_um) == 2 for each in every.values())
    assert max(every["mzv"].off_p99_um) > 1.2 * every["mzv"].contour_p99_um  # it was tuned on the printer itself
    assert "2 printers" in " ".join(sentences(found()))
    missed = replace(found(), methods={**every, "faster": replace(every["faster"], reached=False)})
    assert "not kept" in answer(missed)


def test_slices_stand_for_a_print_and_say_so() -> None:
    slices, said = printed().slices(Sampling(share=0.5), 2.0)
    assert len(slices) > 1 and "stand for" in said
    some = [BoundedSlice.of(each, printed().labels.features, BOUND) for each in slices]
    halved = [0.5 * each.seconds for each in some]
    whole = WholePrint(printed(), BOUND)
    assert whole.from_slices(some, halved).sum() == pytest.approx(
        float((whole.bounded.seconds * np.where(whole.bounded.free, 0.5, 1.0)).sum())
    )
