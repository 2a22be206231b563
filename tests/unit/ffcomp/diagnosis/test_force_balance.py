"""A free axis whose drive holds what is missing: forces are compared, for its motion tells next to nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffcomp.diagnosis.axis_problem import AxisProblem
from ffcomp.diagnosis.diagnosis import diagnose
from ffcomp.diagnosis.noise import noise_floor, noise_of_sensors, stationary_noise, whitener
from ffcomp.diagnosis.problem import Observation, Problem
from ffcomp.diagnosis.problems import problem_of
from ffcomp.diagnosis.result import DiagnosisResult
from ffcomp.diagnosis.sentences import summary_sentences
from ffcomp.diagnosis.verb import measure_gap
from ffcomp.measurement.axis_run import AxisRun
from models.arrays import FloatArray
from models.effects.catalogue import with_effects
from models.kinds import driven_axis, machine_of_axis
from models.machine import Machine
from models.printer.one_axis import simulate_axis, simulate_load
from models.vibration.driven_axis import Drive, DrivenAxis

INERTIA, DAMPING = 0.0035, 0.01
MOTOR = machine_of_axis(
    "motor",
    DrivenAxis("current", INERTIA, 0.0, DAMPING, unit="rad"),
    uncertainty={"axis.mass_kg": 0.3, "axis.damping_n_s_per_m": 1.0},
)
LINES = ((7, 0.8, 0.0), (28, 0.0, 0.5), (12, 0.3, 0.2))
NAMES = ("cogging_force", "guide_damping", "bristle_friction")


def turned(seed: int, machine: Machine = MOTOR, missing: bool = True, encoder_mm: float = 1e-3) -> AxisProblem:
    """A rotor that is turned slowly by a controller that leaves nothing of its cogging in the motion."""
    rng, t = np.random.default_rng(seed), np.arange(2400) / 400.0
    runs = []
    for k, speed in enumerate((0.5, -0.6)):
        q, v, a = _motion(t, speed, k)
        force = INERTIA * a + DAMPING * v + 5e-3 * rng.normal(size=len(t))
        if missing:
            force += sum(s * np.sin(n * q) + c * np.cos(n * q) for n, s, c in LINES)
        place = 1e3 * q + encoder_mm * rng.normal(size=len(t))
        runs.append(AxisRun(f"run{'ab'[k]}.csv", t, force, "current", {}, {"pos_q": place}))
    return AxisProblem(machine, runs, NAMES)


def _motion(t: FloatArray, speed: float, k: int = 0) -> tuple[FloatArray, FloatArray, FloatArray]:
    wave = 0.05 * np.sin((3 + k) * t)
    return speed * t + wave, speed + 0.05 * (3 + k) * np.cos((3 + k) * t), -((3 + k) ** 2) * wave


def test_cogging_is_named_from_the_forces_where_the_motion_hardly_shows_it() -> None:
    problem = turned(1)
    found = diagnose(problem)
    told = DiagnosisResult(search=found)
    left = measure_gap(problem.machine_with(found.final.values), [one.run for one in problem.shots])
    assert left.residual.total.nrms == pytest.approx(told.gap.after, rel=0.05)
    assert left.compared == told.compared == "forces" and told.named == ("cogging_force",)
    table = told.effects["cogging_force"]
    sizes = {
        round(2e3 * np.pi / p): float(np.hypot(s, c))
        for p, s, c in zip(table["pitch_mm"], table["sine_n"], table["cosine_n"], strict=True)
    }
    assert sizes == pytest.approx({n: float(np.hypot(s, c)) for n, s, c in LINES}, rel=0.03)
    assert told.gap.before > 0.9 and told.gap.after < 0.1  # of the force, which is an absolute measure
    said = summary_sentences(told)
    assert "of the drive's forces" in said[0] and any("measured motion needs" in sentence for sentence in said)


def test_the_force_that_a_motion_needs_is_the_models_at_the_measured_states() -> None:
    """Whatever the drive's force is: it bends no bristle, and stops no motion. Ends of a smoothed speed are rough."""
    rubbing = with_effects(MOTOR, {"bristle_friction": {"force_n": 0.3, "presliding_mm": 2.0}})
    quiet = turned(2, rubbing, missing=False)
    measured = [one.run for one in quiet.shots]
    pushed = [replace(run, drive=run.drive + 5.0) for run in measured]
    both = [AxisProblem(rubbing, runs, NAMES).compared() for runs in (measured, pushed)]
    needed, same = (np.concatenate(each.simulate({}))[:, 0] for each in both)
    np.testing.assert_allclose(needed, same, atol=1e-6)
    _, v, a = _motion(np.arange(60, 2300) / 400.0, 0.5)
    np.testing.assert_allclose(needed[60:2300], INERTIA * a + DAMPING * v + 0.3, atol=0.01)


def test_stationary_noise_has_a_colour_but_no_line_and_nothing_that_comes_and_goes() -> None:
    rng, rate, rows = np.random.default_rng(4), 400.0, 256
    f, t = np.fft.rfftfreq(rows, 1 / rate), np.arange(rows) / rate
    errors, white = [], 2 / rate
    for k in range(36):
        hum = np.fft.irfft(np.fft.rfft(rng.normal(size=rows)) * ((f > 40) & (f < 90)), rows)
        line, effect = 3.0 * np.sin(300 * np.pi * t + k), 10.0 * (k % 3 > 0) * np.cos(30 * np.pi * t)
        errors.append((rng.normal(size=rows) + 3.0 * hum + line + effect)[:, None])
    windows = [Observation(f"{k}", f"{k}", (1.0 * k,), rate, ("force",), e, e) for k, e in enumerate(errors)]
    found = stationary_noise(noise_of_sensors(windows, {"force": white}), windows, errors)
    for hertz, density in ((15.0, white), (65.0, 10 * white), (110.0, white), (150.0, white)):
        assert found.at("force", np.array([hertz])) == pytest.approx(density, rel=0.4)


def test_the_noise_of_an_encoder_counts_by_the_force_that_it_makes() -> None:
    """The residual of the true machine is white, of variance one, although m s² makes its noise rise with frequency."""
    problem = turned(6, missing=False, encoder_mm=0.2).compared()
    floor = noise_floor(problem)
    whiten = whitener(problem.observations, floor, (5.0, 60.0))
    truth = whiten([o.measured - y for o, y in zip(problem.observations, problem.simulate({}), strict=True)])
    loud = whiten.frequencies() > 30.0
    for rows in (loud, ~loud):
        assert float(np.mean(truth[rows] ** 2)) == pytest.approx(1.0, abs=0.3)


def test_bristles_bend_along_a_measured_motion_in_closed_form() -> None:
    """From rest on at a steady speed v they hold F (1 − exp(−v t/z₀)), however coarse the samples are."""
    rubbing = with_effects(MOTOR, {"bristle_friction": {"force_n": 0.3, "presliding_mm": 20.0}})
    t = np.arange(400) / 200.0
    place = 0.05 * t
    runs = [AxisRun("a.csv", t, DAMPING * 0.05 + 0.0 * t, "current", {}, {"pos_q": 1e3 * place})]
    balance = AxisProblem(rubbing, runs, NAMES).compared()
    needed = np.concatenate(balance.simulate({}))[:380, 0]
    expected = DAMPING * 0.05 + 0.3 * (1 - np.exp(-place[:380] / 0.02))
    np.testing.assert_allclose(needed[10:], expected[10:], atol=1e-6)


def test_a_weight_is_named_although_it_hardly_changes_within_a_window() -> None:
    """A slow arm lifts its weight: the mean force of each window shows it, beside friction that turns over at once."""
    rng, t, runs = np.random.default_rng(5), np.arange(4000) / 400.0, []
    for k, hertz in enumerate((0.11, 0.14)):
        w = 2 * np.pi * hertz
        q, v, a = np.sin(w * t + k), w * np.cos(w * t + k), -(w**2) * np.sin(w * t + k)
        friction = 0.3 * np.tanh(v / 0.01) * (1 + 0.1 * np.sin(5 * q))
        force = INERTIA * a + DAMPING * v + friction + 0.8 * np.sin(q) + 5e-3 * rng.normal(size=len(t))
        place = 1e3 * q + 0.05 * rng.normal(size=len(t))
        runs.append(AxisRun(f"run{'ab'[k]}.csv", t, force, "current", {}, {"pos_q": place}))
    found = diagnose(AxisProblem(MOTOR, runs, ("pendulum_gravity", "coulomb_friction", "guide_damping")))
    told = DiagnosisResult(search=found)
    assert set(told.named) == {"pendulum_gravity", "coulomb_friction"}
    assert told.effects["pendulum_gravity"]["force_n"] == pytest.approx(0.8, rel=0.03)
    assert told.effects["coulomb_friction"]["force_n"] == pytest.approx(0.3, rel=0.1)
    # a file that has the weight, and knows it to a tenth, has it retuned
    known = replace(MOTOR, uncertainty={**MOTOR.uncertainty, "effects.pendulum_gravity.force_n": 0.1})
    filed = AxisProblem(with_effects(known, {"pendulum_gravity": {"force_n": 0.72}}), runs, ("coulomb_friction",))
    told = DiagnosisResult(search=diagnose(filed))
    assert set(told.named) == {"coulomb_friction"}
    assert told.retuned["effects.pendulum_gravity.current_a"].fitted == pytest.approx(0.8, rel=0.03)


def test_friction_by_load_is_solved_for_the_force_and_explains_no_force_by_itself() -> None:
    """Closed form: driving forwards takes 1/(1 - μ) of the rest, holding back 1/(1 + μ), whatever was measured."""
    quiet = turned(2, missing=False)
    _, v, a = _motion(np.arange(60, 2300) / 400.0, 0.5)
    rest = INERTIA * a + DAMPING * v
    recorded = [one.run for one in quiet.shots]
    volts = machine_of_axis("motor", DrivenAxis("voltage", INERTIA, 0.0, DAMPING, unit="rad"))
    for machine, share, drive in ((MOTOR, 0.3, 1.0), (MOTOR, 0.3, 40.0), (MOTOR, 0.97, 1.0), (volts, 0.3, 1.0)):
        given = driven_axis(machine).input
        runs = [replace(run, drive=drive * run.drive, command_space=given) for run in recorded]
        balance = AxisProblem(with_effects(machine, {"friction_by_load": {"share": share}}), runs, NAMES).compared()
        needed = np.concatenate(balance.simulate({}))[60:2300, 0]
        emf = DAMPING * v if machine is volts else 0.0 * v  # of a voltage, this part does not load the gear
        forwards = np.where(rest > emf, 1 - share, 1 + share)
        np.testing.assert_allclose((needed - emf) * forwards, rest - emf, atol=0.01)


JOINT = DrivenAxis("force", 0.02, 0.0, 0.02, 0.012, 120.0, 0.05, unit="rad")
KNOWN = {"axis.mass_kg": 0.3, "axis.load_mass_kg": 0.05, "axis.coupling_stiffness_n_per_m": 0.05}


def swung(hidden: dict[str, dict[str, float]], softer: float, seed: int = 3) -> Problem:
    """A joint that feedback moves, with encoders on motor and load; its file has neither friction nor this coupling."""
    rng, t = np.random.default_rng(seed), np.arange(2400) / 500.0
    truth = replace(JOINT, coupling_stiffness_n_per_m=softer * 120.0)
    machine = with_effects(machine_of_axis("joint", truth), hidden)
    runs = []
    for name, hertz in (("a", (0.7, 6.1)), ("b", (0.5, 8.3))):
        force = sum(0.12 * np.sin(2 * np.pi * f * t + k) for k, f in enumerate(hertz))
        motion = simulate_axis(machine, np.asarray(force), t[1], substeps=8)
        places = {"pos_q": motion.position_mm, "pos_motor": motion.motor_mm}
        noisy = {s: x + 0.02 * rng.normal(size=len(t)) for s, x in places.items()}
        felt = np.asarray(force) + 0.002 * rng.normal(size=len(t))
        runs.append(AxisRun(f"run{name}.csv", t, felt, "force", {}, noisy))
    file = machine_of_axis("joint", JOINT, uncertainty={**KNOWN, "axis.damping_n_s_per_m": 1.0})
    return problem_of(file, runs, ("belt_stiffness", "stribeck_friction", "belt_backlash", "command_delay"))


def test_a_coupling_is_found_beside_a_friction_that_no_formula_has() -> None:
    """Simulated from the force, the error of the friction would hide that of the coupling; the friction is the rest."""
    rough = {"coulomb_friction": {"force_n": 0.05}, "cogging_force": {"sine_n": 0.005, "pitch_mm": 300.0}}
    found = diagnose(swung(rough, softer=0.65))
    assert found.dominant is not None and found.dominant.hypothesis.names == ("belt_stiffness",)
    assert found.dominant.signal == "pos_q"
    assert found.final.values["effects.belt_stiffness.relative_change"] == pytest.approx(-0.35, abs=0.03)


def test_a_load_that_a_measured_motor_takes_along_moves_as_it_does_in_the_whole_axis() -> None:
    t = np.arange(1000) / 500.0
    machine = with_effects(machine_of_axis("joint", JOINT), {"belt_backlash": {"width_mm": 0.5}})
    whole = simulate_axis(machine, 0.3 * np.sin(9 * t), t[1], substeps=20)
    load = simulate_load(machine, whole.motor_mm, t[1], 0, np.zeros((1, 4)))
    twist = np.ptp(whole.position_mm - whole.motor_mm)
    assert np.abs(load.position_mm - whole.position_mm).max() < 2e-3 * twist


def test_a_drive_that_acts_late_is_no_missing_effect() -> None:
    """Half a sample, as of a controller that holds its force; the file that is written keeps it."""
    late = replace(MOTOR.vibration, drive=Drive(delay_s=0.5 / 400.0))
    assert isinstance(late, DrivenAxis)
    rng, t = np.random.default_rng(5), np.arange(3200) / 400.0
    force = 0.02 * np.sin(2 * np.pi * 3.1 * t) + 0.02 * np.sin(2 * np.pi * 11.3 * t)
    place = simulate_axis(replace(MOTOR, vibration=late), force, t[1], substeps=8).position_mm
    run = AxisRun("run.csv", t, force, "current", {}, {"pos_q": place + 1e-3 * rng.normal(size=len(t))})
    found = diagnose(AxisProblem(MOTOR, [run], ("command_delay", "coulomb_friction")))
    assert found.verdict == "none"
    assert found.final.values["axis.drive.delay_s"] == pytest.approx(0.5 / 400.0, rel=0.1)
