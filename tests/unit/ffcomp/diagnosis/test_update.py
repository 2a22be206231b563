"""Bayes' rule on recordings of prints: intervals that hold, drift that is followed, and what is refused."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ffcomp.cli.app import app
from ffcomp.diagnosis.problem import Parameter
from ffcomp.diagnosis.update import FLOOR, Updated, read_history, update, update_problem
from ffcomp.errors import NothingToDo
from ffcomp.identification.request import UpdateRequest
from ffcomp.measurement.recording import Recording
from ffcomp.planner.limits import PlannerLimits
from ffcomp.record.plan import plain_motion
from ffcomp.record.result import measured_run, recording_lines
from models.effects.catalogue import with_effects
from models.file import load_machine, machine_of_text
from models.machine import Machine, value_of
from tests.support.cli import CliRunner
from tests.support.configs import STEPS
from validation.plants.straight_plant import Plant, simulate

RATE_HZ, NOISE = 1600.0, 0.15
LIMITS = PlannerLimits(300.0, 8000.0, 5.0, minimum_cruise_ratio=0.5)
TEXT = f"""format = "ffcomp-machine/1"
name = "two axes"
[kinematics]
type = "corexy"
x_range_mm = [-100.0, 100.0]
y_range_mm = [-100.0, 100.0]
z_range_mm = [0.0, 200.0]
[axes.x]
frequency_hz = [55.0]
damping_ratio = [0.06]
[axes.y]
frequency_hz = [43.0]
damping_ratio = [0.06]
[limits]
velocity_mm_per_s = 300.0
acceleration_mm_per_s2 = 8000.0
{STEPS}[uncertainty]
default = {{default}}
"""
KEYS = ("axes.x.frequency_hz[0]", "axes.y.frequency_hz[0]")


def machine(default: float = 0.05) -> Machine:
    return machine_of_text(TEXT.format(default=default), "two axes")


def printer(x_hz: float, y_hz: float) -> Plant:
    """The independent printer, with damping that the file does not know and a little friction."""
    kg, hz = 0.4, np.array([x_hz, y_hz])
    stiffness = kg * (2 * np.pi * hz) ** 2
    held = 2 * 0.07 * kg * 2 * np.pi * hz
    return Plant(
        carriage_kg=(kg, kg),
        belt_n_per_m=(float(stiffness[0]), float(stiffness[1])),
        guide_n_s_per_m=(float(held[0]), float(held[1])),
        friction_n=(0.1, 0.1),
        bristle_n_per_m=5e3,
    )


def layers(plants: Sequence[Plant], seed: int = 1) -> list[Recording]:
    """One recording a plant: a second of infill and corners."""
    rng = np.random.default_rng(seed)
    recordings = []
    for k, plant in enumerate(plants):
        corners = np.cumsum(rng.uniform(-12.0, 12.0, (14, 3)) * [1.0, 1.0, 0.0], axis=0)
        motion = plain_motion(np.vstack([np.zeros(3), corners]), np.full(14, 120.0), LIMITS)
        tau = np.arange(-0.3, motion.duration_s + 0.2, 1 / RATE_HZ)
        felt = simulate(plant, motion.nozzle(tau)[:, :2], RATE_HZ)["acceleration_m_per_s2"]
        noisy = np.column_stack([felt, np.zeros(len(tau))]) + NOISE * rng.standard_normal((len(tau), 3))
        sensors = {f"acc_{axis}": noisy[:, i] for i, axis in enumerate("xyz")}
        recordings.append(measured_run(f"layer_{k}", motion, tau, sensors, {"delay_sd_s": "3e-4"}))
    return recordings


def request(**more: Any) -> UpdateRequest:
    return UpdateRequest(data=("layers",), machine="m.toml", output=Path("none/of/this.toml"), **more)


@pytest.fixture(scope="module")
def updates(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[tuple[float, float], Updated]]:
    """Printers as likely as the file says, each updated by one print of three layers."""
    path = tmp_path_factory.mktemp("update") / "mine.toml"
    path.write_text(TEXT.format(default=0.05), encoding="utf-8")
    rng, made, mine = np.random.default_rng(7), [], load_machine(str(path))
    for seed in range(3):
        hz = 55.0 * (1 + 0.05 * rng.standard_normal()), 43.0 * (1 + 0.05 * rng.standard_normal())
        made.append((hz, update(mine, layers([printer(*hz)] * 3, seed), request())))
    return made


def test_intervals_hold_and_are_ten_times_narrower(updates: list[tuple[tuple[float, float], Updated]]) -> None:
    held = []
    for hz, updated in updates:
        for key, true in zip(KEYS, hz, strict=True):
            estimate = updated.numbers[key].after
            held.append(estimate.low <= true <= estimate.high)
            assert abs(estimate.value / true - 1) < 0.01
            assert estimate.relative_sd < 0.01
    assert sum(held) >= 4  # of 6, at 90 %: fewer by chance in one of 60


def test_the_file_states_what_was_learnt(updates: list[tuple[tuple[float, float], Updated]]) -> None:
    (x_hz, _), updated = updates[0]
    written = machine_of_text(updated.file_text(), "written")
    assert value_of(written, KEYS[0]) == pytest.approx(x_hz, rel=0.01)
    assert FLOOR <= written.uncertainty["axes.x.frequency_hz"] < 0.01
    assert "axes.z.frequency_hz" not in written.uncertainty  # nothing moved along z
    assert written.name == "two axes"


def prior(known: Machine, asked: UpdateRequest) -> dict[str, Parameter]:
    problem = update_problem(known, layers([printer(55.0, 43.0)]), asked)
    return {each.name: each for each in problem.parameters}


def test_the_effects_of_a_file_stay_as_they_are() -> None:
    filed = with_effects(machine(), {"coulomb_friction": {"force_n": 2.0}})
    assert prior(filed, request()).keys() == prior(machine(), request()).keys()


def test_numbers_that_are_worse_on_layers_left_out_are_not_written() -> None:
    """Layers that contradict each other: the file between them is better than what either says of the other."""
    apart = [printer(57.0, 44.6), printer(53.0, 41.4)]
    with pytest.raises(NothingToDo, match="left out of the fit are simulated no better"):
        update(machine(0.05), layers(apart), request())


# ---- files ---------------------------------------------------------------------------------------


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, list[Path]]:
    """A machine file, and the runs of one print."""
    (tmp_path / "mine.toml").write_text(TEXT.format(default=0.05), encoding="utf-8")
    runs = []
    for each in layers([printer(57.0, 42.0)] * 3):
        runs.append(tmp_path / each.source)
        runs[-1].write_bytes(b"".join(recording_lines(each)))
    return tmp_path / "mine.toml", runs


def test_the_verb_updates_the_file_in_place_and_keeps_a_history(files: tuple[Path, list[Path]]) -> None:
    mine, runs = files
    words = ["identify", "update", *map(str, runs), "-m", str(mine), "-o", str(mine)]
    result = CliRunner().invoke(app, [*words, "--json", "-q"])
    assert result.exit_code == 0, result.output
    answer, history = json.loads(result.stdout), mine.with_name("mine.updates.jsonl")
    assert value_of(load_machine(str(mine)), KEYS[0]) == pytest.approx(57.0, rel=0.01)
    assert read_history(history) == [{key: each for key, each in answer.items() if key != "answer"}]
    assert answer["numbers"][KEYS[0]]["before"]["sd"] > 5 * answer["numbers"][KEYS[0]]["after"]["sd"]
    assert answer["written_sha256"] == load_machine(str(mine)).sha256
    # the same recordings again would count twice
    before = mine.read_bytes(), history.read_bytes()
    again = CliRunner().invoke(app, [*words, "-q"])
    assert again.exit_code == 5 and "A recording counts once" in again.output
    assert (mine.read_bytes(), history.read_bytes()) == before
    # the next prior is what the history says of each number by itself
    wide = np.hypot(answer["numbers"][KEYS[0]]["after"]["sd"], 0.005 * 57.0)
    assert prior(load_machine(str(mine)), _of(mine, runs))[KEYS[0]].sd == pytest.approx(wide, rel=0.01)


def _of(mine: Path, runs: Sequence[Path], **more: Any) -> UpdateRequest:
    return UpdateRequest(data=tuple(runs), machine=str(mine), output=mine, **more)
