"""The loop with the whole printer: how far it gets, what it costs, and that it keeps the limits."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from unittest.mock import patch

import numpy as np
import pytest

from ffcomp.comparison.sampling import Print, PrintSlice, Sampling
from ffcomp.compensation.solve import solutions
from ffcomp.inverse import nonlinear
from ffcomp.inverse.command_limits import peak_utilisation
from ffcomp.inverse.feasible import SolvedSection
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.settings import settings_for
from models.effects.catalogue import with_effect
from models.file import load_machine
from models.machine import Machine
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
    return inverter, list(solutions(part().planned, inverter, keep_responses=True))


@cache
def answers_of(machine: Machine) -> tuple[list[SolvedSection], int]:
    """The answers for a printer that is as its file says, and how often all of it was simulated."""
    with patch.object(nonlinear, "_played", side_effect=nonlinear._played) as rounds:
        return solved(machine)[1], rounds.call_count


def tracking_um(answers: list[SolvedSection]) -> float:
    """Rms of the error that the loop has seen in the end."""
    errors = []
    for each in answers:
        wanted, _ = each.reference.substeps(0, each.reference.knots)
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
