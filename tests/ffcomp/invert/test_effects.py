"""A machine file whose effects change its numbers is inverted with those numbers; of the others the user is told."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ffcomp.compare.judge import Played, contour
from ffcomp.compare.play import play
from ffcomp.compare.stretch import Print, Sampling
from ffcomp.compare.ways import OURS, inversion
from ffcomp.job import Job
from ffcomp.pipeline import settings_for
from models.effects.catalogue import design_machine, with_effect
from models.machine import Machine
from models.machine_file import load_machine
from tests.ffcomp.compare.prints import squares

MACHINE = load_machine("mp-delta-pro")
FOLDED = {
    "belt_stiffness": {"relative_change": -0.15},
    "effector_mass": {"added_kg": 0.1},
    "extruder_mount": {"relative_stiffness_change": [0.3, 0.3, 0.0], "relative_damping_change": [0.0] * 3},
}


def contour_rms_um(believed: Machine, plant: Machine) -> float:
    (stretch,), _ = Print(squares(1), "squares.gcode", believed).stretches(Sampling())
    motion, _ = inversion(believed, settings_for(believed), OURS).motion(stretch)
    t, (nozzle,) = play([plant], motion, believed)
    return float(1e3 * np.sqrt(np.mean(contour([Played(stretch, motion, t, nozzle)]) ** 2)))


@pytest.mark.parametrize("name", FOLDED)
def test_a_file_that_names_the_effect_prints_as_well_as_one_without_it(name: str) -> None:
    plant = with_effect(MACHINE, name, **FOLDED[name])
    ignorant, knowing, nominal = (contour_rms_um(*pair) for pair in ((MACHINE, plant), (plant, plant), (MACHINE,) * 2))
    assert knowing < 1.5 * nominal
    assert knowing < 0.6 * ignorant


def test_one_soft_belt_is_known_too() -> None:
    plant = with_effect(MACHINE, "belt_stiffness", relative_change=[-0.2, 0.0, 0.0])
    assert contour_rms_um(plant, plant) < 0.6 * contour_rms_um(MACHINE, plant)


def test_what_the_linear_model_cannot_hold_is_named(tmp_path: Path) -> None:
    machine = with_effect(with_effect(MACHINE, "coulomb_friction", force_n=2.0), "belt_stiffness", relative_change=0.1)
    assert design_machine(machine)[1] == ("coulomb_friction",)
    job = Job(squares(1), "squares.gcode", machine, predict=False)
    assert any("not compensated: coulomb_friction." in sentence for sentence in job.result()["warnings"])
    plain = Job(squares(1), "squares.gcode", MACHINE, predict=False)
    assert plain.result()["warnings"] == [] and plain.inverter.machine is MACHINE
