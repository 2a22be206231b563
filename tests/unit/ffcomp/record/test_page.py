"""The page that is printed for a picture: on the bed, in one layer, and exactly what its G-code says."""

from __future__ import annotations

import numpy as np
import pytest

from ffcomp.record.gcode_writer import Recorder
from ffcomp.record.page import LARGEST_MM, PageRequest, discs_of, last_line, make_page, page_lines, twins
from gcode.reader import read_program
from models.file import load_machine

MACHINES = ("mp-delta-pro", "kossel", "voron-0", "ender-3")


@pytest.mark.parametrize("name", MACHINES)
def test_everything_lies_on_the_bed_and_under_a_scanner(name: str) -> None:
    machine = load_machine(name)
    plan = make_page(machine, PageRequest())
    assert all(np.all(machine.kinematics.contains(each.motion.vertices_mm[:, :2])) for each in plan.experiments)
    measured = np.concatenate([discs_of(plan), *(each.motion.vertices_mm[:, :2] for each, _ in twins(plan))])
    assert np.ptp(measured, axis=0).max() < LARGEST_MM
    assert len(twins(plan)) == (30 if name == "voron-0" else 40)


@pytest.mark.parametrize("name", ["voron-250", "ender-3", "mp-delta-pro"])
def test_zigzags_excite_all_that_a_file_may_be_wrong_about_and_not_too_much(name: str) -> None:
    machine = load_machine(name)
    modes = machine.vibration.modes_at(np.array(machine.kinematics.centre_mm))
    slowest = modes.frequencies_hz[modes.damping_ratios < 0.3].min()
    strokes = [stroke for stroke, _ in twins(make_page(machine, PageRequest()))]
    for factor in (0.8, 1.0, 1.25):
        omega = 2 * np.pi * factor * slowest
        for axis in (0, 1):
            waves: list[float] = []
            for stroke in strokes:
                if abs(last_line(stroke.motion).across[axis]) > 0.5:  # what rings, without damping: Duhamel's integral
                    times = np.arange(0.0, stroke.duration_s, 5e-4)
                    velocity = np.gradient(stroke.motion.nozzle(times)[:, axis], times)
                    waves.append(abs(np.trapezoid(velocity * np.exp(-1j * omega * times), times)))
            assert 0.2 < max(waves) < 0.7, (name, factor, axis, waves)


@pytest.mark.parametrize("flavor", ["klipper", "marlin", "reprapfirmware"])
def test_the_gcode_draws_the_plan_in_one_layer_and_puts_everything_back(flavor: str) -> None:
    machine = load_machine("voron-250")
    plan = make_page(machine, PageRequest())
    on = {"klipper": "SET_INPUT_SHAPER SHAPER_FREQ_X=50", "marlin": "M593 X F50", "reprapfirmware": "M593 P{var."}[
        flavor
    ]
    text = b"".join(page_lines(plan, machine, Recorder(flavor, (), (on,))))
    moves = read_program(text, "page.gcode", flavor=flavor).moves
    drawn = (moves.end[:, 3] > moves.start[:, 3]) & np.any(moves.end[:, :2] != moves.start[:, :2], axis=1)
    assert np.allclose(moves.end[drawn, 2], 0.2) and np.allclose(moves.start[drawn, 2], 0.2)
    expected = np.concatenate([each.motion.ends_mm[:, :2] for each in plan.experiments])
    assert np.allclose(moves.end[drawn, :2], expected)
    filament = (moves.end[drawn, 3] - moves.start[drawn, 3]).sum()
    assert filament == pytest.approx(sum(each.motion.ends_mm[-1, 3] for each in plan.experiments), rel=1e-5)
    assert text.index(on.encode()) > text.rindex(b"G1 X")
    accelerations = [line for line in text.splitlines() if line.startswith((b"SET_VELOCITY_LIMIT", b"M204", b"M201"))]
    assert b"3000" in accelerations[-1] or b"3000" in accelerations[-2]
