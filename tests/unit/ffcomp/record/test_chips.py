"""A bed slinger's two chips: one on the toolhead, which rests along y, one on the bed, which runs the other way."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

from ffcomp.diagnosis.gap import measure_gap
from ffcomp.record.join import join_captures
from ffcomp.record.moves import Request, make_plan
from ffcomp.record.plan import Plan
from ffcomp.record.result import JoinResult
from models.file import load_machine
from models.machine import Machine
from tests.support.straight_printer import as_captures, machine_text

Joins = Callable[[bool, bool], JoinResult]


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Path], Plan, Machine]:
    folder = tmp_path_factory.mktemp("slinger")
    (folder / "box.toml").write_text(machine_text(), encoding="utf-8")
    machine = load_machine(folder / "box.toml")
    plan = make_plan(machine, Request(seconds=2.0, places_mm=[(0.0, 0.0)], kinds=("zigzag", "reversals")))
    return as_captures(folder / "captures", plan), plan, machine


@pytest.fixture(scope="module")
def joined(bench: tuple[list[Path], Plan, Machine]) -> Joins:
    """Joins the captures of the bed's chip, the head's, or of both."""
    captures, plan, machine = bench

    @cache
    def of(bed: bool, head: bool) -> JoinResult:
        return join_captures([p for p in captures if (bed if "-bed-" in p.name else head)], plan, machine)

    return of


def test_each_axis_comes_from_the_chip_that_feels_it(bench: tuple[list[Path], Plan, Machine], joined: Joins) -> None:
    found = joined(True, True)
    assert len(found.joined) == 4 and not found.refused
    assert all(min(each.felt[:2]) > 0.9 for each in found.joined)
    gap = measure_gap(bench[2], found.recordings).residual.total
    assert gap.nrms == pytest.approx(gap.noise_nrms, rel=0.5)
    # each chip has a clock of its own: the run says which columns are of one
    columns = [tuple(recording.acceleration) for recording in found.recordings]
    assert all(
        [own != "" for own in recording.clocks_of(names)].count(True) in (1, 2)
        and recording.clocks_of(("acc_x",)) != recording.clocks_of(("acc_y",))
        for recording, names in zip(found.recordings, columns, strict=True)
    )
    assert all("clocks" not in each.comments for each in joined(False, True).recordings)


def test_an_axis_that_no_chip_feels_is_left_out_and_said(
    bench: tuple[list[Path], Plan, Machine], joined: Joins
) -> None:
    for chip, missing in (("head", "y"), ("bed", "x")):
        found = joined(chip == "bed", chip == "head")
        assert all(
            set(each.acceleration) == {"acc_x", "acc_y", "acc_z"} - {f"acc_{missing}"} for each in found.recordings
        )
        assert any(f"No chip feels the motion along {missing}" in sentence for sentence in found.remarks)
        gap = measure_gap(bench[2], found.recordings).residual.total
        assert gap.nrms == pytest.approx(gap.noise_nrms, rel=0.5)


def test_a_run_without_the_beds_capture_does_not_say_that_the_bed_rests(
    bench: tuple[list[Path], Plan, Machine],
) -> None:
    captures, plan, machine = bench
    missing = next(p for p in captures if "-bed-" in p.name and "zigzag" in p.name and p.stem.endswith("-1"))
    found = join_captures([p for p in captures if p != missing], plan, machine)
    assert len(found.joined) == 3
    assert not any("zigzag" in each.name and each.name.endswith("1") for each in found.joined)
    assert any("feels y is missing" in sentence for sentence in found.remarks)
