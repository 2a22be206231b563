"""The generator of the blind test, and one of its cases through the public verb. The full bank: benchmarks."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ffcomp.cli.app import app
from ffcomp.cli.command import run
from ffcomp.diagnosis.noise import noise_floor, whitener
from ffcomp.diagnosis.problems import problem_of, recordings_of
from ffcomp.diagnosis.where import locate_residual
from models.effects.catalogue import measured, with_effect
from models.file import load_machine, load_plant
from models.printer.printer import simulate_printer
from validation.blind import delta, score, straight
from validation.blind.bank import write_case
from validation.blind.cases import Case, Label, Plan, case, draw
from validation.blind.delta import EFFECTS, OUTSIDE
from validation.blind.kinds import KINDS as MACHINES
from validation.blind.motions import KINDS, Motion
from validation.blind.real import FloatArray, Reading, Real, toml_of
from validation.blind.straight import effects_of
from validation.blind.visible import Visibility, visibility
from validation.plants import delta_plant
from validation.plants.delta_plant import Plant, carriages_of, plant_of

SECONDS = 0.8


def motion(kind: str = "multisine", loudness: float = 1.0) -> Motion:
    rng = np.random.default_rng(3)
    return Motion(kind, KINDS[kind](rng, (20.0, -15.0, 40.0), SECONDS, loudness), SECONDS)


def printer(seed: int = 11, force_map: str = "virtual_work") -> Real:
    machine = delta.draw_machine(np.random.default_rng(seed))
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
    return accelerations(delta.played(real, real.machine["kinematics"], motion(kind, loudness)))


# ---- the generator -------------------------------------------------------------------------------


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
    command = carriages_of(firmware, told.path(np.arange(round(rate * SECONDS) + 1) / rate))

    def tool(with_it: bool) -> FloatArray:
        owned = with_effect(machine, name, **table) if with_it else machine
        signals = measured(owned, simulate_printer(owned, command, 1 / rate).signals)
        return np.hstack([signals.carriage, signals.nozzle])

    plain = unchanged(real.machine["effector"]["force_map"], "multisine", 1.5)
    ours = [plain[::2], accelerations(delta.played(changed, firmware, told))[::2]]
    theirs = [tool(False), tool(True)]
    np.testing.assert_allclose(_slow(ours[0]), _slow(theirs[0]), atol=2e-3 * np.abs(ours[0]).max())
    difference, wanted = _slow(theirs[1] - theirs[0]), _slow(ours[1] - ours[0])
    both, size = np.sum(difference * wanted), np.linalg.norm(wanted)
    assert both > 0.8 * np.linalg.norm(difference) * size
    assert 0.7 < both / size**2 < 1.4


ALIKE = "coulomb_friction stribeck_friction guide_damping frame_mode sensor_gain sensor_time_offset sensor_clock_drift"
OF_STRAIGHT_AXES = [  # what sits on an axis, and not on a motor, is the same on both kinds
    *(("cartesian", name) for name in effects_of("cartesian")),
    *(("corexy", name) for name in effects_of("corexy") if name not in (*ALIKE.split(), "toolhead_mode")),
]


@pytest.mark.parametrize(("kind", "name"), OF_STRAIGHT_AXES)
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


def _slow(values: FloatArray) -> FloatArray:
    """Below 200 Hz, 3200 samples a second."""
    spectrum = np.fft.rfft(values, axis=0)
    spectrum[np.fft.rfftfreq(len(values), 1 / 3200) > 200] = 0
    return np.fft.irfft(spectrum, len(values), axis=0)


@pytest.mark.parametrize("kind", [kind for kind in MACHINES if kind != "nozzle"])  # a delta
def test_nothing_hidden_leaves_only_the_noise(kind: str, tmp_path: Path) -> None:
    """Every kind of motion through files, against the tool's own simulation of the same machine."""
    made = case(21, f"{kind}/nothing/usual:none", SECONDS)
    true = exact(draw(21, f"{kind}/nothing/usual:none", SECONDS))
    assert made.label.effects == {} and made.label.visible
    folder = written(replace(made, machine=true), tmp_path)
    machine = load_plant(folder / "machine.toml")
    plant = problem_of(machine, recordings_of(machine, sorted((folder / "runs").iterdir())), ())
    simulated = plant.simulate({})
    floor = noise_floor(plant, simulated)
    found = locate_residual(plant, whitener(plant.observations, floor, plant.band_hz), floor, simulated)
    forced = kind in ("axis-by-force", "turning")  # their noise is guessed from the encoder's counts
    assert found.total.nrms < (1.5 if forced else 1.1) * found.total.noise_nrms
    most = 1.5 if forced or kind == "axis" else 1.2  # an axis' shots begin where the noisy encoder says
    assert all(size.nrms < most * size.noise_nrms for size in found.signals.values())


def exact(plan: Plan) -> str:
    """The machine file without an error."""
    return toml_of(plan.kind.file_of(plan.real.machine, 0.0, np.random.default_rng(1)), "true")


def written(made: Case, bank: Path, name: str = "case-001") -> Path:
    write_case(bank, name, made)
    return bank / "cases" / name


def test_a_seed_is_a_case() -> None:
    one, same, other = (case(seed, "axis/nothing/usual:none", SECONDS) for seed in (4, 4, 5))
    assert (one.machine, one.runs, one.label) == (same.machine, same.runs, same.label)
    assert one.machine != other.machine
    one, same, other = (draw(seed, "delta/single/usual:cogging", SECONDS) for seed in (4, 4, 5))
    assert (one.text, one.label) == (same.text, same.label) and one.label.effects != other.label.effects


def test_energy_is_kept_without_dampers() -> None:
    """Frame, cable, hardening belts and all, let go from a stretched position."""
    machine = delta.draw_machine(np.random.default_rng(2))
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
    p = plant_of(machine, gravity=True, hidden=fields)
    xyz = np.array([[0.02, -0.03, 0.04]])
    command = carriages_of(machine["kinematics"], 1e3 * xyz)[0] / 1e3
    y = delta_plant.rest(command, p)
    y[:3] += [2e-4, -1e-4, 3e-4]
    before = energy(y, command, p)
    rows = np.tile(command, (2 * 6400 + 1, 1))
    delta_plant.run(rows, 0 * rows, 1 / 12800, 12800, y, p)
    at_rest = energy(delta_plant.rest(command, p), command, p)
    assert abs(energy(y, command, p) - before) < 1e-5 * (before - at_rest)


def energy(y: FloatArray, command: FloatArray, p: Plant) -> float:
    """Kinetic and potential, J, written down from the bodies."""
    x, v, eta, sway = y[:3], y[3:6], y[6:9], np.append(y[delta_plant.SWAYV : delta_plant.SWAYV + 2] @ p.sway_dir, 0.0)
    s = np.sqrt(p.arms**2 - np.sum((x[:2] - p.towers) ** 2, axis=1))
    q, dq = x[2] + p.height + s, v[2] - (x[:2] - p.towers) @ v[:2] / s
    cable, swing = y[delta_plant.CABLE : delta_plant.CABLE + 2], y[delta_plant.CABLEV : delta_plant.CABLEV + 2]
    rotor, stretch = y[delta_plant.ROTOR : delta_plant.ROTOR + 3], y[delta_plant.ROTOR : delta_plant.ROTOR + 3] - q
    moving = p.carriage @ dq**2 + p.holder * np.sum((v + sway) ** 2)
    moving += p.extruder * np.sum((v + sway + y[9:12]) ** 2) + p.cable_mass * np.sum(((v + sway)[:2] + swing) ** 2)
    moving -= p.rods * (3 * v[:2] @ v[:2] + np.sum((v[2] - dq) ** 2))
    moving += p.rotor @ y[delta_plant.ROTORV : delta_plant.ROTORV + 3] ** 2
    moving += p.sway_mass @ y[delta_plant.SWAYV : delta_plant.SWAYV + 2] ** 2
    held = p.belt_k @ stretch**2 + p.cubic @ stretch**4 / 2 + p.mount_k @ eta**2 + p.cable_k * np.sum(cable**2)
    held += p.rotor_k @ (command - rotor) ** 2
    held += p.sway_k @ y[delta_plant.SWAY : delta_plant.SWAY + 2] ** 2
    weight = p.carriage @ q + p.holder * x[2] + p.extruder * (x[2] + eta[2])
    return float(moving / 2 + held / 2 + p.gravity * weight)


def test_what_retuning_leaves_in_closed_form() -> None:
    """One number whose answer a is along the difference: dᵀP d = |d|²/(1 + |a|²); across it: all of |d|²."""
    difference, across = np.array([3.0, 4.0, 0.0]), np.array([[0.0], [0.0], [7.0]])
    found = visibility(difference, 2 * difference[:, None])
    assert (found.raw, found.left) == pytest.approx((5 / math.sqrt(3), 25 / 101))
    assert visibility(difference, across).left == pytest.approx(25)
    assert Visibility(0.2, 31.0, 9).visible
    assert not Visibility(0.05, 31.0, 9).visible
    assert not Visibility(0.2, 29.0, 9).visible


# ---- bank, seals, score --------------------------------------------------------------------------


def test_wilson() -> None:
    assert score.wilson(8, 10) == pytest.approx((0.4902, 0.9433), abs=1e-4)
    assert score.wilson(0, 0) == (0.0, 1.0)
    assert score.wilson(20, 20) == pytest.approx((0.8389, 1.0), abs=1e-4)


def judged(stratum: str, effects: Mapping[str, Any], said: list[str], **more: Any) -> score.Judged:
    """A verdict that names `said`, each 1 % too large and sure to 2 %; or 'none' or 'unknown'."""
    seen = {name: Visibility(1.0, 1e4, 1000) for name in [*effects, *([more["outside"]] if "outside" in more else [])]}
    label = Label("delta", stratum, "usual", 1, effects, more.get("outside", ""), seen, more.get("alike", ()))
    named = [name for name in said if name in EFFECTS]
    told = [{"name": n, "parameters": {k: _told(x) for k, x in effects.get(n, {}).items()}} for n in named]
    rivals = [{"name": name} for name in more.get("rivals", [])]
    verdict = {"verdict": "effects" if named else said[0], "effects": told, "confusable_with": rivals}
    return score.Judged("case", label, verdict)


def _told(true: float) -> dict[str, float]:
    return {"value": 1.01 * true, "low": 0.99 * true, "high": 1.03 * true}


def test_the_score_of_known_verdicts() -> None:
    mass, late = {"effector_mass": {"added_kg": 0.1}}, {"command_delay": {"delay_s": 1e-3}}
    verdicts = [
        judged("single", mass, ["effector_mass"]),
        judged("single", mass, ["belt_stiffness"]),
        judged("single", late, ["sensor_time_offset"], alike=("sensor_time_offset",), rivals=["command_delay"]),
        judged("single", mass, ["unknown"]),
        judged("nothing", {}, ["none"]),
        judged("nothing", {}, ["cogging"]),
        judged("outside", {}, ["unknown"], outside="soft_bracket"),
        judged("outside", {}, ["cogging"], outside="soft_bracket"),
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
    table = score.confusion(verdicts)
    assert table["effector_mass"] == {"effector_mass": 1, "belt_stiffness": 1, "unknown": 1}
    assert table["a pair"] == {"2 right, 0 wrong": 1, "1 right, 0 wrong": 1}


# ---- a case, through the public verb ---------------------------------------------------------------


def test_smoke(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = written(case(31, "delta/nothing/usual:none", SECONDS), tmp_path)
    runs = map(str, sorted((folder / "runs").iterdir()))
    run(app, ["diagnose", *runs, "-m", str(folder / "machine.toml"), "--json", "-q"])
    found = json.loads(capsys.readouterr().out)
    assert found["verdict"] == "none" and not found["effects"] and not found["dominant"]
