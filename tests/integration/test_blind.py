"""The generator of the blind test, and a handful of its cases through the public verb. The full bank: benchmarks."""

from __future__ import annotations

import copy
import json
import math
from collections.abc import Mapping
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ffcomp.cli.app import app
from ffcomp.cli.command import run
from ffcomp.diagnosis.gap import locate_residual
from ffcomp.diagnosis.noise import noise_floor, whitener
from ffcomp.diagnosis.problems import problem_of, recordings_of
from models.effects.catalogue import CATALOGUE, measured, with_effect
from models.file import load_machine, load_plant
from models.printer.printer import simulate_printer
from validation.blind import score
from validation.blind.cases import HIDES, Case, Circumstances, Label, Plan, case, draw
from validation.blind.delta import equations
from validation.blind.delta.equations import GRAVITY, STATES
from validation.blind.delta.hidden import EFFECTS
from validation.blind.delta.machines import draw_machine
from validation.blind.delta.numbers import FloatArray, Printer, carriages_of, printer_of
from validation.blind.delta.outside import OUTSIDE
from validation.blind.delta.real import played
from validation.blind.kinds import KINDS as MACHINES
from validation.blind.printer import shapes
from validation.blind.printer.motions import KINDS, Motion
from validation.blind.printer.real import Reading, Real, combined, read_at
from validation.blind.seal import SealedError, open_labels, verdict_path, write_case
from validation.blind.sensors import draw_sensors
from validation.blind.straight import forced, turning
from validation.blind.straight import machines as straight
from validation.blind.straight.forced_effects import OUTSIDE as FORCED_OUTSIDE
from validation.blind.straight.forced_effects import TURNING
from validation.blind.straight.hidden import damped_by_belts, effects_of
from validation.blind.straight.numbers import modes_of
from validation.blind.straight.outside import OUTSIDE as STRAIGHT_OUTSIDE
from validation.blind.strata import CONDITIONS, full_bank
from validation.blind.tables import toml_of
from validation.blind.visible import (
    Visibility,
    samples,
    visibility,
    visibility_by_other_clocks,
    visibility_by_refit,
    whitened,
)

SECONDS = 0.8


def motion(kind: str = "multisine", loudness: float = 1.0) -> Motion:
    rng = np.random.default_rng(3)
    return Motion(kind, KINDS[kind](rng, (20.0, -15.0, 40.0), SECONDS, loudness), SECONDS)


def printer(seed: int = 11, force_map: str = "virtual_work") -> Real:
    machine = draw_machine(np.random.default_rng(seed))
    machine["effector"]["force_map"] = force_map
    return Real(machine)


def hidden(name: str, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    return {**EFFECTS, **OUTSIDE}[name](np.random.default_rng(5), size, real)


def accelerations(reading: Reading) -> FloatArray:
    return np.hstack([reading.carriage, reading.nozzle])


@cache
def unchanged(force_map: str, kind: str, loudness: float) -> FloatArray:
    """What the printer does without anything hidden."""
    real = printer(force_map=force_map)
    return accelerations(played(real, real.machine["kinematics"], motion(kind, loudness)))


# ---- the generator -------------------------------------------------------------------------------


def test_every_effect_of_the_catalogue_is_in_the_bank() -> None:
    assert set(EFFECTS) == {name for name, effect in CATALOGUE.items() if "carriages" in effect.of}
    places = {"gantry_racking", "toolhead_mode", "growing_bed", "belt_damping"}
    for kind in ("cartesian", "corexy"):
        assert set(effects_of(kind)) - places <= set(EFFECTS)
    assert places <= {*effects_of("cartesian"), *effects_of("corexy")}
    of_axes = {*MACHINES["axis"].effects, *MACHINES["axis-by-force"].effects, *MACHINES["turning"].effects}
    assert of_axes == {name for name, effect in CATALOGUE.items() if "axis" in effect.of} - {"sensor_gain"}
    for outside, count in ((OUTSIDE, 13), (STRAIGHT_OUTSIDE, 14)):
        assert len(outside) == count
        assert not set(outside) & set(CATALOGUE)


@pytest.mark.parametrize("name", [*EFFECTS, *OUTSIDE])
def test_size_zero_is_nothing_hidden(name: str) -> None:
    real = printer(force_map="paper" if name == "center_of_mass" else "virtual_work")
    kind = "infill" if name == "slow_driver" else "multisine"
    plain = unchanged(real.machine["effector"]["force_map"], kind, 1.0)
    none, some = (
        accelerations(played(hidden(name, size, real)[1], real.machine["kinematics"], motion(kind)))
        for size in (0.0, 1.0)
    )
    np.testing.assert_allclose(none, plain, atol=1e-9)
    assert np.sqrt(np.mean((some - plain) ** 2)) > 1e-3


@pytest.mark.parametrize("name", EFFECTS)
def test_labels_are_in_the_machine_files_terms(name: str, tmp_path: Path) -> None:
    """The tool's own simulation with the label's numbers does most of what the hidden effect does, in sign and size."""
    real = printer(force_map="paper" if name == "center_of_mass" else "virtual_work")
    firmware, told = real.machine["kinematics"], motion("multisine", 1.5)
    table, changed = hidden(name, 1.0, real)
    file = tmp_path / "machine.toml"
    file.write_text(toml_of(real.machine, "true"), encoding="utf-8")
    machine = load_machine(file)
    rate = 3200
    path = told.path(np.arange(round(rate * SECONDS) + 1) / rate)
    command = carriages_of(firmware, path)

    def tool(with_it: bool) -> FloatArray:
        owned = with_effect(machine, name, **table) if with_it else machine
        signals = measured(owned, simulate_printer(owned, command, 1 / rate).signals)
        return np.hstack([signals.carriage, signals.nozzle])

    plain = unchanged(real.machine["effector"]["force_map"], "multisine", 1.5)
    ours = [plain[::2], accelerations(played(changed, firmware, told))[::2]]
    theirs = [tool(False), tool(True)]
    np.testing.assert_allclose(_slow(ours[0]), _slow(theirs[0]), atol=2e-3 * np.abs(ours[0]).max())
    difference, wanted = _slow(theirs[1] - theirs[0]), _slow(ours[1] - ours[0])
    both, size = np.sum(difference * wanted), np.linalg.norm(wanted)
    assert both > 0.8 * np.linalg.norm(difference) * size
    assert 0.7 < both / size**2 < 1.4


@pytest.mark.parametrize(
    ("kind", "name"),
    [(kind, name) for kind in ("cartesian", "corexy") for name in effects_of(kind) if name != "toolhead_mode"],
)
def test_labels_of_straight_axes_are_in_the_files_terms(kind: str, name: str, tmp_path: Path) -> None:
    real = Real(straight.draw_machine(np.random.default_rng(12), kind, (name,)))
    real.machine["masses"] = True
    table, changed = effects_of(kind)[name](np.random.default_rng(5), 1.0, real)
    moves = KINDS["multisine"](np.random.default_rng(3), (90.0, 100.0, 30.0), SECONDS, 0.5)
    told = Motion("told", lambda t: moves(t) * [1.0, 1.0, 0.0] + [0.0, 0.0, 30.0], SECONDS)
    file = tmp_path / "machine.toml"
    file.write_text(toml_of(straight.file_of(real.machine, 0.0, np.random.default_rng(1)), "true"), encoding="utf-8")
    machine, rate = load_machine(file), 3200
    command = machine.kinematics.inverse(told.path(np.arange(round(rate * SECONDS) + 1) / rate))

    def tool(with_it: bool) -> FloatArray:
        owned = with_effect(machine, name, **table) if with_it else machine
        return np.asarray(measured(owned, simulate_printer(owned, command, 1 / rate).signals).nozzle[:, :2])

    firmware = real.machine["kinematics"]
    ours = [straight.played(r, firmware, told).nozzle[::2, :2] for r in (real, changed)]
    theirs = [tool(False), tool(True)]
    np.testing.assert_allclose(_slow(ours[0]), _slow(theirs[0]), atol=4e-3 * np.abs(ours[0]).max())
    difference, wanted = _slow(theirs[1] - theirs[0]), _slow(ours[1] - ours[0])
    both, size = np.sum(difference * wanted), np.linalg.norm(wanted)
    assert both > 0.75 * np.linalg.norm(difference) * size
    assert 0.6 < both / size**2 < 1.5


@pytest.mark.parametrize(
    ("stratum", "of_file", "of_printer"),
    [
        ("delta/single/rough-file:belt_stiffness", ("carriage", "belt_stiffness_n_per_m"), None),
        ("delta/single/rough-file:extruder_mount", ("effector", "extruder_damping_n_s_per_m"), None),
        ("axis/single/rough-file:belt_stiffness", ("axis", "coupling_stiffness_n_per_m"), ("plant", "mount_k")),
        ("axis-by-force/single:belt_stiffness", ("axis", "coupling_stiffness_n_per_m"), ("plant", "belt_k")),
    ],
)
def test_a_change_counts_from_what_the_file_says(
    stratum: str, of_file: tuple[str, str], of_printer: tuple[str, str] | None
) -> None:
    """The file's number, which is off, with the label's change is the printer's."""
    plan = draw(8, stratum, 1.0)
    ((told, *more),) = (list(table.values()) for table in plan.label.effects.values())
    change = np.array(more[0] if more else told)
    said, true = np.array(plan.file[of_file[0]][of_file[1]]), plan.real.machine
    really = np.array(true[of_file[0]][of_file[1]] if of_printer is None else true[of_printer[0]][of_printer[1]][0])
    changed = np.broadcast_to(change != 0, np.shape(said * (1 + change)))
    np.testing.assert_allclose((said * (1 + change))[changed], np.broadcast_to(really, changed.shape)[changed])
    assert np.abs(said / really - 1).max() > 0.001


@pytest.mark.parametrize("name", STRAIGHT_OUTSIDE)
def test_what_straight_axes_hide_outside_has_a_size(name: str) -> None:
    real = Real(straight.draw_machine(np.random.default_rng(12), "corexy"))
    motions = KINDS["infill"](np.random.default_rng(3), (90.0, 100.0, 30.0), SECONDS, 2.0)
    plain, none, some = (
        straight.played(r, real.machine["kinematics"], Motion("told", motions, SECONDS)).nozzle
        for r in (real, *(STRAIGHT_OUTSIDE[name](np.random.default_rng(5), size, real)[1] for size in (0.0, 1.0)))
    )
    np.testing.assert_allclose(none, plain, atol=1e-9)
    assert np.sqrt(np.mean((some - plain) ** 2)) > 1e-2


def test_a_toolhead_rings_faster_off_the_middle_of_its_beam() -> None:
    """The beam is in series with the belts of y; no number of the machine file is compared with that."""
    real = Real(straight.draw_machine(np.random.default_rng(12), "corexy", ("toolhead_mode",)))
    assert real.machine["plant"]["tool"][1] == 0
    table, changed = effects_of("corexy")["toolhead_mode"](np.random.default_rng(5), 1.0, real)
    assert table == {}
    middle = 1e3 * changed.fields["beam_at"]
    moves = KINDS["multisine"](np.random.default_rng(3), (0.0, 100.0, 30.0), SECONDS, 0.5)

    def differs(x: float) -> float:
        told = Motion("told", lambda t: moves(t) * [0.0, 1.0, 0.0] + [x, 0.0, 30.0], SECONDS)
        plain, soft = (straight.played(r, real.machine["kinematics"], told).nozzle[:, 1] for r in (real, changed))
        return float(np.linalg.norm(soft - plain) / np.linalg.norm(plain))

    assert differs(middle) < 1e-6
    assert differs(middle + 60) > differs(middle + 30) > 0.01


def _slow(values: FloatArray) -> FloatArray:
    """Below 200 Hz, 3200 samples a second."""
    spectrum = np.fft.rfft(values, axis=0)
    spectrum[np.fft.rfftfreq(len(values), 1 / 3200) > 200] = 0
    return np.fft.irfft(spectrum, len(values), axis=0)


@pytest.mark.parametrize("stratum", [f"{machine}:none" for machine in MACHINES])
def test_nothing_hidden_leaves_only_the_noise(stratum: str, tmp_path: Path) -> None:
    """Every kind of motion through files, against the tool's own simulation of the same machine."""
    made = case(21, stratum, SECONDS)
    assert made.label.effects == {} and made.label.visible
    true = exact(draw(21, stratum, SECONDS))
    folder = written(replace(made, machine=true), tmp_path)
    machine = load_plant(folder / "machine.toml")
    plant = problem_of(machine, recordings_of(machine, sorted((folder / "runs").iterdir())), ())
    simulated = plant.simulate({})
    floor = noise_floor(plant, simulated)
    found = locate_residual(whitener(plant.observations, floor, plant.band_hz), floor, simulated)
    forced = stratum in ("axis-by-force:none", "turning:none")  # their noise is guessed from the encoder's counts
    assert found.total.nrms < (1.5 if forced else 1.1) * found.total.noise_nrms
    most = 1.5 if forced or stratum == "axis:none" else 1.2  # an axis' shots begin where the noisy encoder says
    assert all(size.nrms < most * size.noise_nrms for size in found.signals.values())


def exact(plan: Plan) -> str:
    """The machine file without an error."""
    return toml_of(plan.kind.file_of(plan.real.machine, 0.0, np.random.default_rng(1)), "true")


def written(made: Case, bank: Path, name: str = "case-001") -> Path:
    write_case(bank, name, made)
    return bank / "cases" / name


def test_a_seed_is_a_case() -> None:
    one, same, other = (case(seed, "single", SECONDS, short=True) for seed in (4, 4, 5))
    assert (one.machine, one.runs, one.fresh, one.label) == (same.machine, same.runs, same.fresh, same.label)
    assert one.machine != other.machine


def test_what_is_hidden_changes_nothing_else() -> None:
    """Same file, same motions, same sensors: the runs differ by the effect alone."""
    a, b = (case(6, f"single:{name}", SECONDS, short=True) for name in ("cogging", "joint_friction"))
    assert a.machine == b.machine and a.runs.keys() == b.runs.keys() and a.runs != b.runs
    commands = [[line.split(",")[:4] for line in c.runs["multisine-left.csv"].splitlines()] for c in (a, b)]
    assert commands[0] == commands[1]


@pytest.mark.parametrize("kind", KINDS)
def test_motions_begin_and_end_at_rest(kind: str) -> None:
    path = motion(kind).path(np.linspace(0, SECONDS, 8001))
    assert np.ptp(path[:200], axis=0).max() == np.ptp(path[-200:], axis=0).max() == 0
    assert np.ptp(path, axis=0).max() > 0.3
    acceleration = np.diff(path, 2, axis=0) / (SECONDS / 8000) ** 2 / 1e3
    assert np.abs(acceleration).max() < 60  # m/s², and no jump of speed


def test_energy_is_kept_without_dampers() -> None:
    """Frame, cable, hardening belts and all, let go from a stretched position."""
    machine = draw_machine(np.random.default_rng(2))
    machine["carriage"].pop("drive", None)
    machine["carriage"] |= {"belt_damping_n_s_per_m": 0.0, "guide_damping_n_s_per_m": 0.0}
    machine["effector"]["extruder_damping_n_s_per_m"] = [0.0] * 3
    fields = {
        "sway_dir": np.eye(2),
        "sway_mass": [8.0, 8.0],
        "sway_k": [2e5, 3e5],
        "cable_mass": 0.1,
        "cable_k": 300.0,
        "cubic": [5e11] * 3,
        "rods": 0.012,
        "rotor": [2.0] * 3,
        "rotor_k": [4e5] * 3,
    }
    p = printer_of(machine, fields)
    xyz = np.array([[0.02, -0.03, 0.04]])
    command = carriages_of(machine["kinematics"], 1e3 * xyz)[0] / 1e3
    y = equations.rest(xyz[0], command, p)
    y[:3] += [2e-4, -1e-4, 3e-4]
    before = energy(y, command, p)
    rows = np.tile(command, (2 * 6400 + 1, 1))
    equations.run(rows, 0 * rows, 1 / 12800, 12800, y, p)
    at_rest = energy(equations.rest(xyz[0], command, p), command, p)
    assert abs(energy(y, command, p) - before) < 1e-5 * (before - at_rest)


def energy(y: FloatArray, command: FloatArray, p: Printer) -> float:
    """Kinetic and potential, J, written down from the bodies."""
    x, v, eta, sway = y[:3], y[3:6], y[6:9], np.append(y[equations.SWAYV : equations.SWAYV + 2] @ p.sway_dir, 0.0)
    s = np.sqrt(p.arms**2 - np.sum((x[:2] - p.towers) ** 2, axis=1))
    q, dq = x[2] + p.height + s, v[2] - (x[:2] - p.towers) @ v[:2] / s
    cable, swing = y[equations.CABLE : equations.CABLE + 2], y[equations.CABLEV : equations.CABLEV + 2]
    rotor, stretch = y[equations.ROTOR : equations.ROTOR + 3], y[equations.ROTOR : equations.ROTOR + 3] - q
    moving = p.carriage @ dq**2 + p.holder * np.sum((v + sway) ** 2)
    moving += p.extruder * np.sum((v + sway + y[9:12]) ** 2) + p.cable_mass * np.sum(((v + sway)[:2] + swing) ** 2)
    moving -= p.rods * (3 * v[:2] @ v[:2] + np.sum((v[2] - dq) ** 2))
    moving += p.rotor @ y[equations.ROTORV : equations.ROTORV + 3] ** 2
    moving += p.sway_mass @ y[equations.SWAYV : equations.SWAYV + 2] ** 2
    held = p.belt_k @ stretch**2 + p.cubic @ stretch**4 / 2 + p.mount_k @ eta**2 + p.cable_k * np.sum(cable**2)
    held += p.rotor_k @ (command - rotor) ** 2
    held += p.sway_k @ y[equations.SWAY : equations.SWAY + 2] ** 2
    weight = p.carriage @ q + p.holder * x[2] + p.extruder * (x[2] + eta[2])
    return float(moving / 2 + held / 2 + GRAVITY * weight)


@pytest.mark.parametrize("name", [*TURNING, *FORCED_OUTSIDE])
def test_what_an_axis_driven_by_a_force_hides_has_a_size(name: str) -> None:
    """The servo is there with and without it; of size zero it changes nothing."""
    real = Real(turning.draw_machine(np.random.default_rng(12), ("belt_backlash",)))
    strokes = KINDS["strokes"](np.random.default_rng(3), (0.0, 0.0, 0.0), SECONDS, 1.5)
    hide = {**TURNING, **FORCED_OUTSIDE}[name]
    axes = (real, *(hide(np.random.default_rng(5), size, real)[1] for size in (0.0, 1.0)))
    plain, none, some = (forced.played(axis, {}, Motion("told", strokes, SECONDS)) for axis in axes)
    np.testing.assert_array_equal(none.nozzle, plain.nozzle)
    assert np.ptp(plain.nozzle_mm[:, 0]) > 20.0 and np.abs(plain.nozzle_mm).max() < 80.0  # its servo holds it
    assert plain.force is not None and some.force is not None
    assert np.std(some.force - plain.force) > 1e-3 * np.std(plain.force)


def test_a_reading_by_coarse_steps_may_be_a_sample_longer() -> None:
    plan = draw(101174501, "nozzle/single/joined:arm_geometry", 1.5)
    fine, coarse = (plan.readings(plan.real, plan.motions[3:4], step) for step in (False, True))
    counts = samples(plan.sensors, fine)
    assert samples(plan.sensors, coarse) == [counts[0] + 1]
    told, roughly = (whitened(plan.sensors, given, (1,), counts) for given in (fine, coarse))
    assert np.sqrt(np.mean((told - roughly) ** 2)) < 0.1  # of the noise


def test_what_is_seen_of_an_axis_driven_by_a_force_is_under_the_same_force() -> None:
    """Begun anew where it was, the same axis goes where it went; one that lacks the friction goes elsewhere."""
    plan = draw(8, "axis-by-force:coulomb_friction", SECONDS, short=True)
    reading = plan.readings(plan.real, plan.motions)[1]
    own, again, without = (forced.replayed(r, reading).nozzle_mm[:, 0] for r in (None, plan.real, plan.plain))
    size = np.std(own - without)
    assert np.std(own - again) < 0.02 * size and size > 0.01 * np.std(own)
    told = forced.given(plan.real.machine, reading.t[::4], reading, np.random.default_rng(1))["force_n"]
    assert 0 < np.std(told - reading.force[::4]) < 3e-3 * np.std(told)


def test_rest_is_rest() -> None:
    """With weight, play, a stepper's sine and a soft bracket: nothing moves under a constant command."""
    real = printer().having(play=[1e-4] * 3, flank=1e-6, stepper=[2e-4] * 3, stepper_share=0.9)
    real = real.having(soft_tower=1, soft_mass=0.5, soft_k=1e5, soft_b=10.0)
    still = Motion("still", lambda t: np.tile([10.0, 20.0, 30.0], (len(t), 1)), 0.2)
    assert np.abs(accelerations(played(real, real.machine["kinematics"], still))).max() < 1e-6


def test_closed_forms_of_the_shapes() -> None:
    beyond, slope = shapes.soft_play(3e-4, 1e-4, 1e-6)
    assert (beyond, slope) == pytest.approx((2.5e-4, 1.0))
    assert shapes.soft_play(0.0, 1e-4, 1e-6)[0] == 0.0
    force = shapes.stepper_force(1e-4, 1e5, 2e-4, 0.9)
    rotor, belt = 0.9 * 2e-4 * math.asin(force / (1e5 * 2e-4)), 0.1 * force / 1e5
    assert rotor + belt == pytest.approx(1e-4, rel=1e-6)
    assert shapes.slid(0.3, 0.1, 0.1, 1e9, 1e-5) == 1.0
    assert shapes.slid(0.0, 0.1, 0.1, 1e-9, 1e-5) == pytest.approx(0.1 * 1e-9 / 1e-5, rel=1e-4)
    assert STATES == equations.ROTORV + 3


def test_friction_of_each_kind_bends_and_slides_as_its_law_says() -> None:
    """To and fro by less than what breaks it away: a spring comes back where it was, Dahl's bristle has crept."""
    fields = {"dry": [2.0] * 3, "bristle": 1e-5, "micro": 50.0, "breaks": 0.6}
    crept = {}
    for kind in (shapes.DAHL, shapes.LUGRE, shapes.BREAKS):
        p = printer().having(**fields, dry_kind=kind)
        numbers, z = printer_of(p.machine, {**p.fields, "guide_b": [0.0] * 3}), 0.0
        for speed in (1e-3, -1e-3):
            for _ in range(50):
                z = shapes.bent(z, speed, 1e-4, numbers)
            if speed > 0:
                out = z
        crept[kind] = z
        expected = 0.5 if kind == shapes.BREAKS else 1 - math.exp(-0.5)
        assert out == pytest.approx(expected, rel=1e-6)
        slides = shapes.bent(z, 0.1, 1.0, numbers)
        assert slides == pytest.approx(1.0, abs=1e-9)
        assert shapes.guide(0.1, 0.0, slides, 0, numbers) == pytest.approx(2.0)  # whatever the law
        begins = 2.0 * out + (50.0 * (1e-3 - 1e-3 * out) if kind == shapes.LUGRE else 0.0)
        assert shapes.guide(1e-3, 0.0, out, 0, numbers) == pytest.approx(begins)
    assert crept[shapes.BREAKS] == pytest.approx(0.0, abs=1e-12)
    assert crept[shapes.DAHL] == pytest.approx((2 - math.exp(-0.5)) * math.exp(-0.5) - 1)


def test_a_belt_that_leans_is_stiffer_pulled_than_pushed() -> None:
    k = 1e5
    p = printer_of(printer().machine, {"belt_k": [k] * 3, "belt_c": [0.0] * 3, "lean": [0.2] * 3})
    pulled, pushed = (shapes.belt(s, 0.0, 0.0, 0.0, s, 0.0, 0, p) for s in (1e-4, -1e-4))
    assert (pulled, pushed) == pytest.approx((1.2e-4 * k, -0.8e-4 * k))


@pytest.mark.parametrize("kind", ["cartesian", "corexy", "axis"])
def test_belts_that_damp_keep_up_with_a_steady_speed(kind: str) -> None:
    """A guide's damping b holds the carriage back by b v/k, a belt's does not; the resonance is as high either way."""
    drawn = MACHINES[kind].draw(np.random.default_rng(5), ())
    drawn["plant"]["tool"] = [0.0, 0.0]
    moved, table = damped_by_belts(drawn, 0.7)
    ratios = [[modes_of(machine, axis)["damping_ratio"] for axis in range(2)] for machine in (drawn, moved)]
    np.testing.assert_allclose(ratios[0], ratios[1])
    speed = 50.0
    told = Motion("steady", lambda t: np.column_stack([speed * t, 0 * t, 0 * t]), 1.0)
    for machine in (drawn, moved):
        reading, plant = straight.played(Real(machine), machine["kinematics"], told), machine["plant"]
        damping = plant["guide_b"][0] + plant["ground"][0]
        stiffness = plant["belt_k"][0] * (2 if kind == "corexy" else 1)
        lag = speed * reading.t[-1] - reading.nozzle_mm[-1, 0]
        assert lag == pytest.approx(damping * speed / stiffness, rel=0.02, abs=1e-4)
    assert 0.3 < np.max(table["share"]) <= 0.7 + 1e-9


def test_a_rotor_gives_way_at_rest_as_the_file_says() -> None:
    """Its magnets and its belt in series are the belt of before; beyond their frequency they are not."""
    real = Real(MACHINES["axis"].draw(np.random.default_rng(5), ()))
    changed = STRAIGHT_OUTSIDE["heavy_rotor"](np.random.default_rng(5), 1.0, real)[1]
    magnets, belts = changed.fields["rotor_k"], changed.fields["belt_k"]
    np.testing.assert_allclose(1 / (1 / magnets + 1 / belts), real.machine["plant"]["belt_k"])


def test_an_axis_that_turns_does_the_same_work() -> None:
    """Of every key times the way that it is about: force times way is torque times angle."""
    rim, way = 0.03, 0.012
    for key, power in (("force_n", 0), ("damping_n_s_per_m", 1), ("stiffness_n_per_m", 1), ("cubic_n_per_m3", 3)):
        name, number = turning.turned(key, 5.0, rim)
        assert number * (way / rim) ** (power + 1) == pytest.approx(5.0 * way ** (power + 1)), name
    assert turning.turned("load_mass_kg", 2.0, rim) == ("load_inertia_kg_m2", pytest.approx(2.0 * rim**2))
    assert turning.turned("pitch_mm", 4.0, rim) == ("pitch_rad", pytest.approx(4e-3 / rim))
    plan = draw(8, "turning:pendulum_gravity", 1.0)
    assert plan.file["axis"]["unit"] == "rad" and "torque_n_m" in plan.label.effects["pendulum_gravity"]


@pytest.mark.parametrize("stratum", ["axis/rest:belt_backlash", "turning/rest:cogging_force"])
def test_a_rest_is_of_real_size(stratum: str) -> None:
    label = draw(77, stratum, SECONDS).label
    ((name, share),) = label.rest.items()
    assert 0.05 <= share <= 0.2 and name not in CATALOGUE


def test_of_damping_anywhere_the_file_knows_nothing() -> None:
    """Straight axes have an effect for it; a delta's file has two numbers, and says that it does not know them."""
    straight_axes, delta = (draw(8, f"{kind}/free-damping:cogging", 1.0) for kind in ("cartesian", "delta"))
    assert 0 <= straight_axes.label.also["belt_damping"]["share"][0] <= 1 and "uncertainty" not in straight_axes.file
    assert delta.label.also == {}
    assert delta.file["uncertainty"]['"carriage.belt_damping_n_s_per_m"'] == 1.0
    said, true = delta.file["carriage"], delta.real.machine["carriage"]
    assert abs(true["belt_damping_n_s_per_m"] / said["belt_damping_n_s_per_m"] - 1) > 0.1
    assert delta.spreads[3] * true["belt_damping_n_s_per_m"] == pytest.approx(said["belt_damping_n_s_per_m"])


def test_the_noise_is_as_told() -> None:
    sensors = draw(8, "nothing:none", SECONDS).sensors
    nothing = np.zeros((64001, 3))
    still = Reading(np.arange(64001) / 6400, nothing, nothing, nothing, nothing)
    for name, values in sensors.record(still, np.random.default_rng(1)).items():
        f = np.asarray(np.fft.rfftfreq(len(values), 1 / sensors.rate_hz), dtype=np.float64)
        found = np.abs(np.fft.rfft(values)) ** 2 / len(values) / sensors.spectrum(name, f)
        coloured = (f > sensors.band_hz[0]) & (f < sensors.band_hz[1])
        assert np.mean(found[coloured]) == pytest.approx(1, abs=0.15)
        assert np.mean(found[~coloured]) == pytest.approx(1, abs=0.1)
        counts = values / sensors.count[name]
        np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)


def test_what_retuning_leaves_in_closed_form() -> None:
    """One number whose answer a is along the difference: dᵀP d = |d|²/(1 + |a|²); across it: all of |d|²."""
    difference, across = np.array([3.0, 4.0, 0.0]), np.array([[0.0], [0.0], [7.0]])
    found = visibility(difference, 2 * difference[:, None])
    assert (found.raw, found.left) == pytest.approx((5 / math.sqrt(3), 25 / 101))
    assert visibility(difference, across).left == pytest.approx(25)
    assert Visibility(0.2, 31.0, 9).visible
    assert not Visibility(0.05, 31.0, 9).visible
    assert not Visibility(0.2, 29.0, 9).visible


def test_what_numbers_explain_that_are_far_off_is_not_seen() -> None:
    """A phase two standard deviations off is worth 2², though a line through where it was leaves thousands."""

    def told(z: FloatArray) -> FloatArray:
        return np.asarray(50.0 * np.sin(np.arange(400) / 9.0 + 0.6 * float(z[0])))

    still, true = told(np.zeros(1)), told(np.array([2.0]))
    n = (told(np.array([1e-3])) - still)[:, None] / 1e-3
    assert visibility(true - still, n).left > 1e4
    found = visibility_by_refit(true, still, n, told)
    assert found.left < 30.0 and not found.visible and found.raw == visibility(true - still, n).raw
    another = true + 5.0 * np.cos(np.arange(400.0))
    assert visibility_by_refit(another, still, n, told).left == pytest.approx(4 + 12.5 * 400, rel=0.02)


def test_numbers_of_a_printer_are_moved_together() -> None:
    plain = {"plant": {"k": [10.0, np.array([2.0, 4.0])], "name": "a"}, "on": True}
    one, other = copy.deepcopy(plain), copy.deepcopy(plain)
    one["plant"]["k"][0], other["plant"]["k"][1] = 10.1, np.array([2.0, 4.04])  # type: ignore[index]
    moved = combined(plain, [one, other], [5.0, -10.0])
    assert moved["plant"]["k"][0] == pytest.approx(10.5) and moved["plant"]["name"] == "a" and moved["on"] is True
    np.testing.assert_allclose(moved["plant"]["k"][1], [2.0, 3.6])


def test_a_late_chip_is_not_seen_where_its_clock_may_be_as_late() -> None:
    """Two motions, each late by 4/3 of what its clock may be off: worth 2 (4/3)², though it is 3.5 noises."""
    told, rng, t = KINDS["multisine"], np.random.default_rng(3), np.arange(0.0, SECONDS, 1 / 6400)
    paths = [1e-3 * told(rng, (0.0, 0.0, 0.0), SECONDS, 1.0)(t) for _ in range(2)]
    moves = [np.gradient(np.gradient(p, t, axis=0), t, axis=0) for p in paths]
    without = [Reading(t, a, a, p, p) for a, p in zip(moves, paths, strict=True)]
    chip = draw_sensors(np.random.default_rng(4), "effector", 1600.0)
    seen = partial(whitened, chip, repeats=(1, 1), counts=samples(chip, without))
    true = seen([read_at(r, r.t - 4e-4) for r in without])
    none = np.empty((len(true), 0))
    found = visibility_by_other_clocks(true, without, none, 3e-4, seen)
    assert found.raw > 3.0
    assert found.left == pytest.approx(2 * (4 / 3) ** 2, rel=0.02)
    assert visibility(true - seen(without), none).left == pytest.approx(found.raw**2 * found.rows)


# ---- bank, seals, score --------------------------------------------------------------------------


def test_sets_are_counted_with_what_separates_them() -> None:
    seen = {"cogging": Visibility(1.0, 100.0, 9)}
    around = Circumstances(0.02, "all", 2, "ABC")
    label = Label("delta", "single", "usual", 1, {"cogging": {}}, "", seen, (), around)

    def judged(name: str, *separate: tuple[bool, str], alike: str = "torque_angle") -> score.Judged:
        told = {"verdict": "effects", "effects": [{"name": name}], "confusable_with": [{"name": alike}]}
        return score.Judged("a", label, {**told, "separate": [{"separates": s, "record": r} for s, r in separate]})

    cases = [
        judged("cogging", (True, "ffcomp record plan")),
        judged("cogging", (True, "")),
        judged("torque_angle", (False, "ffcomp record plan"), alike="cogging"),
        judged("torque_angle", (True, "ffcomp record plan"), alike="frame_mode"),
        judged("cogging"),
    ]
    assert score.sets(cases) == score.Sets(total=5, in_set=4, recording=1, settled=1, twins=1)


def test_every_beginning_of_the_bank_is_fair() -> None:
    bank = full_bank(240)
    told = [stratum.partition(":")[0].split("/") for _, stratum in bank.values()]
    hides = [what for _, what, _ in told]
    assert [hides.count(what) for what in HIDES] == [40, 120, 40, 40]
    for machine in MACHINES:
        own = [what for name, what, _ in told if name == machine]
        assert abs(own.count("single") - len(own) / 2) <= 0.5
        place = "servo" if machine in ("axis-by-force", "turning") else machine
        assert {c for name, _, c in told if name == machine} == set(CONDITIONS[place])
    assert [name for name, _, _ in told].count("turning") == 19
    assert {what for _, what, condition in told if condition == "rest"} == {"single"}
    early = hides[:24]
    assert early.count("single") == 12 and min(early.count(what) for what in HIDES) >= 3
    names = {name for _, stratum in bank.values() for name in stratum.partition(":")[2].split("+")}
    assert set(EFFECTS) <= names and len(names & set(OUTSIDE)) >= 10
    assert list(full_bank(30).items()) == list(bank.items())[:30]
    assert set(full_bank(30)) != set(full_bank(30, seed=2))
    some = full_bank(30, machines=["cartesian"])
    assert set(some.items()) <= set(bank.items())


def test_labels_stay_sealed_until_every_verdict_is_written(tmp_path: Path) -> None:
    made = case(2, "weak:cogging", SECONDS, short=True)
    for name in ("case-001", "case-002"):
        folder = written(made, tmp_path, name)
        assert {p.name for p in folder.iterdir()} == {"machine.toml", "runs"}
        given = "".join(p.read_text(encoding="utf-8") for p in folder.rglob("*.*"))
        assert "cogging" not in given and "weak" not in given
    verdict_path(tmp_path, "case-001").parent.mkdir()
    verdict_path(tmp_path, "case-001").write_text("{}", encoding="utf-8")
    with pytest.raises(SealedError, match="1 verdicts are not written yet, case-002 first"):
        open_labels(tmp_path, ["case-001", "case-002"])
    assert open_labels(tmp_path, ["case-001"])["case-001"] == made.label
    label = tmp_path / "sealed" / "case-001" / "label.json"
    label.write_text(label.read_text(encoding="utf-8").replace("cogging", "backlash"), encoding="utf-8")
    with pytest.raises(SealedError, match="not the one that was sealed"):
        open_labels(tmp_path, ["case-001"])


def test_wilson() -> None:
    assert score.wilson(8, 10) == pytest.approx((0.4902, 0.9433), abs=1e-4)
    assert score.wilson(0, 0) == (0.0, 1.0)
    assert score.wilson(20, 20) == pytest.approx((0.8389, 1.0), abs=1e-4)


def judged(stratum: str, effects: Mapping[str, Any], said: list[str], **more: Any) -> score.Judged:
    """A verdict that names `said`, each 1 % too large and sure to 2 %; or 'none' or 'unknown'."""
    seen = {name: Visibility(1.0, 1e4, 1000) for name in [*effects, *([more["outside"]] if "outside" in more else [])]}
    around = Circumstances(0.02, "all", 2, "ABC")
    label = Label("delta", stratum, "usual", 1, effects, more.get("outside", ""), seen, more.get("alike", ()), around)
    named = [name for name in said if name in EFFECTS]
    told = [{"name": n, "parameters": {k: _told(x) for k, x in effects.get(n, {}).items()}} for n in named]
    rivals = [{"name": name} for name in more.get("rivals", [])]
    verdict = {"verdict": "effects" if named else said[0], "effects": told, "confusable_with": rivals}
    return score.Judged("case", label, verdict, more.get("proof", {}))


def _told(true: float) -> dict[str, float]:
    return {"value": 1.01 * true, "low": 0.99 * true, "high": 1.03 * true}


def test_an_axis_that_rests_has_no_number_to_be_right() -> None:
    said = {"value": [2.1, 1.9, 0.0], "low": [1.8, 1.7, 0.0], "high": [2.4, 2.2, 0.0]}
    answer = {"verdict": "effects", "effects": [{"name": "coulomb_friction", "parameters": {"force_n": said}}]}
    for machine, true, covered in (
        ("corexy", 2.0, [True, True]),
        ("corexy", [2.0, 2.0, 0.0], [True, True]),
        ("delta", 2.0, [True, True, False]),
    ):
        one = judged("single", {"coulomb_friction": {"force_n": 2.0}}, ["coulomb_friction"])
        label = replace(one.label, machine=machine, effects={"coulomb_friction": {"force_n": true}})
        found = score.numbers([replace(one, label=label, verdict=answer)])
        assert [e.covered for e in found] == covered, machine


def test_the_score_of_known_verdicts() -> None:
    mass, late = {"effector_mass": {"added_kg": 0.1}}, {"command_delay": {"delay_s": 1e-3}}
    verdicts = [
        judged("single", mass, ["effector_mass"], proof={"before": 0.11, "after": 0.012, "noise": 0.01}),
        judged("single", mass, ["belt_stiffness"]),
        judged("single", late, ["sensor_time_offset"], alike=("sensor_time_offset",), rivals=["command_delay"]),
        judged("single", mass, ["unknown"]),
        judged("nothing", {}, ["none"]),
        judged("nothing", {}, ["cogging"]),
        judged("outside", {}, ["unknown"], outside="soft_tower"),
        judged("outside", {}, ["cogging"], outside="soft_tower"),
        judged("pair", mass | late, ["effector_mass", "command_delay"]),
        judged("pair", mass | late, ["effector_mass"]),
    ]
    found = {rate.title: (rate.hits, rate.total) for rate in score.rates(verdicts)}
    assert found["top-1, visible single effects"] == (2, 4)
    assert found["a wrong name alone"] == (1, 4)
    assert found["truth in the returned set, visible single effects"] == (2, 4)
    assert found["false alarms (nothing hidden)"] == (1, 2)
    assert found["outside the catalogue and `unknown` said"] == (1, 2)
    assert found["pairs, both found"] == (1, 2)
    said = {rate.title: rate.verdict for rate in score.rates(verdicts)}
    assert said["outside the catalogue and `unknown` said"] == "missed"
    assert found["true values inside the 90 % interval"] == (3, 3)
    assert score.shrink(verdicts) == pytest.approx([0.02])
    table = score.confusion(verdicts)
    assert table["effector_mass"] == {"effector_mass": 1, "belt_stiffness": 1, "unknown": 1}
    assert table["a pair"] == {"2 right, 0 wrong": 1, "1 right, 0 wrong": 1}


def test_of_a_pair_what_cannot_be_seen_need_not_be_named() -> None:
    both = {"effector_mass": {"added_kg": 0.1}, "command_delay": {"delay_s": 1e-3}}
    for named, wanted in (("command_delay", True), ("effector_mass", False), ("cogging", False), ("none", True)):
        one = judged("pair", both, [named])
        hidden = {**one.label.visibility, "effector_mass": Visibility(1.0, 14.0, 1000)}
        assert score.as_wanted(replace(one, label=replace(one.label, visibility=hidden))) is wanted, named
    assert not score.as_wanted(judged("pair", both, ["command_delay"]))


def test_what_belts_damp_need_not_be_named_and_a_rest_may_be_left() -> None:
    late = {"command_delay": {"delay_s": 1e-3}}
    found = judged("single", late, ["command_delay"])
    free = replace(found.label, also={"belt_damping": {"share": 0.5}}, condition="free-damping")
    share = {"name": "belt_damping", "parameters": {"share": _told(0.5)}}
    verdict = {**found.verdict, "effects": [*found.verdict["effects"], share]}
    both = replace(found, label=free, verdict=verdict)
    assert both.right and [e.key for e in score.numbers([both])] == ["command_delay.delay_s", "belt_damping.share"]
    alone = replace(found, label=replace(free, hides="nothing", effects={}), verdict={**verdict, "effects": [share]})
    assert alone.says == "none" and score.as_wanted(alone)
    assert not score.as_wanted(replace(alone, label=replace(alone.label, also={})))

    def most(name: str, rest: Mapping[str, float]) -> score.Judged:
        verdict = {"verdict": "unknown", "dominant": {"name": name}}
        return replace(found, label=replace(found.label, rest=rest), verdict=verdict)

    right, bare, wrong = (
        most("command_delay", {"fans_tone": 0.1}),
        most("command_delay", {}),
        most("cogging", {"x": 0.1}),
    )
    assert [score.as_wanted(j) for j in (right, bare, wrong)] == [True, False, False]
    counts = {rate.title: rate.hits for rate in score.rates([right, bare, wrong])}
    assert counts["top-1, visible single effects"] == 0
    assert counts["top-1, alone or with a rest, visible single effects"] == 2
    assert counts["a wrong name alone"] == 1
    dry = replace(found, label=replace(found.label, effects={"bristle_friction": {"force_n": 9.0}}))
    other = replace(dry, verdict={"verdict": "unknown", "dominant": {"name": "coulomb_friction"}})
    alone = replace(dry, verdict={"verdict": "effects", "effects": [{"name": "coulomb_friction", "parameters": {}}]})
    counts = {rate.title: rate.hits for rate in score.rates([other, alone])}
    assert counts["top-1, alone or with a rest, visible single effects"] == 0
    assert counts["the same, or another law of its family with a rest"] == 1
    assert counts["a wrong name alone"] == 1


# ---- a handful of cases, through the public verb --------------------------------------------------

SMOKE = {  # a delta's effects take a minute each: they are in the full bank
    "exact-file:none": ("none", ()),
    "axis:bristle_friction": ("effects", ("bristle_friction",)),
    "axis-by-force:friction_by_direction": ("effects", ("friction_by_direction",)),
    "axis-by-force:none": ("none", ()),
    "axis/pair:cogging+guide_damping": ("unknown", ()),
}
DOMINANT = {"axis/pair:cogging+guide_damping": "guide_damping"}  # a pitch of 0.8 mm does not repeat in 1.4 mm of travel


@pytest.mark.parametrize("stratum", SMOKE)
def test_smoke(stratum: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Short runs: two motions of 0.8 s."""
    folder = written(case(31, stratum, SECONDS, short=True), tmp_path)
    runs = map(str, sorted((folder / "runs").iterdir()))
    run(app, ["diagnose", *runs, "-m", str(folder / "machine.toml"), "--json", "-q"])
    found = json.loads(capsys.readouterr().out)
    verdict, names = SMOKE[stratum]
    assert found["verdict"] == verdict
    assert sorted(effect["name"] for effect in found["effects"]) == sorted(names)
    assert (found["dominant"] or {}).get("name") == DOMINANT.get(stratum)
