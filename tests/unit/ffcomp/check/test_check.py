"""What a check says of printers that share no line with ours: as last time, what changed, or that it cannot tell."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ffcomp.check.compare import CheckResult, check_result
from ffcomp.check.history import Check
from ffcomp.measurement.recording import Recording
from ffcomp.record.clock import ClockFit
from ffcomp.record.moves import Request, make_plan
from ffcomp.record.plan import Plan
from ffcomp.record.result import Joined, JoinResult
from ffcomp.report.check import checks_figure
from models.file import load_machine
from models.machine import Machine, with_values
from validation.plants import delta_plant, straight_plant
from validation.plants.accelerometer import nozzle_felt

RATE_HZ = 1600.0
DOCS = Path(__file__).parents[4] / "docs"
AXES = "x,y,z"
Nozzle = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class Bench:
    machine: Machine
    plan: Plan
    felt: Callable[[Any, Nozzle, np.ndarray], np.ndarray]  # of a hidden printer, (n, 3) m/s²

    def joined(self, hidden: Any, seed: int, noise: float = 0.15, yaw_deg: float = 0.0, axes: str = AXES) -> JoinResult:
        """Two repeats of each experiment, joined up to 30 µs."""
        rng, c, s = np.random.default_rng(seed), np.cos(np.deg2rad(yaw_deg)), np.sin(np.deg2rad(yaw_deg))
        found = []
        for each in self.plan.experiments:
            t = np.arange(-0.4, each.duration_s + 0.3, 1 / RATE_HZ)
            clean = self.felt(hidden, each.motion.nozzle, t) @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
            for repeat in (1, 2):
                late = 3e-5 * rng.standard_normal()
                rows = clean + late * np.gradient(clean, 1 / RATE_HZ, axis=0)
                rows = rows + noise * rng.standard_normal(rows.shape)
                found.append(_joined(each.name, repeat, t, rows, axes))
        return JoinResult(tuple(found), ())

    def check(self, joined: JoinResult, history: list[Check], date: str = "2026-11-22T21:00") -> CheckResult:
        return check_result(joined, self.plan, self.machine, history, date)


def _joined(name: str, repeat: int, t: np.ndarray, rows: np.ndarray, axes: str) -> Joined:
    acceleration = {f"acc_{axis}": rows[:, i] for i, axis in enumerate("xyz")}
    recording = Recording(f"{name}-{repeat}.csv", t - t[0], np.zeros_like(rows), "nozzle", acceleration, {}, {})
    return Joined(recording, name, repeat, ClockFit(0.0, 1e-4, 1.0, 0.0, 0.99), 0, "", axes, float(t[0]))


@pytest.fixture(scope="module")
def delta() -> Bench:
    machine = load_machine("mp-delta-pro")
    request = Request([machine.kinematics.centre_mm], seconds=1.5, seed=17, kinds=("multisine", "reversals"))

    def felt(hidden: Any, nozzle: Nozzle, t: np.ndarray) -> np.ndarray:
        return nozzle_felt(hidden, nozzle, -0.6, float(t[-1]) + 0.2)(t)

    return Bench(machine, make_plan(machine, request), felt)


def delta_printer(
    mass_kg: float = 0.0, belts: tuple[float, ...] = (1, 1, 1), friction_n: tuple[float, ...] = (0.5, 0.5, 0.5)
) -> dict[str, Any]:
    """A printer with half a newton of friction that the file does not know, and a change."""
    made = {**delta_plant.load_machine(load_machine("mp-delta-pro").path), "effects": {}}
    stiffness = made["carriage"]["belt_stiffness_n_per_m"]
    made["effector"] = {**made["effector"], "nozzle_mass_kg": made["effector"]["nozzle_mass_kg"] + mass_kg}
    each = [stiffness * share for share in belts]
    made["towers"] = {"friction_n": list(friction_n), "stiction": 0.3, "belt_stiffness_n_per_m": each}
    return made


@pytest.fixture(scope="module")
def history(delta: Bench) -> list[Check]:
    return [delta.check(delta.joined(delta_printer(), 1), [], "2026-11-15T20:00").check]


def test_the_same_printer_is_as_last_time(delta: Bench, history: list[Check]) -> None:
    found = delta.check(delta.joined(delta_printer(), 2), history)
    assert found.verdict.finding == "same", found.verdict.message
    assert found.verdict.message.startswith("As on 2026-11-15 20:00") and not found.known


@pytest.mark.parametrize(
    ("hidden", "part", "size"),
    [
        ({"mass_kg": 0.12}, "mass on the nozzle holder", 0.12),
        ({"belts": (1.0, 0.9, 1.0)}, "belt B", -0.1),
        ({"friction_n": (0.5, 3.5, 0.5)}, "friction B", 3.0),
    ],
)
def test_one_change_is_named_with_its_size(
    delta: Bench, history: list[Check], hidden: dict[str, Any], part: str, size: float
) -> None:
    found = delta.check(delta.joined(delta_printer(**hidden), 3), history)
    assert found.verdict.finding == "changed", found.verdict.message
    assert [each.change.name for each in found.verdict.named] == [part], found.verdict.message
    assert found.verdict.named[0].value == pytest.approx(size, rel=0.1)


def test_a_turned_chip_is_no_change_of_the_printer(delta: Bench, history: list[Check]) -> None:
    found = delta.check(delta.joined(delta_printer(), 6, yaw_deg=5.0), history)
    assert found.verdict.finding == "sensor" and "turned by 5°" in found.verdict.message, found.verdict.message
    found = delta.check(delta.joined(delta_printer(), 6, axes="-y,x,z"), history)
    assert found.verdict.finding == "sensor" and "x,y,z of its own, and are -y,x,z now" in found.verdict.message


def test_what_creeps_is_compared_with_the_first_check(delta: Bench, history: list[Check]) -> None:
    slack = delta.check(delta.joined(delta_printer(belts=(1.0, 0.9, 1.0)), 7), []).check
    found = delta.check(delta.joined(delta_printer(belts=(1.0, 0.9, 1.0)), 8), [*history, slack])
    assert found.verdict.finding == "same" and found.since_first is not None
    assert "elt B is 10 % softer" in found.since_first.message, found.since_first.message
    axes = checks_figure(replace(found, checks=(*history, slack, found.check))).axes[0]
    assert [label.get_text() for label in axes.get_xticklabels()] == ["2026-11-15", "2026-11-22", "2026-11-22"]
    assert axes.get_lines()[0].get_ydata()[-1] == pytest.approx(100 * found.check.gap)


# ---- straight axes


HEAD = straight_plant.Plant(motors=((1.0, 1.0), (1.0, -1.0)), belt_n_per_m=(4e4, 4e4))


@pytest.fixture(scope="module")
def straight() -> Bench:
    machine, known = load_machine(DOCS / "examples" / "corexy.toml"), {}
    for i, axis in enumerate("xy"):
        (hertz,), (damping,), _ = HEAD.axis_modes(i)
        known |= {f"axes.{axis}.frequency_hz[0]": hertz, f"axes.{axis}.damping_ratio[0]": damping}
    machine = with_values(machine, known)
    request = Request([machine.kinematics.centre_mm], seconds=1.5, kinds=("multisine",))

    def felt(hidden: Any, nozzle: Nozzle, t: np.ndarray) -> np.ndarray:
        found = straight_plant.simulate(hidden, nozzle(t)[:, :2], RATE_HZ)
        return np.column_stack([found["acceleration_m_per_s2"], np.zeros(len(t))])

    return Bench(machine, make_plan(machine, request), felt)


def test_straight_axes_are_checked_by_their_modes(straight: Bench) -> None:
    before = [straight.check(straight.joined(HEAD, 1), []).check]
    assert straight.check(straight.joined(HEAD, 2), before).verdict.finding == "same"
    heavy = replace(HEAD, carriage_kg=(0.4, 0.6))
    found = straight.check(straight.joined(heavy, 3), before).verdict
    assert found.finding == "changed" and "mode of y near 64 Hz is 9 % lower" in found.message, found.message
    rough = replace(HEAD, friction_n=(2.0, 2.0))
    found = straight.check(straight.joined(rough, 5), before).verdict
    assert found.finding == "changed" and "riction of the guides is" in found.message, found.message
