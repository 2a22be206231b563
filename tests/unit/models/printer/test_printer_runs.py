"""The virtual printer against runs recorded on a plant written by someone else: nothing but noise may be left."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from models.effects.catalogue import with_effect
from models.file import load_machine
from models.machine import Machine
from models.printer.printer import simulate_printer

RUNS = (
    "infill-centre-1",
    "infill-front",
    "multisine-centre-1",
    "multisine-centre-large",
    "multisine-left",
    "slow-back",
)


def left_over(machine: Machine, run: Path) -> float:
    """m/s², rms over the six accelerometers, of what the printer does not explain of a run."""
    table = np.loadtxt(run, delimiter=",", skiprows=1)
    motion = simulate_printer(machine, table[:, 1:4], table[1, 0] - table[0, 0])
    simulated = np.hstack([motion.carriage_acceleration, motion.nozzle_acceleration])
    return float(np.sqrt(np.mean((simulated - table[:, 4:]) ** 2)))


def told(folder: Path) -> tuple[Machine, Machine, float]:
    """The machine as its file says, as the truth says, and the noise."""
    machine = load_machine(folder / "machine.toml")
    truth = tomllib.loads((folder / "truth.toml").read_text(encoding="utf-8"))
    true = machine
    for name, table in truth.get("effects", {}).items():
        true = with_effect(true, name, **table)
    return machine, true, truth["noise_m_per_s2"]


@pytest.mark.parametrize("run", RUNS)
@pytest.mark.parametrize("case", ["nothing-hidden", "effector-mass"])
def test_the_true_machine_leaves_the_noise(runs_folder: Path, case: str, run: str) -> None:
    _, true, noise = told(runs_folder / case)
    assert left_over(true, runs_folder / case / "runs" / f"{run}.csv") == pytest.approx(noise, rel=0.015)


@pytest.mark.parametrize("run", RUNS)
def test_true_friction_leaves_little_more_than_noise(runs_folder: Path, run: str) -> None:
    """The recorded plant's friction has another shape near rest; of what friction does, a fifth may remain in power."""
    machine, true, noise = told(runs_folder / "coulomb-friction")
    path = runs_folder / "coulomb-friction" / "runs" / f"{run}.csv"
    without, with_it = (left_over(m, path) ** 2 - noise**2 for m in (machine, true))
    limit = 0.001 if run.startswith("multisine") else 0.22 if run.startswith("slow") else 0.03
    assert with_it < limit * without
