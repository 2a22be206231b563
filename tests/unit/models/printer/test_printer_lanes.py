"""Printers simulated side by side: each lane as if it were alone."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from models.effects.catalogue import with_effect
from models.errors import UnreachableError
from models.kinds import delta_vibration, with_parts
from models.kinematics.delta import DeltaKinematics
from models.machine import Machine
from models.printer.kernels import integrate, vectors
from models.printer.kernels.integrate import find_equilibrium
from models.printer.kernels.motors import cubic_spline
from models.printer.parameters import converted_printer
from models.printer.printer import PrinterMotion, simulate_printer, simulate_printers
from tests.support.effects import TABLES

RATE_HZ = 1600
FIELDS = (
    "t_s",
    "carriage_mm",
    "carriage_acceleration",
    "nozzle_mm",
    "nozzle_acceleration",
    "motor_mm",
)
FOLDED = ("guide_damping", "belt_stiffness", "effector_mass", "arm_inertia", "extruder_mount", "force_map")
EFFECTS = {name: table for name, table in TABLES.items() if name not in FOLDED}


def swinging(geometry: DeltaKinematics, seconds: float = 0.3, reach_mm: float = 30.0) -> np.ndarray:
    """(n, 3) mm, from rest."""
    t = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    x = reach_mm * np.sin(2 * np.pi * 3 * t) + 0.5 * np.sin(2 * np.pi * 33 * t)
    path = np.column_stack([x, 20 * np.sin(2 * np.pi * 4 * t), 30 + 2 * np.sin(2 * np.pi * 11 * t)])
    return geometry.inverse(path * np.minimum(t / 0.1, 1)[:, None] ** 2)


def assert_alike(ours: PrinterMotion | ValueError, alone: PrinterMotion) -> None:
    assert isinstance(ours, PrinterMotion)
    for field in FIELDS:
        expected = getattr(alone, field)
        np.testing.assert_allclose(getattr(ours, field), expected, rtol=0, atol=1e-11 * np.abs(expected).max())
    assert ours.state.t_s == alone.state.t_s
    np.testing.assert_allclose(ours.state.values, alone.state.values, rtol=0, atol=1e-11)
    np.testing.assert_array_equal(ours.state.history, alone.state.history)


@pytest.fixture
def mixture(printer: Machine) -> list[Machine]:
    """Eighteen printers, hardly two of a kind."""
    paper = with_effect(with_effect(printer, "force_map"), "center_of_mass", offset_mm=[15.0, -10.0, 5.0])
    ideal = with_parts(printer, carriage=replace(delta_vibration(printer).carriage, drive=None))
    changed = {name: with_effect(printer, name, **table) for name, table in EFFECTS.items()}
    every = paper
    for name, table in EFFECTS.items():
        every = with_effect(every, name, **table)
    several = with_effect(changed["coulomb_friction"], "command_delay", delay_s=0.004)
    return [*changed.values(), printer, paper, ideal, every, several, with_effect(ideal, "belt_backlash", width_mm=0.1)]


@pytest.mark.parametrize("hold", ["cubic", "linear"])
def test_neighbours_change_nothing(mixture: list[Machine], hold) -> None:
    command = swinging(mixture[0].kinematics)
    printers = list(map(converted_printer, mixture))
    together = simulate_printers(printers, [command] * len(mixture), 1 / RATE_HZ, hold=hold, substeps=8)
    for machine, ours in zip(mixture, together, strict=True):
        assert_alike(ours, simulate_printer(machine, command, 1 / RATE_HZ, hold=hold, substeps=8))


def test_a_failure_harms_nobody(printer: Machine) -> None:
    """Lost reach, motors that hold nothing, and commands of another shape."""
    good = swinging(printer.kinematics)
    wild, blind = good.copy(), good.copy()
    wild[100:] += np.linspace(0, 1, len(good) - 100)[:, None] * [400.0, -400.0, 0.0]
    blind[7, 1] = np.nan
    weak = with_effect(printer, "torque_angle", amplitude_mm=1e-3)
    machines = [printer, printer, weak, printer, printer, printer]
    commands = [good, wild, good, blind, good[:, :2], good]
    first, *bad, last = simulate_printers(list(map(converted_printer, machines)), commands, 1 / RATE_HZ)
    alone = simulate_printer(printer, good, 1 / RATE_HZ)
    assert_alike(first, alone)
    assert_alike(last, alone)
    for machine, command, ours in zip(machines[1:-1], commands[1:-1], bad, strict=True):
        assert isinstance(ours, ValueError)
        with pytest.raises(type(ours), match=f"^{re.escape(str(ours))}$"):
            simulate_printer(machine, command, 1 / RATE_HZ)
    assert isinstance(bad[0], UnreachableError)
    np.testing.assert_array_equal(bad[0].indices, np.arange(bad[0].indices[0], len(wild)))


def test_cached_code_depends_on_every_file_of_the_kernels() -> None:
    """Numba alone would keep the code of a function whose callee in another file has changed."""
    kernels = [find_equilibrium, cubic_spline, *(f for f in vars(integrate).values() if hasattr(f, "py_func"))]
    cached = [f for f in kernels if f.targetoptions.get("forceinline") is None]
    assert {f._cache.files._cache_file._source_stamp for f in cached} == {vectors.SOURCES}
