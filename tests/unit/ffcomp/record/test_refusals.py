"""What owners bring that must not be joined in silence: a shaper left on, repeats that do not repeat, long captures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from ffcomp.record.join import join_captures
from ffcomp.record.moves import Request, make_plan
from ffcomp.record.plan import Plan, save_plan
from ffcomp.record.result import JoinResult
from ffcomp.shapers.pulses import SHAPERS
from models.file import load_machine
from models.machine import Machine
from tests.support.recordings import write_captures

KINDS = ("zigzag", "loop")


@pytest.fixture(scope="module")
def machine() -> Machine:
    return load_machine("voron-300")


@pytest.fixture(scope="module")
def plan(machine: Machine) -> Plan:
    made = make_plan(machine, Request(seconds=2.0, places_mm=[machine.kinematics.centre_mm]))
    return replace(made, experiments=tuple(each for each in made.experiments if each.kind in KINDS))


@pytest.fixture(scope="module")
def captures(plan: Plan, machine: Machine, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return captured(plan, machine, tmp_path_factory.mktemp("captures"))


def captured(plan: Plan, plant: Machine, folder: Path, **options: object) -> list[Path]:
    save_plan(plan, folder / "moves.json")
    return write_captures(folder / "moves.json", plant, folder, **options)  # type: ignore[arg-type]


def reasons(found: JoinResult) -> list[str]:
    return [each.why for each in found.refused]


def test_a_shaper_left_on_is_named(plan: Plan, machine: Machine, tmp_path: Path) -> None:
    on = SHAPERS["ei"](60.0, 0.1)
    once = replace(plan, repeats=1)
    found = join_captures(captured(once, machine, tmp_path, shapers=(on, None)), once, machine)
    assert not found.joined and len(found.refused) == 2
    (why,) = set(reasons(found))
    assert "x moved as EI at about 60 Hz" in why and "y moved" not in why
    assert "SET_INPUT_SHAPER SHAPER_FREQ_X=0 SHAPER_FREQ_Y=0" in why


def one_file(captures: Sequence[Path], rate_error: float) -> str:
    """Everything in one table as a phone writes it: rests, travel and all, on a clock of its own."""
    rng, parts = np.random.default_rng(3), list[NDArray[np.float64]]()
    for path in captures:
        values = np.loadtxt(path, delimiter=",", skiprows=1)[:, 1:] / 1e3
        k = np.arange(3200)
        rest = values[-50:].mean(axis=0) + rng.normal(0.0, 0.15, (3200, 3))
        rest[:, 0] += 2.0 * np.sin(2 * np.pi * 5.0 * k / 3200) * ((k > 800) & (k < 2400))  # it travels
        parts += [values, rest]
    table = np.vstack(parts)
    t = np.arange(len(table)) / 3200 * rate_error
    rows = (f"{s:.6f},{x:.4f},{y:.4f},{z:.4f}\n" for s, (x, y, z) in zip(t.tolist(), table.tolist(), strict=True))
    return "t_s,ax_m_per_s2,ay_m_per_s2,az_m_per_s2\n" + "".join(rows)


def in_order(plan: Plan, captures: Sequence[Path]) -> list[Path]:
    stems = [f"{each.name}-{repeat}" for each, repeat in plan.runs()]
    return [next(path for path in captures if path.stem.endswith(stem)) for stem in stems]


def test_one_long_capture_is_cut_at_the_experiments(
    plan: Plan, machine: Machine, captures: Sequence[Path], tmp_path: Path
) -> None:
    phone = tmp_path / "phone.csv"
    phone.write_text(one_file(in_order(plan, captures), 1.004))
    found = join_captures([phone], plan, machine)
    assert [each.name for each in found.joined] == sorted(f"{e.name}-{r}" for e, r in plan.runs())
    assert not found.refused and all(each.clock.correlation > 0.99 for each in found.joined)
    again = join_captures([phone, *captures], plan, machine)  # the same motions again: the better ones are kept
    assert len(again.joined) == 4


def rewritten(path: Path, folder: Path, turned: NDArray[np.float64]) -> Path:
    """The same capture with its rows (n, 3) times a matrix (3, 3)."""
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    table[:, 1:] = table[:, 1:] @ turned
    new = folder / path.name
    np.savetxt(new, table, "%.6f", ",", header="#time,accel_x,accel_y,accel_z", comments="")
    return new


def test_a_copy_is_no_repeat(plan: Plan, machine: Machine, captures: Sequence[Path], tmp_path: Path) -> None:
    first = next(path for path in captures if path.stem.endswith("zigzag-0-1"))
    copy = tmp_path / first.name.replace("-1.csv", "-2.csv")
    copy.write_bytes(first.read_bytes())
    found = join_captures([first, copy], plan, machine)
    assert [each.source for each in found.joined] == [str(first)]
    assert [each.file for each in found.refused] == [str(copy)]
    assert f"Its rows are those of {first.name}" in reasons(found)[0] and "--without-repeats" in reasons(found)[0]


def test_a_mirror_image_is_joined_and_named(
    plan: Plan, machine: Machine, captures: Sequence[Path], tmp_path: Path
) -> None:
    found = join_captures([rewritten(captures[0], tmp_path, np.diag([-1.0, 1.0, 1.0]))], plan, machine)
    assert found.joined[0].axes_map == "-x,y,z" and "as in a mirror" in found.remarks[-1]
    assert not any("mirror" in each for each in join_captures(captures[:1], plan, machine).remarks)


def test_of_three_repeats_the_one_that_differs_is_refused(
    plan: Plan, machine: Machine, captures: Sequence[Path], tmp_path: Path
) -> None:
    thrice = replace(plan, repeats=3)
    odd = tmp_path / captures[0].name.replace("-1.csv", "-3.csv")
    head, *rows = captures[0].read_text().splitlines()
    table = np.array([[float(x) for x in row.split(",")] for row in rows])
    table[:, 1:] = table[:, 1:].mean(axis=0) + 1.5 * (table[:, 1:] - table[:, 1:].mean(axis=0))
    odd.write_text("\n".join([head, *(f"{t:.6f},{x:.3f},{y:.3f},{z:.3f}" for t, x, y, z in table)]) + "\n")
    found = join_captures([*captures, odd], thrice, machine)
    assert len(found.joined) == 4 and [each.file for each in found.refused] == [str(odd)]
