"""What to record next: recordings are safe, separate as promised, and answer the question that is open."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from ffcomp.diagnosis import next_experiment as experiment
from ffcomp.diagnosis.diagnosis import Diagnosis
from ffcomp.diagnosis.fit import EstimationProblem, Fit, derivatives, estimation_problem, values_at
from ffcomp.diagnosis.hypotheses import Hypothesis
from ffcomp.diagnosis.next_experiment import blank_recording, separations
from ffcomp.diagnosis.noise import noise_floor, whitener
from ffcomp.diagnosis.printer_problem import PrinterProblem
from ffcomp.diagnosis.problem import Parameter
from ffcomp.diagnosis.score_test import screen
from ffcomp.firmware.program import plan_program
from ffcomp.measurement.recording import Recording
from gcode.reader import read_program
from models.arrays import FloatArray
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

    def nozzle(t: FloatArray) -> FloatArray:
        window = np.clip(np.minimum(t, 0.9 - t) / 0.2, 0, 1)
        return np.column_stack([window * 2 * np.sin(60 * t), window * np.sin(90 * t), 30 + 0 * t])

    blank = blank_recording(machine, "x-1.csv", nozzle, 0.9, [f"acc_{a}" for a in "ABCxyz"], 1600.0)
    true = PrinterProblem(machine, [blank], ()).simulate({})[0]
    n = len(true)
    blank = replace(blank, time_s=blank.time_s[:n], command=blank.command[:n], gaps=blank.gaps[:n])
    hiss = noise * np.random.default_rng(0).standard_normal((2, *true.shape))
    return [
        replace(blank, source=f"x-{i}.csv", acceleration=dict(zip(blank.acceleration, (true + n).T, strict=True)))
        for i, n in enumerate(hiss, 1)
    ]


@pytest.fixture(scope="module")
def plant(machine: Machine) -> PrinterProblem:
    return PrinterProblem(machine, recorded(machine, QUIET), NAMES)


def fitted(estimation: EstimationProblem, values: dict[str, float]) -> Fit:
    """A fit of the machine's numbers and some more, at the file's values and at these."""
    own = (Parameter(name, x, abs(x)) for name, x in values.items())
    parameters, residual = (*estimation.problem.parameters, *own), estimation.residual(values)
    z = np.zeros(len(parameters))
    return Fit(parameters, z, residual, derivatives(estimation, parameters, z, residual, range(len(z))))


Explained = tuple[Sequence[str], dict[str, float]]
LATE: Explained = (("command_delay",), {DELAY: 1e-3})
DAMPED: Explained = (("guide_damping",), {DAMPING: 12.0})
SLIGHT: Sequence[Explained] = ((LATE[0], {DELAY: 1e-5}), (DAMPED[0], {DAMPING: 0.12}))


def diagnosed(plant: PrinterProblem, *hypotheses: Explained) -> Diagnosis:
    """A diagnosis with these hypotheses, the first the best; `none` without any."""
    noise = noise_floor(plant)
    estimation = estimation_problem(plant, whitener(plant.observations, noise, plant.band_hz))
    base = fitted(estimation, {})
    kinds = {c.name: c for c in PrinterProblem(plant.machine, plant.recordings).candidates}
    tried = [Hypothesis(tuple(kinds[n] for n in names), fitted(estimation, values)) for names, values in hypotheses]
    best = tried[0] if tried else None
    return Diagnosis(
        verdict="unknown" if best else "none",
        finding="",
        estimation=estimation,
        noise=noise,
        base=base,
        final=best.fit if best else base,
        screened=() if best else screen(estimation, base, plant.candidates),
        best=best,
        tried=tried,
    )


def check(machine: Machine, gcode: str) -> None:
    """The G-code stays inside the machine's volume and speed; a multisine raises the limit of acceleration."""
    trajectory, limits = plan_program(read_program(gcode.encode(), "next.gcode"), machine).trajectory, machine.limits
    t = np.linspace(float(trajectory.start_t[0]), trajectory.end_t, 4000)
    nozzle = trajectory.position(t)[:, :3]
    assert np.hypot(*nozzle[:, :2].T).max() < machine.kinematics.print_radius_mm
    assert nozzle[:, 2].min() > 5.0 and nozzle[:, 2].max() < machine.kinematics.print_height_mm
    assert np.linalg.norm(trajectory.velocity(t)[:, :3], axis=1).max() <= limits.velocity_mm_per_s * (1 + 1e-9)


def test_the_recording_separates_as_promised(plant: PrinterProblem, monkeypatch: pytest.MonkeyPatch) -> None:
    kept = []
    tried = experiment._trials
    monkeypatch.setattr(experiment, "_trials", lambda *given: kept.extend(tried(*given)) or kept)
    (one,) = separations(plant, diagnosed(plant, *SLIGHT), nearest=True)
    assert one.ours == ("command_delay",) and one.other == ("guide_damping",)
    assert one.there == max(trial.differences[0] for trial in kept)  # no kind or place that was tried is better
    assert len({trial.plan.experiments[0].kind for trial in kept}) == 4 and len(kept) > 6
    check(plant.machine, one.gcode)

    # retuned as that recording and the given runs allow, the predictions differ by what was promised
    best = next(trial for trial in kept if trial.differences[0] == one.there).plan.experiments[0]
    found = diagnosed(plant, *SLIGHT)
    assert found.best is not None
    fit, virtual = found.best.fit, experiment._virtual(plant, found, best)
    late, damped = (virtual.residual(values) for values in (fit.values, found.tried[1].fit.values))
    columns = derivatives(virtual, fit.parameters, fit.z, late, range(len(fit.z)))
    information = fit.information / fit.overdispersion
    step = np.linalg.solve(information + columns.T @ columns, columns.T @ (late - damped))
    apart = virtual.residual(values_at(fit.parameters, fit.z + step)) - damped
    cost = float(apart @ apart + step @ information @ step)
    assert np.sqrt(cost / len(apart)) == pytest.approx(one.there, rel=0.1)
    assert one.there < 0.1 * np.sqrt(np.mean((late - damped) ** 2))


def test_none_asks_for_what_could_not_be_seen(machine: Machine) -> None:
    noisy = PrinterProblem(machine, recorded(machine, LOUD), NAMES)
    found = diagnosed(noisy)
    assert found.invisible == ["belt_position_stiffness"]  # of one short, gentle run in so much noise
    (shown,) = separations(noisy, found, nearest=True)
    assert (shown.ours, shown.other) == ((), ("belt_position_stiffness",))
    assert "show belt_position_stiffness of a usual size" in shown.sentence
