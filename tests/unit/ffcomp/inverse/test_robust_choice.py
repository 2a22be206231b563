"""Whether to invert robustly: by what the machine file says of its own numbers."""

from __future__ import annotations

from dataclasses import replace

import pytest

from ffcomp.compensation.job import Job, Options
from ffcomp.inverse.robust import PAYING_SD, choose_robust, mode_sd
from ffcomp.inverse.settings import settings_for
from models.file import load_machine
from models.machine import Machine


@pytest.fixture(scope="module")
def delta() -> Machine:
    return load_machine("mp-delta-pro")


@pytest.fixture(scope="module")
def bed_slinger() -> Machine:
    return load_machine("ender-3")


def unsure(machine: Machine, **uncertainty: float) -> Machine:
    return replace(machine, uncertainty={name.replace("__", "."): value for name, value in uncertainty.items()})


def test_a_frequency_counts_as_it_is_and_a_stiffness_for_half(delta: Machine, bed_slinger: Machine) -> None:
    for sd in (0.005, 0.05):
        assert mode_sd(unsure(bed_slinger, default=sd), 76.0) == pytest.approx(sd, rel=0.1)
        assert 0.4 * sd < mode_sd(unsure(delta, default=sd), 102.0) < 0.8 * sd
    assert mode_sd(unsure(delta, default=0.0), 102.0) == 0.0


def test_a_rough_file_is_inverted_robustly_and_a_good_one_plainly(delta: Machine, bed_slinger: Machine) -> None:
    for machine, sd, robust in (
        (delta, 0.02, False),
        (delta, 0.1, True),
        (delta, 0.2, True),
        (bed_slinger, 0.01, False),
        (bed_slinger, 0.05, True),
        (bed_slinger, 0.2, True),
    ):
        choice = choose_robust(unsure(machine, default=sd), settings_for(machine))
        assert choice.robust == robust
        assert "[uncertainty]" in choice.reason
        assert ("--robust off" if robust else f"from {100 * PAYING_SD:g} %") in choice.reason


def test_robust_inversion_costs_no_print_time_on_short_hard_strokes() -> None:
    """Lifts, travels and corners at 300 mm/s, each from rest: what asks for too much there is inverted plainly."""
    lines = [
        "; gcode_flavor = klipper",
        "G28",
        "G90",
        "M83",
        "M204 S40000",
        "G1 X-57 Y-28 Z.2 F6000",
        "G1 X-56 E.1 F4800",
    ]
    for k in range(6):
        x = -57 + 0.6 * k
        lines += ["G1 E-1 F6000", "G1 Z.4 F60000", f"G0 X{x:.1f} Y-28 F60000", "G1 Z.2 F60000", "G1 E1 F6000"]
        lines += [f"G1 X{x + 21.2:.1f} Y-6.8 E1 F18000", f"G1 X{x:.1f} Y14.4 E1"]
    machine = load_machine("flsun-t1")
    longer_s = []
    for robust in (False, True):
        options = Options(predict=False, settings=replace(settings_for(machine), robust=robust))
        stream = Job("\n".join(lines).encode(), "strokes.gcode", machine, options).lines()
        b"".join(stream)
        found = stream.value.statistics
        longer_s.append(found.print_time_s - found.original_print_time_s - found.settling_s)
    assert longer_s[1] < 1.3 * longer_s[0] < 0.06 * found.original_print_time_s
