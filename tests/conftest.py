"""Set up all tests: which are slow, no log, one cache for all of them, and the same draws of properties every time.

HYPOTHESIS_PROFILE=default seeks new draws, FUZZ_FROM (`fuzz/test_random_programs.py`) new prints.
"""

from __future__ import annotations

import gc
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

from tests.support.undrawn import save_nothing

os.environ["FFCOMP_LOG"] = "off"
if "PYTEST_XDIST_WORKER" not in os.environ:  # all workers share what one has computed for a machine
    cache = tempfile.TemporaryDirectory(prefix="ffcomp-tests-")
    os.environ["FFCOMP_CACHE"] = cache.name
gc.set_threshold(50_000, 50, 100)  # as the command line does: what is imported and compiled stays
sys.dont_write_bytecode = False  # pytest keeps the tests it has compiled: that halves the time of collection

settings.register_profile("same", derandomize=True, deadline=None)  # others may use the machine too
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "same"))

TESTS = Path(__file__).parent
NOT_SLOW = "not slow"
SLOW = (  # folders and files; single tests have the marker themselves
    "docs/test_compatibility.py",
    "docs/test_examples.py",
    "e2e",
    "fuzz",
    "integration",
    "unit/ffcomp/api/test_public.py",
    "unit/ffcomp/check",
    "unit/ffcomp/faster",
    "unit/ffcomp/cli/test_help.py",
    "unit/ffcomp/comparison/test_engine.py",
    "unit/ffcomp/comparison/test_baselines.py",
    "unit/ffcomp/compensation/test_gcode_layout.py",
    "unit/ffcomp/compensation/test_gcode_writer.py",
    "unit/ffcomp/compensation/test_prediction.py",
    "unit/ffcomp/diagnosis",
    "unit/ffcomp/identification/test_axes.py",
    "unit/ffcomp/identification/test_ringing.py",
    "unit/ffcomp/identification/test_direct.py",
    "unit/ffcomp/identification/test_modal_fit.py",
    "unit/ffcomp/identification/test_resonance_tests.py",
    "unit/ffcomp/identification/test_scan.py",
    "unit/ffcomp/inverse/test_nonlinear.py",
    "unit/ffcomp/inverse/test_robust.py",
    "unit/ffcomp/inverse/test_time_scaling.py",
    "unit/ffcomp/inverse/test_lq_preview.py",
    "unit/ffcomp/measurement/test_modes.py",
    "unit/ffcomp/record",
    "unit/ffcomp/report/test_diagnose.py",
    "unit/ffcomp/report/test_identify.py",
    "unit/ffcomp/shapers/test_calibration.py",
    "unit/gcode/test_reader.py",
    "unit/gcode/test_reader_parts.py",
    "unit/models/printer/test_printer_effects.py",
    "unit/models/printer/test_playback.py",
    "unit/models/printer/test_straight_axes.py",
    "unit/models/test_effects.py",
    "unit/models/test_file.py",
    "unit/models/vibration/test_receptance.py",
    "test_packages.py",
    "unit/validation",
)
FAST = (  # in slow folders: every package has a test in each quick run
    "e2e/test_estimate.py",
    "unit/ffcomp/check/test_history.py",
    "unit/ffcomp/diagnosis/test_pitches.py",
    "unit/ffcomp/faster/test_predicted_error.py",
    "unit/ffcomp/record/test_multisine.py",
)
SLOW_NAMES = ("test_against_kalico.py",)  # wherever they are


def is_slow(path: Path) -> bool:
    """Return whether a file of tests is one of SLOW, or in one; a folder is not, if it has one of FAST."""
    if any((TESTS / fast).is_relative_to(path) for fast in FAST):
        return False
    return path.name in SLOW_NAMES or any(path.is_relative_to(TESTS / slow) for slow in SLOW)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave slow files unread where no slow test is wanted: what they import takes long too."""
    return True if config.option.markexpr == NOT_SLOW and is_slow(collection_path) else None


def pytest_collection_finish() -> None:
    """Let the garbage collector pass over all that has been read until now."""
    gc.freeze()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests of slow files."""
    for item in items:
        if is_slow(item.path):
            item.add_marker(pytest.mark.slow)


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are composed, but what is written of each is empty: that they can be drawn is tested where they are made.

    Drawing takes half of the time of a verb that writes a page.
    """
    monkeypatch.setattr("matplotlib.figure.Figure.savefig", save_nothing)


@pytest.fixture(scope="session")
def machine() -> Any:
    """Return the delta of the paper, which no test changes."""
    from tests.support import machines  # not read where nobody asks for it

    return machines.machine()


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Yield a running browser."""
    from tests.support.browser import chromium

    with chromium() as running:
        yield running
