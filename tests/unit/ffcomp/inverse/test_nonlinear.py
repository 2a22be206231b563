"""The loop with the whole printer: how far it gets, what it costs, and that it keeps the limits."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest

from ffcomp.comparison.sampling import Print, PrintSlice, Sampling
from ffcomp.compensation.solve import solutions
from ffcomp.inverse import nonlinear
from ffcomp.inverse.command_limits import peak_utilisation
from ffcomp.inverse.feasible import SolvedSection
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.nonlinear import FrictionBacklash, guide_friction
from ffcomp.inverse.reference import Reference
from ffcomp.inverse.settings import settings_for
from ffcomp.inverse.solve import Sweep
from models.arrays import FloatArray
from models.effects.catalogue import with_effect
from models.file import load_machine
from models.kinds import delta_vibration
from models.machine import Machine
from models.printer.kernels.friction import MOST_STRAIN
from models.printer.parameters import converted_printer
from models.printer.printer import simulate_printer
from tests.support.prints import squares

MACHINE = load_machine("mp-delta-pro")
PLAY = with_effect(MACHINE, "belt_backlash", width_mm=0.06)
FRICTION = with_effect(MACHINE, "coulomb_friction", force_n=4.0)


@cache
def part() -> PrintSlice:
    (found,), _ = Print(squares(1), "squares.gcode", MACHINE).slices(Sampling())
    return found


def solved(machine: Machine, printer: Machine | None = None) -> tuple[InverseModel, list[SolvedSection]]:
    inverter = InverseModel(machine, settings_for(machine))
    vars(inverter)["printer"] = printer or inverter.printer  # a printer that is not the one believed in
    return inverter, [each for _, each in solutions(part().planned, inverter) if each is not None]


@cache
def answers_of(machine: Machine) -> tuple[list[SolvedSection], int]:
    """The answers for a printer that is as its file says, and how often all of it was simulated."""
    with patch.object(nonlinear, "_played", side_effect=nonlinear._played) as rounds:
        return solved(machine, machine)[1], rounds.call_count


def tracking_um(answers: list[SolvedSection]) -> float:
    """Rms of the error that the loop has seen in the end."""
    errors = []
    for each in answers:
        wanted, _ = each.reference.substeps(each.reference.knots)
        errors.append(np.sum((wanted[1:] - each.solution.response) ** 2, axis=1))
    return 1e3 * float(np.sqrt(np.mean(np.concatenate(errors))))


@pytest.mark.parametrize(("plant", "most"), [(PLAY, 16), (FRICTION, 8)], ids=["play", "friction"])
def test_within_one_and_a_half_times_the_printer_without_the_effect(plant: Machine, most: int) -> None:
    answers, rounds = answers_of(plant)
    assert tracking_um(answers) < 1.5 * tracking_um(answers_of(MACHINE)[0])
    assert rounds <= most


@cache
def linear_um(plant: Machine) -> float:
    """What the linear command does on the plant: played once, and left as it is."""
    with patch.object(nonlinear, "FEEDFORWARD_EFFECTS", ()), patch.object(nonlinear, "ROUNDS", 2):
        return tracking_um(solved(plant)[1])


def test_friction_and_play_together() -> None:
    both = with_effect(FRICTION, "belt_backlash", width_mm=0.06)
    assert tracking_um(solved(both)[1]) < 0.1 * linear_um(both)


def test_play_too_wide_to_be_crossed_leaves_no_run_worse_than_the_linear_command() -> None:
    wide = with_effect(MACHINE, "belt_backlash", width_mm=1.0)
    with patch.object(nonlinear, "FEEDFORWARD_EFFECTS", ()), patch.object(nonlinear, "ROUNDS", 2):
        linear = solved(wide)[1]
    for before, after in zip(linear, solved(wide)[1], strict=True):
        assert tracking_um([after]) <= tracking_um([before]) * 1.000001


@pytest.mark.parametrize("plant", [PLAY, FRICTION], ids=["play", "friction"])
def test_no_limit_is_broken_for_an_effect(plant: Machine) -> None:
    free, linear = (max(each.solution.utilisation for each in answers_of(of)[0]) for of in (plant, MACHINE))
    assert free > 1.1 * linear
    ceiling = 0.5 * (free + linear) * plant.limits.carriage_acceleration_mm_per_s2
    tight = replace(plant, limits=replace(plant.limits, carriage_acceleration_mm_per_s2=ceiling))
    inverter, answers = solved(tight)
    assert max(each.solution.utilisation for each in answers) <= 1.0
    assert all(peak_utilisation(each.solution.vertices, inverter.limits) <= 1.0 for each in answers)
    assert tracking_um(answers) < 3.0 * tracking_um(answers_of(MACHINE)[0])


# ---- friction backlash ----


ROW_S = 1e-3


def friction(machine: Machine, q_mm: FloatArray) -> FloatArray:
    return guide_friction(converted_printer(machine).parameters, q_mm / 1e3, ROW_S)


def along(speed_mm_per_s: float, seconds: float = 1.0) -> FloatArray:
    return np.outer(speed_mm_per_s * ROW_S * np.arange(round(seconds / ROW_S)), np.ones(3))


def test_steady_sliding_feels_the_force_of_the_closed_form() -> None:
    """φ̇ = 0 leaves φ = 1/(1/φ_m + r): F = ℓ tanh(r + φ)."""
    machine = with_effect(MACHINE, "coulomb_friction", force_n=2.0, creep_mm_per_s=0.5, hold_per_s=50.0)
    for speed in (0.25, 0.5, 2.0, 50.0):
        r = speed / 0.5
        assert friction(machine, along(speed))[-1] == pytest.approx(2.0 * np.tanh(r + 1 / (1 / MOST_STRAIN + r)), 1e-3)


def test_the_surplus_of_stribeck_fades_with_speed() -> None:
    table: dict[str, Any] = {"force_n": 1.0, "extra_force_n": 0.8, "velocity_mm_per_s": 20.0, "exponent": 2.0}
    machine = with_effect(MACHINE, "stribeck_friction", **table)
    assert friction(machine, along(20.0))[-1] == pytest.approx(1.0 + 0.8 / np.e, rel=1e-3)
    assert friction(machine, along(200.0))[-1] == pytest.approx(1.0, rel=1e-6)


def test_it_is_the_force_that_the_printer_feels() -> None:
    """Drawn along slowly, the belts of the virtual printer are longer by F/k than without friction."""
    machine = with_effect(MACHINE, "coulomb_friction", force_n=2.0)
    q = MACHINE.kinematics.inverse(np.array([[0.0, 0.0, 50.0]])) + along(2.0, 1.5)
    motions = [simulate_printer(each, q, ROW_S, hold="linear") for each in (machine, MACHINE)]
    longer = np.subtract(*((m.motor_mm - m.carriage_mm)[-1] for m in motions))
    assert longer == pytest.approx(
        1e3 * friction(machine, q)[-1] / delta_vibration(MACHINE).carriage.belt_stiffness_n_per_m, rel=0.02
    )


def test_friction_that_bends_is_a_spring_that_gives_way() -> None:
    """From rest ℓ (1 − exp(−x/s₀)), whatever the speed; turned round ℓ (2 exp(−x/s₀) − 1); and so the printer feels."""
    machine = with_effect(MACHINE, "coulomb_friction", force_n=2.0, presliding_mm=0.02)
    there = along(0.1, 2.0)
    for faster in (1, 5):
        assert friction(machine, there[::faster])[200 // faster] == pytest.approx(2.0 * (1 - np.exp(-1.0)), rel=1e-3)
    assert friction(machine, np.concatenate([there, there[::-1]]))[2200] == pytest.approx(2 * (2 / np.e - 1), abs=0.02)
    q = MACHINE.kinematics.inverse(np.array([[0.0, 0.0, 50.0]])) + along(0.1, 0.4)
    motions = [simulate_printer(each, q, ROW_S, hold="linear") for each in (machine, MACHINE)]
    longer = np.subtract(*((m.motor_mm - m.carriage_mm)[-1] for m in motions))
    moved = motions[0].carriage_mm - motions[0].carriage_mm[0]
    expected = friction(machine, moved)[-1] / delta_vibration(MACHINE).carriage.belt_stiffness_n_per_m
    assert longer == pytest.approx(1e3 * expected, rel=0.02)


@cache
def longest_run() -> Reference:
    """Of a square."""
    (part,), _ = Print(squares(1), "squares.gcode", MACHINE).slices(Sampling())
    solved = (each for _, each in solutions(part.planned, InverseModel(MACHINE, settings_for(MACHINE))) if each)
    return max((each.reference for each in solved), key=lambda wanted: wanted.knots)


def foreseen(machine: Machine, stretch: FloatArray) -> tuple[Sweep, FloatArray]:
    """A run, and what is to be added to its command."""
    inverter = InverseModel(machine, settings_for(machine))
    run = Sweep(inverter, longest_run())
    return run, FrictionBacklash(inverter, machine).command(run, stretch)


def test_play_is_crossed_when_the_belt_turns_to_push() -> None:
    """Carriage A's belt pulls, pushes for 100 ms, and pulls again: its command goes down by w and comes back."""
    width, rows = 0.05, np.arange(3000)
    stretch = np.full((len(rows), 3), 0.05)
    stretch[600:700, 0] = -0.05
    machine = with_effect(MACHINE, "belt_backlash", width_mm=width)
    _, command = foreseen(machine, stretch)
    assert command[160, 0] == pytest.approx(-width, rel=0.05)
    assert np.abs(command[:, 1:]).max() < 0.1 * width  # the others hardly move
    assert np.abs(command[:120]).max() < 0.1 * width and np.abs(command[220:]).max() < 0.1 * width
    assert not foreseen(machine, np.full((1, 3), 0.05))[1].any()  # a belt that always pulls lies on one side
