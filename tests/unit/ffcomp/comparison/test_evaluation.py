"""The figures of merit, on errors that are known beforehand."""

from __future__ import annotations

import numpy as np
import pytest

from ffcomp.comparison.evaluation import SAMPLE_S, Execution, contour_numbers, evaluate, track
from ffcomp.comparison.sampling import Print, PrintSlice, Sampling
from models.file import load_machine
from tests.support.prints import squares

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
    everywhere = np.ones(len(found.samples.due), dtype=np.bool_)
    numbers = track(found, everywhere, 1.0, 2.0)
    assert numbers.tracking_rms_um == pytest.approx(10.0, rel=1e-9)
    flat = np.ptp(found.samples.reference[:, 2]) < 1e-9
    assert flat or contour_numbers(found.samples, found.samples.extruding).rms_um == pytest.approx(10.0)
    assert (numbers.print_time_s, numbers.peak_command_acceleration_mm_per_s2) == (1.0, 2.0)


def test_a_late_nozzle_tracks_badly_and_prints_well(stretch: PrintSlice) -> None:
    found = evaluate([played(stretch, late_s=0.002)])
    everywhere = np.ones(len(found.samples.due), dtype=np.bool_)
    numbers = track(found, everywhere, 1.0, 1.0)
    assert numbers.delay_s == pytest.approx(0.002, abs=2e-6)
    assert numbers.tracking_rms_um > 100.0
    assert numbers.tracking_rms_no_delay_um < 0.5
    assert numbers.contour_max_um < 1e-6
