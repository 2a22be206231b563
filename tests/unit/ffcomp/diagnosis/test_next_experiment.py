"""What to measure next: proposals are safe, can be played as they are written, and keep their promise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from ffcomp.diagnosis import next_experiment as experiment
from ffcomp.diagnosis.diagnosis import Diagnosis
from ffcomp.diagnosis.fit import EstimationProblem, Fit, estimation_problem
from ffcomp.diagnosis.hypotheses import Hypothesis
from ffcomp.diagnosis.next_experiment import Proposal, library, positions, propose
from ffcomp.diagnosis.noise import noise_floor, whitener
from ffcomp.diagnosis.printer_problem import PrinterProblem
from ffcomp.diagnosis.problem import Parameter
from ffcomp.diagnosis.score_test import screen
from ffcomp.measurement.recording import Recording
from ffcomp.planner.program import plan_program
from gcode.reader import read_program
from models.file import load_machine
from models.machine import Machine

NAMES = ("coulomb_friction", "stribeck_friction", "belt_position_stiffness", "torque_angle")
QUIET, LOUD = 0.1, 12.0  # m/s²
DELAY, DAMPING = "effects.command_delay.delay_s", "effects.guide_damping.added_n_s_per_m"


@pytest.fixture(scope="module")
def machine() -> Machine:
    return load_machine("mp-delta-pro")


def recorded(machine: Machine, noise: float) -> list[Recording]:
    """Two repeats of a gentle motion, simulated, with white noise."""
    t = np.arange(0, 0.9, 1 / 1600)
    window = np.clip(np.minimum(t, 0.9 - t) / 0.2, 0, 1)
    nozzle = np.column_stack([window * 2 * np.sin(60 * t), window * np.sin(90 * t), 30 + 0 * t])
    gaps, names = np.zeros(len(t), dtype=bool), [f"acc_{a}" for a in "ABCxyz"]
    blank = Recording(
        "x-1.csv", t, machine.kinematics.inverse(nozzle), "carriage", dict.fromkeys(names, 0 * t), {}, gaps, {}
    )
    true = PrinterProblem(machine, [blank], ()).simulate({})[0]
    hiss = noise * np.random.default_rng(0).standard_normal((2, *true.shape))
    return [
        replace(blank, source=f"x-{i}.csv", acceleration=dict(zip(names, (true + n).T, strict=True)))
        for i, n in enumerate(hiss, 1)
    ]


@pytest.fixture(scope="module")
def plant(machine: Machine) -> PrinterProblem:
    return PrinterProblem(machine, recorded(machine, QUIET), NAMES)


def fitted(estimation: EstimationProblem, values: dict[str, float]) -> Fit:
    """Numbers held at some values."""
    parameters = tuple(Parameter(name, x, 1.0) for name, x in values.items())
    residual = estimation.residual(values)
    return Fit(parameters, np.zeros(len(parameters)), residual, np.zeros((len(residual), len(parameters))))


def diagnosed(
    plant: PrinterProblem, *hypotheses: tuple[Sequence[str], dict[str, float]], named: bool = True
) -> Diagnosis:
    """A diagnosis with these hypotheses, the first the best; none if there are none."""
    noise = noise_floor(plant)
    estimation = estimation_problem(plant, whitener(plant.observations, noise, plant.band_hz))
    base = fitted(estimation, {})
    screened = screen(estimation, base, plant.candidates) if not hypotheses else ()
    kinds = {c.name: c for c in PrinterProblem(plant.machine, plant.recordings).candidates}
    tried = [Hypothesis(tuple(kinds[n] for n in names), fitted(estimation, values)) for names, values in hypotheses]
    best = tried[0] if tried else None
    verdict = "none" if best is None else "effects" if named else "unknown"
    final = best.fit if best else base
    return Diagnosis(
        verdict=verdict,
        finding="",
        estimation=estimation,
        noise=noise,
        base=base,
        final=final,
        screened=screened,
        named=best if named else None,
        best=best,
        tried=tried,
    )


LATE = (("command_delay",), {DELAY: 1e-3})
DAMPED = (("guide_damping",), {DAMPING: 12.0})
BOTH = (("command_delay", "guide_damping"), {DELAY: 1e-3, DAMPING: 3.0})


def check(machine: Machine, proposal: Proposal) -> None:
    """Inside the machine's volume and limits, and the nozzle ends where it began."""
    program = read_program(proposal.gcode.encode(), "next.gcode")
    planned = plan_program(program, machine)
    assert not program.warnings
    trajectory, limits = planned.trajectory, machine.limits
    t = np.linspace(float(trajectory.start_t[0]), trajectory.end_t, 2000)
    nozzle = trajectory.position(t)[:, :3]
    assert np.hypot(*nozzle[:, :2].T).max() < machine.kinematics.print_radius_mm
    assert nozzle[:, 2].min() > 5.0 and nozzle[:, 2].max() < machine.kinematics.print_height_mm
    np.testing.assert_allclose(nozzle[-1], proposal.position_mm, atol=1e-3)
    assert np.linalg.norm(trajectory.velocity(t)[:, :3], axis=1).max() <= limits.velocity_mm_per_s * (1 + 1e-9)
    assert np.linalg.norm(trajectory.acceleration_at(t)[:, :3], axis=1).max() <= limits.acceleration_mm_per_s2 * 1.001
    carriages = np.gradient(machine.kinematics.inverse(nozzle), t, axis=0)
    assert np.abs(carriages).max() < limits.carriage_velocity_mm_per_s


@pytest.mark.parametrize("name", ["mp-delta-pro", "kossel", "flsun-qqs"])
def test_every_move_is_safe_at_every_place(name: str) -> None:
    machine = load_machine(name)
    high = 0.5 * machine.kinematics.print_height_mm
    for move in library(machine):
        for place in [*positions(machine), (0.0, 0.0, high)]:
            gcode = experiment._text(machine, move, place)
            check(machine, Proposal(move.kind, place, 1.0, (), 0.0, "", gcode))


def test_the_moves_differ_and_last_seconds(plant: PrinterProblem) -> None:
    kinds = library(plant.machine)
    recordings = [
        experiment._blank_recording(plant.machine, move, (0.0, 0.0, 30.0), ("acc_A",), 1600.0) for move in kinds
    ]
    assert len({move.kind for move in kinds}) == len(kinds) == 6
    for recording in recordings:
        assert 1.0 < recording.time_s[-1] < 5.0
        rest = round(experiment.BEFORE_S * 1600) - 2
        assert np.ptp(recording.command[:rest], axis=0).max() < 1e-9  # at rest before and after
        assert np.ptp(recording.command[-round(experiment.AFTER_S * 1600) :], axis=0).max() < 1e-9


def test_a_rival_is_told_apart_by_moves_that_really_differ(plant: PrinterProblem) -> None:
    found = diagnosed(plant, LATE, DAMPED)
    first, *others = propose(plant, found, 3)
    assert first.competing == ("guide_damping",)
    assert "tell command_delay from guide_damping with" in first.text
    assert first.text.lower().startswith(f"{first.kind} at (")
    assert {p.competing for p in others} == {("guide_damping",)}
    assert len({p.kind for p in (first, *others)}) == 3  # then other kinds of moves
    check(plant.machine, first)

    # the promise: played once on both printers, the whitened difference is so many standard deviations
    move = next(m for m in library(plant.machine) if m.kind == first.kind)
    recording = experiment._blank_recording(
        plant.machine, move, first.position_mm, plant.observations[0].signals, 1600.0
    )
    virtual = PrinterProblem(plant.machine, [recording], ())
    late, damped = (virtual.simulate(values)[0] for _, values in (LATE, DAMPED))
    apart = np.linalg.norm(whitener(virtual.observations, found.noise, virtual.band_hz)([late - damped]))
    assert first.sigmas_per_second * np.sqrt(first.seconds) == pytest.approx(apart, rel=0.02)
    assert recording.time_s[-1] == pytest.approx(first.seconds)


def test_no_other_place_or_kind_at_the_centre_is_better(plant: PrinterProblem) -> None:
    first = propose(plant, diagnosed(plant, LATE, DAMPED), 1)[0]
    question = experiment._questions(plant, diagnosed(plant, LATE, DAMPED))[0]
    kinds = experiment._trials(
        plant, diagnosed(plant, LATE, DAMPED), question, [(m, (0.0, 0.0, 30.0)) for m in library(plant.machine)]
    )
    assert first.sigmas_per_second >= max(p.rate for p in kinds)
    assert first.kind == max(kinds, key=lambda p: p.rate).move.kind


def test_unknown_asks_between_the_two_nearest(plant: PrinterProblem) -> None:
    found = diagnosed(plant, LATE, DAMPED, BOTH, named=False)
    assert [p.competing for p in propose(plant, found, 2)] == [("guide_damping",), ("command_delay", "guide_damping")]
    assert "show whether guide_damping acts as well" in propose(plant, found, 2)[1].text


def test_none_asks_for_what_could_not_be_seen(machine: Machine) -> None:
    noisy = PrinterProblem(machine, recorded(machine, LOUD), NAMES)
    found = diagnosed(noisy)
    assert found.invisible == ["belt_position_stiffness"]  # of one short, gentle run in so much noise
    (shown,) = propose(noisy, found, 1)
    assert shown.competing == ("belt_position_stiffness",)
    assert "would show belt_position_stiffness of a usual size with" in shown.text
    assert shown.sigmas_per_second * np.sqrt(shown.seconds) > 3.0


def test_twins_are_said_to_be_twins(plant: PrinterProblem) -> None:
    """Where nothing differs, no number of standard deviations is promised."""
    twin = (("guide_damping",), {DELAY: 1e-3})
    proposals = propose(plant, diagnosed(plant, LATE, twin))
    assert [p.sigmas_per_second for p in proposals] == [0.0]
    assert proposals[0].text.startswith("None of the safe moves would tell command_delay from guide_damping")
    assert proposals[0].text.endswith("Several speeds and frequencies: damping lowers the resonance, a delay does not.")
