"""Effects in the machine file: those that change its numbers are inverted with them, the others in the loop."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from ffcomp.comparison.evaluation import Execution, contour
from ffcomp.comparison.methods import COMPENSATED, inversion
from ffcomp.comparison.sampling import Print, PrintSlice, Sampling
from ffcomp.inverse.model import GEOMETRY, InverseModel
from ffcomp.inverse.settings import settings_for
from ffcomp.inverse.solve import Sweep
from ffcomp.simulation.command import Motion
from ffcomp.simulation.playback import simulate_nozzles
from models.arrays import constant
from models.effects.catalogue import with_effect
from models.file import load_machine
from models.kinematics.cartesian import CARTESIAN, CartesianKinematics
from models.machine import Machine, MotionLimits
from models.vibration.modal import Axis, ModalAxes
from tests.support.compensated import compensated
from tests.support.prints import squares
from tests.support.settings import finely_joined

MACHINE = load_machine("mp-delta-pro")
MOUNT = {"relative_stiffness_change": [-0.4, -0.4, 0.0], "relative_damping_change": [0.0] * 3}


def command(believed: Machine, text: bytes) -> tuple[PrintSlice, Motion]:
    (stretch,), _ = Print(text, "squares.gcode", believed).slices(Sampling())
    return stretch, inversion(believed, finely_joined(believed), COMPENSATED).motion(stretch)[0]


command_once = cache(command)  # of a file that several plants are played with


def contour_rms_um(believed: Machine, plant: Machine, text: bytes = squares(1)) -> float:
    stretch, motion = command_once(believed, text) if believed is MACHINE else command(believed, text)
    ((t, nozzle),) = simulate_nozzles([plant], [motion], believed)
    return float(1e3 * np.sqrt(np.mean(contour([Execution(stretch, motion, t, nozzle)]) ** 2)))


def test_a_file_that_names_an_effect_that_is_folded_prints_as_well_as_one_without_it() -> None:
    """Which number each effect changes is asked in `test_effects.py`."""
    plant = with_effect(MACHINE, "extruder_mount", **MOUNT)
    ignorant, knowing, nominal = (contour_rms_um(*pair) for pair in ((MACHINE, plant), (plant, plant), (MACHINE,) * 2))
    assert knowing < 1.5 * nominal
    assert knowing < 0.6 * ignorant


# the effect's numbers, and how much of the error it makes must go: with the whole printer in the loop
BEYOND = {
    "coulomb_friction": ({"force_n": 2.0}, 0.15),
    "belt_position_stiffness": ({"slope_per_m": 0.8, "q_centre_mm": 250.0}, 0.6),
    "belt_backlash": ({"width_mm": 0.03}, 0.5),
    "cogging": ({"amplitude_mm": 0.01, "pitch_mm": 0.8}, 0.15),
    "command_delay": ({"delay_s": [0.001, 0.002, 0.003]}, 0.1),
    "frame_mode": ({"mass_kg": 8.0, "frequency_hz": 18.0, "damping_ratio": 0.05, "direction": "both"}, 0.4),
}


@pytest.mark.parametrize("name", BEYOND)
def test_the_whole_printer_in_the_loop_takes_the_effect_out(name: str) -> None:
    numbers, left = BEYOND[name]
    plant = with_effect(MACHINE, name, **numbers)
    ignorant, knowing = contour_rms_um(MACHINE, plant), contour_rms_um(plant, plant)
    assert knowing < left * ignorant


# of straight axes, beside and above the place where the file's numbers hold
OF_AXES = {
    "coulomb_friction": ({"force_n": 2.0}, 0.3),
    "belt_stiffness": ({"relative_change": [0.3, -0.1, 0.0]}, 0.3),
    "gantry_racking": (
        {"radius_mm": 150.0, "frequency_hz": 45.0, "damping_ratio": 0.05, "x_centre_mm": -60.0, "arm_mm": 10.0},
        0.3,
    ),
    "toolhead_mode": ({"slope_per_m": [0.0, -4.0, 0.0], "curve_per_m2": 0.0, "x_centre_mm": -60.0}, 0.3),
}


@pytest.mark.parametrize("name", OF_AXES)
def test_effects_of_straight_axes_are_taken_out_too(name: str) -> None:
    numbers, left = OF_AXES[name]
    box = CartesianKinematics(constant([[-100, 100], [-100, 100], [-1, 200]]), CARTESIAN)
    axes = ModalAxes.of([Axis([52.0], [0.06]), Axis([41.0], [0.06]), Axis()])
    machine = Machine("box", box, axes, MotionLimits(300.0, 5000.0))
    plant = with_effect(machine, name, **numbers)
    high = squares(1).replace(b"Z0.2", b"Z100.2")
    ignorant, knowing = contour_rms_um(machine, plant, high), contour_rms_um(plant, plant, high)
    assert knowing < left * ignorant


def test_a_wrong_geometry_is_named_not_compensated() -> None:
    machine = with_effect(MACHINE, GEOMETRY, arm_length_mm=0.3)
    _, result = compensated(squares(1), machine, predict=False)
    assert any(f"not compensated: {GEOMETRY}." in sentence for sentence in result.warnings)
    both = with_effect(machine, "coulomb_friction", force_n=2.0)
    printer = InverseModel(both, settings_for(both)).printer
    assert printer is not None and set(printer.effects) == {"coulomb_friction"}
    plain = InverseModel(MACHINE, settings_for(MACHINE))
    assert plain.machine is MACHINE and plain.printer is None
    assert not compensated(squares(1), MACHINE, predict=False)[1].statistics.warnings


def test_the_loop_never_makes_a_run_worse(monkeypatch: pytest.MonkeyPatch) -> None:
    """What does harm is taken back: with answers of the wrong sign, the linear command is the worst that is left."""
    plant = with_effect(MACHINE, "frame_mode", **BEYOND["frame_mode"][0])
    ignorant = contour_rms_um(MACHINE, plant)
    right = Sweep.answer
    monkeypatch.setattr(Sweep, "answer", lambda sweep, e, gamma=None: right(sweep, e if gamma is None else -e, gamma))
    assert contour_rms_um(plant, plant) < 1.000001 * ignorant
