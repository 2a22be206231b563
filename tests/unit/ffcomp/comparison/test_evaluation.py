"""The figures of merit, on errors that are known beforehand."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from ffcomp.comparison.equal_quality import HIGHEST, LOWEST, ROUNDS, Search
from ffcomp.comparison.evaluation import SAMPLE_S, Execution, evaluate
from ffcomp.comparison.methods import LinearPrinter
from ffcomp.comparison.sampling import Print, PrintSlice, Sampling
from ffcomp.simulation.expectation import Piece
from models.file import load_machine
from tests.support.prints import squares
from validation import judge

MACHINE = load_machine("mp-delta-pro")


@pytest.fixture(scope="module")
def stretch() -> PrintSlice:
    (found,), _ = Print(squares(), "squares.gcode", MACHINE).slices(Sampling())
    return found


def played(stretch: PrintSlice, error_mm: np.ndarray | None = None, late_s: float = 0.0) -> Execution:
    """The plan, late and off by an error (3,) or (m, 3) mm."""
    motion = stretch.motion
    t = np.arange(motion.begin_t + SAMPLE_S, motion.end_t, SAMPLE_S)
    nozzle = motion.position(t - late_s)
    return Execution(stretch, motion, t, nozzle if error_mm is None else nozzle + error_mm)


def test_a_lifted_nozzle_is_off_by_as_much_everywhere(stretch: PrintSlice) -> None:
    found = evaluate([played(stretch, np.array([0.0, 0.0, 0.01]))])
    everywhere = np.ones(len(found.due), dtype=np.bool_)
    numbers = found.track(everywhere, 1.0, 2.0)
    assert numbers.tracking_rms_um == pytest.approx(10.0, rel=1e-9)
    flat = np.ptp(found.reference[:, 2]) < 1e-9
    assert flat or found.error(found.extruding).rms_um == pytest.approx(10.0)
    assert (numbers.print_time_s, numbers.peak_command_acceleration_mm_per_s2) == (1.0, 2.0)


def test_a_late_nozzle_tracks_badly_and_prints_well(stretch: PrintSlice) -> None:
    found = evaluate([played(stretch, late_s=0.002)])
    everywhere = np.ones(len(found.due), dtype=np.bool_)
    numbers = found.track(everywhere, 1.0, 1.0)
    assert numbers.delay_s == pytest.approx(0.002, abs=2e-6)
    assert numbers.tracking_rms_um > 100.0
    assert numbers.tracking_rms_no_delay_um < 0.5
    assert numbers.contour_max_um < 1e-6


# ---- sampling ----


@pytest.mark.parametrize("name", ["ringing_tower", "lobed_vase", "far_star"])
def test_a_share_stands_for_the_whole_and_is_said(name: str) -> None:
    path = judge.ROOT / "sample_prints" / f"{name}.gcode"
    printed = Print(path.read_bytes(), path.name, MACHINE, flavor="klipper")
    stretches, sentence = printed.slices(Sampling(share=0.1))
    judged = sum(each.trajectory.end_t for each in stretches)
    assert judged == pytest.approx(0.1 * printed.print_time_s, rel=0.15)
    assert f"{len(stretches)} slices" in sentence and f"{judged:.0f} of {printed.print_time_s:.0f} s" in sentence
    begins = np.array([each.begin_t for each in stretches])
    ends = begins + [each.trajectory.end_t for each in stretches]
    assert np.all(begins[1:] > ends[:-1] - 0.5)  # from rest to rest a slice takes longer than on its way
    whole, chosen = (
        LinearPrinter(MACHINE, each).contour_rms_um(Piece.planned) for each in ([printed.whole()], stretches)
    )
    assert chosen == pytest.approx(whole, rel=0.15)


def test_another_acceleration_changes_the_times_and_not_the_path() -> None:
    (stretch,), _ = Print(squares(), "squares.gcode", MACHINE).slices(Sampling())
    slower = stretch.with_acceleration(500.0)
    assert slower.trajectory.end_t > 1.3 * stretch.trajectory.end_t
    np.testing.assert_array_equal(slower.trajectory.origin, stretch.trajectory.origin)
    travels = np.any(slower.trajectory.direction[:, :3] != 0, axis=1)
    np.testing.assert_allclose(slower.trajectory.acceleration[travels], 500.0)
    assert stretch.trajectory.acceleration[travels].max() == 5000.0


# ---- equal quality ----


ERRORS: dict[str, tuple[Callable[[float], float], float]] = {  # of an acceleration, and the highest with 25 µm
    "in proportion": (lambda a: a / 200, 5000.0),
    "a floor": (lambda a: 20 + a / 1000, 5000.0),
    "steep": (lambda a: 25 * (a / 8000) ** 3, 8000.0),
    "a limit of the carriages": (lambda a: 3.0 if a <= 7000 else np.inf, 7000.0),
    "always good": (lambda a: 1.0, HIGHEST),
}


@pytest.mark.parametrize("name", ERRORS)
@pytest.mark.parametrize("first", [LOWEST, 1000.0, 20_000.0])
def test_it_finds_the_highest(name: str, first: float) -> None:
    error, highest = ERRORS[name]
    search = Search([(first, min(error(first), 100.0) / 25.0)])
    while not search.done and len(search.tried) <= ROUNDS:
        acceleration = search.next()
        search.tried.append((acceleration, error(acceleration) / 25.0))
    assert search.good is not None
    assert 0.95 * highest <= search.good[0] <= highest
    assert search.good[1] == error(search.good[0]) / 25.0 <= 1.0
    assert search.capped == (name == "always good")
