"""Robust inversion: what is wanted of a machine that is not exactly known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffcomp.comparison.evaluation import Execution, contour
from ffcomp.comparison.methods import COMPENSATED, ROBUST, LinearPrinter, inversion, tuned
from ffcomp.comparison.sampling import Print, Sampling
from ffcomp.compensation.job import Job
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.robust import PAYING_SD, Path, RobustReference, choose_robust, mode_sd
from ffcomp.inverse.sensitivity import MARGIN
from ffcomp.inverse.settings import settings_for
from ffcomp.metrics import contour_error, rms
from ffcomp.simulation.expectation import draw_plants
from ffcomp.simulation.playback import simulate_nozzles
from models.arrays import FloatArray
from models.file import load_machine
from models.machine import Machine, with_values
from tests.support.compensated import plainly
from tests.support.prints import squares
from tests.support.settings import finely_joined

PLACE = np.array([40.0, -30.0, 5.0])


def unsure(machine: Machine, sd: float) -> Machine:
    return replace(machine, uncertainty={"default": sd})


@pytest.fixture(scope="module")
def softening(machine: Machine) -> RobustReference:
    return InverseModel(unsure(machine, 0.1), settings_for(machine))._robust


def zigzag(rows: int, side_rows: int = 50) -> FloatArray:
    """(rows, 3) mm: sides of 20 mm along x and y in turn, from rest to rest each, with constant acceleration."""
    u = (np.arange(rows) % side_rows) / side_rows
    eased = np.where(u < 0.5, 2 * u**2, 1 - 2 * (1 - u) ** 2)
    side = np.arange(rows) // side_rows
    x = 20.0 * (side // 2 % 2 + np.where(side % 2 == 0, eased * (1 - 2 * (side // 2 % 2)), 1 - 2 * (side // 2 % 2)))
    y = 20.0 * (side // 2 % 2 + np.where(side % 2 == 1, eased * (1 - 2 * (side // 2 % 2)), 0.0))
    return PLACE + np.stack([x, y, np.zeros(rows)], axis=1)


def wish(softening: RobustReference, path: FloatArray) -> FloatArray:
    """d (n, 3) mm of a path (n, 3) mm that moves all the time, with rests on both sides."""
    rested = np.concatenate([np.repeat(path[:1], MARGIN, axis=0), path, np.repeat(path[-1:], MARGIN, axis=0)])
    moving = np.zeros(len(rested), dtype=np.bool_)
    moving[MARGIN:-MARGIN] = True
    (offset,) = softening.offsets([Path(rested, moving)])
    return offset


# ---- what is wanted ------------------------------------------------------------------------------


def test_the_expected_contour_error_is_lower(softening: RobustReference, machine: Machine) -> None:
    """Over machines that were not among the draws: the mean square distance of D (r + d) to the path."""
    path, known = zigzag(800), softening.sensitivity  # ends where it begins
    wanted, length = path + wish(softening, path), 4096
    f = np.asarray(np.fft.rfftfreq(length, known.row_s), dtype=np.float64)
    g = machine.vibration.frequency_response(PLACE[:2], f, "nozzle", "nozzle")
    weight = known.control_weight / 2 * (2 * np.sin(np.pi * f * 2 * known.row_s)) ** 4
    adjoint = np.conj(np.swapaxes(g, 1, 2))
    plain = np.linalg.solve(adjoint @ g + weight[:, None, None] * np.eye(3), adjoint)
    t = np.arange(len(path), dtype=np.float64) * known.row_s

    def error(plant: Machine, wanted: FloatArray) -> float:
        lines = (
            plant.vibration.frequency_response(PLACE[:2], f, "nozzle", "nozzle")
            @ plain
            @ np.fft.rfft(wanted - path[0], length, axis=0)[:, :, None]
        )
        nozzle = path[0] + np.fft.irfft(lines[..., 0], length, axis=0)[: len(path)]
        return float(np.mean(contour_error(t, path, t, nozzle) ** 2))

    plants = draw_plants(machine, 0.1, 20)
    plainly, robustly = (np.mean([error(plant, r) for plant in plants]) for r in (path, wanted))
    assert robustly < 0.43 * plainly  # 0.405; over 100 printers 0.418


def test_printers_that_are_off_print_better_on_average(machine: Machine) -> None:
    believed = unsure(machine, 0.1)
    (stretch,), _ = Print(squares(1), "squares.gcode", machine).slices(Sampling())
    plants = draw_plants(machine, 0.1, 6)
    means = []
    for name in (COMPENSATED, ROBUST):
        motion, _ = inversion(believed, finely_joined(believed), name).motion(stretch)
        played = simulate_nozzles(plants, [motion], believed)
        squared = [np.mean(contour([Execution(stretch, motion, *each)]) ** 2) for each in played]
        means.append(float(np.mean(squared)))
        np.testing.assert_allclose(motion.position(np.array([motion.end_t]))[0], stretch.corners[1][-1], atol=2e-4)
    assert means[1] < 0.55 * means[0]


def test_at_twenty_percent_the_best_shaper_leaves_more() -> None:
    """A bed slinger whose frequencies are a guess, on printers that were not among the draws."""
    believed = unsure(load_machine("ender-3"), 0.2)
    (stretch,), _ = Print(squares(1), "squares.gcode", believed, believed.kinematics.centre_mm).slices(Sampling())
    parameters = believed.vibration.parameters()
    rng, spread = np.random.default_rng(7), parameters.relative_sd(believed.uncertainty)
    plants = [
        with_values(believed, parameters.scaled(rng.standard_normal(parameters.columns).clip(-2.5, 2.5), spread, 0.2))
        for _ in range(8)
    ]
    linear, settings = LinearPrinter(believed, [stretch]), finely_joined(believed)
    ways = [tuned(name, believed, linear, settings) for name in ("zv", "mzv", "ei", "2hump_ei", ROBUST)]
    means = []
    for way in ways:
        motion, _ = way.motion(stretch)
        played = simulate_nozzles(plants, [motion], believed)
        means.append(np.mean([rms(contour([Execution(stretch, motion, *each)])) for each in played]))
    assert means[-1] < min(means[:-1])


# ---- robust choice ----


@pytest.fixture(scope="module")
def bed_slinger() -> Machine:
    return load_machine("ender-3")


def test_a_frequency_counts_as_it_is_and_a_stiffness_for_half(machine: Machine, bed_slinger: Machine) -> None:
    for sd in (0.005, 0.05):
        assert mode_sd(unsure(bed_slinger, sd), 76.0) == pytest.approx(sd, rel=0.1)
        assert 0.4 * sd < mode_sd(unsure(machine, sd), 102.0) < 0.8 * sd
    assert mode_sd(unsure(machine, 0.0), 102.0) == 0.0


def test_a_rough_file_is_inverted_robustly_and_a_good_one_plainly(machine: Machine, bed_slinger: Machine) -> None:
    for printer, sd, robust in (
        (machine, 0.02, False),
        (machine, 0.1, True),
        (machine, 0.2, True),
        (bed_slinger, 0.01, False),
        (bed_slinger, 0.05, True),
        (bed_slinger, 0.2, True),
    ):
        choice = choose_robust(unsure(printer, sd), settings_for(printer))
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
        options = plainly(predict=False, robust="on" if robust else "off")
        stream = Job("\n".join(lines).encode(), "strokes.gcode", machine, options).lines()
        b"".join(stream)
        found = stream.value.statistics
        longer_s.append(found.print_time_s - found.original_print_time_s)
    assert longer_s[1] < 1.3 * longer_s[0] < 0.06 * found.original_print_time_s
