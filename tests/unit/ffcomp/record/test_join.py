"""Captures on the clock of their command: how exact, with what hidden, and what is refused.

The printer is the independent plant with 120 g or 3 N that the machine file does not know; the chips are as owners have
them: turned, tilted by 2°, with counts of 3.9 mg, noise of 0.15 m/s², gravity, and clocks that are 1 % off."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from ffcomp.diagnosis.verb import measure_gap
from ffcomp.errors import MeasurementError
from ffcomp.record.axes import turn_of
from ffcomp.record.join import join_captures
from ffcomp.record.moves import Request, make_plan
from ffcomp.record.plan import Plan, save_plan
from ffcomp.record.planning import ExcitationRequest, make_excitation_plan
from ffcomp.record.result import JoinResult
from models.file import load_machine
from models.machine import Machine
from tests.support.recordings import write_captures
from tests.support.straight_printer import as_captures, machine_text
from validation.plants import delta_plant
from validation.plants.accelerometer import Chip, draw_chip, klipper_capture, nozzle_felt, reprapfirmware_capture

TURNED = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])  # chip from printer: x,y,z → -y,z,-x
KINDS = {"zigzag", "reversals"}


@dataclass(frozen=True, eq=False)
class Bench:
    """A printer with something hidden, and what its sensor recorded."""

    folder: Path
    plan: Plan
    machine: Machine
    chip: Chip
    felt: dict[str, CubicSpline]
    begin: dict[str, float]  # print time at which each Klipper capture was asked for
    first: dict[str, float]  # experiment's time of each RepRapFirmware capture's first row

    def paths(self, kind: str) -> list[Path]:
        return sorted((self.folder / kind).glob("*.csv"))


def short_plan(machine: Machine) -> Plan:
    plan = make_plan(machine, Request(seconds=2.5, places_mm=[machine.kinematics.centre_mm]))
    return replace(plan, experiments=tuple(each for each in plan.experiments if each.kind in KINDS))


@pytest.fixture(scope="module")
def bench_of(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Bench]:
    return cache(lambda what: recorded(what, tmp_path_factory.mktemp("captures")))


@pytest.fixture(scope="module", params=["120 g", "3 N"])
def either(request: pytest.FixtureRequest, bench_of: Callable[[str], Bench]) -> Bench:
    return bench_of(request.param)


@pytest.fixture(scope="module")
def bench(bench_of: Callable[[str], Bench]) -> Bench:
    return bench_of("3 N")


def recorded(what: str, folder: Path) -> Bench:
    machine = load_machine("mp-delta-pro")
    hidden = {**delta_plant.load_machine(machine.path), "effects": {}}
    if what == "120 g":
        hidden["effector"] = {**hidden["effector"], "nozzle_mass_kg": hidden["effector"]["nozzle_mass_kg"] + 0.12}
    else:
        hidden["towers"] = {"friction_n": [3.0] * 3, "stiction": 0.3}
    rng = np.random.default_rng(7)
    plan, chip = short_plan(machine), draw_chip(rng, TURNED)
    felt = {e.name: nozzle_felt(hidden, e.motion.nozzle, -1.2, e.duration_s + 0.8) for e in plan.experiments}
    made = Bench(folder, plan, machine, chip, felt, {}, {})
    for kind in ("klipper", "free"):
        (folder / kind).mkdir()
    for each, repeat in plan.runs():
        name, end = f"{each.name}-{repeat}", each.duration_s + 0.5
        made.begin[name] = float(rng.uniform(300, 400))
        text = klipper_capture(felt[each.name], chip, -1.0, end, made.begin[name], rng)
        (folder / "klipper" / f"adxl345-{name}.csv").write_text(text)
        text, made.first[name] = reprapfirmware_capture(felt[each.name], chip, -1.0, end, rng)
        (folder / "free" / f"{name}.csv").write_text(text)
    return made


@cache
def joined(bench: Bench) -> JoinResult:
    return join_captures(bench.paths("klipper"), bench.plan, bench.machine)


@pytest.fixture
def klipper(bench: Bench) -> JoinResult:
    return joined(bench)


def test_klippers_captures_are_joined_within_a_tenth_of_a_millisecond(either: Bench) -> None:
    assert [each.name for each in joined(either).joined] == sorted(either.begin) and not joined(either).refused
    for each in joined(either).joined:
        first = float(Path(each.source).read_text().splitlines()[1].split(",")[0])
        truth = first - either.begin[each.name] - 1.0
        assert abs(each.clock.offset_s - truth) < 1e-4
        assert each.clock.ratio == 1.0 and each.clock.correlation > 0.99
        assert abs(each.clock.offset_s - truth) < 3 * each.clock.offset_sd_s


def test_a_free_clock_is_aligned_within_three_tenths(either: Bench) -> None:
    found = join_captures(either.paths("free"), either.plan, either.machine)
    assert len(found.joined) == 4 and not found.refused
    for each in found.joined:
        lines = Path(each.source).read_text().splitlines()
        count, stated = len(lines) - 2, float(lines[-1].split()[1].rstrip(","))
        middle = 0.5 * (count - 1)
        truth = either.first[each.name] + middle / either.chip.rate_hz
        assert abs(each.clock.offset_s + each.clock.ratio * middle / stated - truth) < 3e-4
        assert each.clock.ratio == pytest.approx(stated / either.chip.rate_hz, abs=2e-4)
        assert abs(each.clock.ratio - 1.0) < 5e-3


def one(bench: Bench) -> Path:
    return bench.paths("klipper")[0]


def refused(bench: Bench, path: Path, turn: str | None = None) -> str:
    found = join_captures([path], bench.plan, bench.machine, turn_of(turn))
    assert not found.joined and found.refused[0].file == str(path)
    with pytest.raises(MeasurementError, match="^" + re.escape(f"{path}: ")):
        found.check()
    return " ".join(each.why for each in found.refused)


def test_periodic_excitations_of_several_towers_need_the_names_of_their_captures(bench: Bench) -> None:
    """Each tower is excited in the same way, and a sensor that is turned shows one as the other."""
    periodic = make_excitation_plan(bench.machine, ExcitationRequest(period_s=2.0, periods=2))
    found = join_captures([one(bench)], periodic, bench.machine)
    assert not found.joined and "Name the capture after its experiment" in found.refused[0].why


def test_a_capture_of_another_motion_is_refused(bench: Bench, tmp_path: Path) -> None:
    other = next(path for path in bench.paths("klipper") if "zigzag" in path.name)
    path = tmp_path / one(bench).name
    assert "zigzag" not in path.name
    path.write_bytes(other.read_bytes())
    assert "does not fit the motion of ffcomp-reversals-0 below 20 Hz" in refused(bench, path)


def test_a_speed_override_is_refused(bench: Bench, tmp_path: Path) -> None:
    head, *rows = one(bench).read_text().splitlines()
    start = float(rows[0].split(",")[0])
    slower = [f"{start + 1.004 * (float(r.split(',', 1)[0]) - start):.6f},{r.split(',', 1)[1]}" for r in rows]
    path = tmp_path / one(bench).name
    path.write_text("\n".join([head, *slower]) + "\n")
    why = refused(bench, path)
    assert "begins" in why or "does not fit" in why, why


Spoil = Callable[[np.ndarray, int], np.ndarray]  # rows (n, 4) s and mm/s², and which repeat they are of
G = 9806.65
SPOILED: dict[str, tuple[Spoil, int, str]] = {  # how many captures of four are joined, and what is said of the others
    "range of 1 g": (lambda rows, _: np.clip(rows, [0, -G, -G, -G], [1e9, G, G, G]), 0, "it is clipped. Measure"),
    "range misread": (lambda rows, _: rows * [1.0, 0.5, 0.5, 0.5], 0, "its numbers are 0.5 times as large as they"),
    "one in g": (lambda rows, k: rows / ([1, G, G, G] if k == 1 else 1), 2, "in a unit other than the file format's?"),
    "turned": (lambda rows, k: rows[:, [0, 2, 1, 3] if k == 2 else [0, 1, 2, 3]], 2, "correlation 0.71, and 0.9 is"),
    "y for z": (lambda rows, _: rows[:, [0, 1, 2, 2]], 0, "The columns of y and z are the same in every row"),
    "cut": (lambda rows, _: rows[: len(rows) * 6 // 10], 0, "it must begin 0.2 s before and end after it."),
    "rows lost": (lambda rows, _: rows[np.arange(len(rows)) % 12 > 0], 0, "8.3% of its rows are missing"),
    "##overflows=12\n": (lambda rows, _: rows, 0, "The chip lost samples (12 overflows or drops)"),
}


@pytest.mark.parametrize("name", SPOILED)
def test_a_spoiled_capture_is_refused_with_its_remedy(name: str, bench: Bench, tmp_path: Path) -> None:
    spoil, count, words = SPOILED[name]
    head = f"{name if name.startswith('##') else ''}#time,accel_x,accel_y,accel_z"
    for path in bench.paths("klipper"):
        rows = spoil(np.loadtxt(path, delimiter=",", skiprows=1), int(path.stem[-1]))
        np.savetxt(tmp_path / path.name, rows, "%.6f", ",", header=head, comments="")
    found = join_captures(sorted(tmp_path.iterdir()), bench.plan, bench.machine)
    assert len(found.joined) == count and all(words in each.why for each in found.refused), found.refused


def test_straight_axes_are_joined_too(tmp_path: Path) -> None:
    machine = load_machine("ender-3")
    plan = short_plan(machine)
    save_plan(plan, tmp_path / "moves.json")
    captures = write_captures(tmp_path / "moves.json", machine, tmp_path, axes=np.diag([-1.0, -1.0, 1.0]))
    found = join_captures(captures, plan, machine)
    assert len(found.joined) == 4 and found.joined[0].axes_map == "-x,-y,z"
    assert {name for each in found.recordings for name in each.inputs} == {"cmd_x", "cmd_y", "cmd_z"}


# ---- chips ----


Joins = Callable[[bool, bool], JoinResult]


@pytest.fixture(scope="module")
def bench_of_chips(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Path], Plan, Machine]:
    folder = tmp_path_factory.mktemp("slinger")
    (folder / "box.toml").write_text(machine_text(), encoding="utf-8")
    machine = load_machine(folder / "box.toml")
    plan = make_plan(machine, Request(seconds=2.0, places_mm=[(0.0, 0.0)], kinds=("zigzag", "reversals")))
    return as_captures(folder / "captures", plan), plan, machine


@pytest.fixture(scope="module")
def joined_of_chips(bench_of_chips: tuple[list[Path], Plan, Machine]) -> Joins:
    """Joins the captures of the bed's chip, the head's, or of both."""
    captures, plan, machine = bench_of_chips

    @cache
    def of(bed: bool, head: bool) -> JoinResult:
        return join_captures([p for p in captures if (bed if "-bed-" in p.name else head)], plan, machine)

    return of


def test_each_axis_comes_from_the_chip_that_feels_it(
    bench_of_chips: tuple[list[Path], Plan, Machine], joined_of_chips: Joins
) -> None:
    found = joined_of_chips(True, True)
    assert len(found.joined) == 4 and not found.refused
    assert all(min(each.felt[:2]) > 0.9 for each in found.joined)
    gap = measure_gap(bench_of_chips[2], found.recordings).residual.total
    assert gap.nrms == pytest.approx(gap.noise_nrms, rel=0.5)
    # each chip has a clock of its own: the run says which columns are of one
    columns = [tuple(recording.acceleration) for recording in found.recordings]
    assert all(
        [own != "" for own in recording.clocks_of(names)].count(True) in (1, 2)
        and recording.clocks_of(("acc_x",)) != recording.clocks_of(("acc_y",))
        for recording, names in zip(found.recordings, columns, strict=True)
    )
    assert all("clocks" not in each.comments for each in joined_of_chips(False, True).recordings)


def test_an_axis_that_no_chip_feels_is_left_out_and_said(
    bench_of_chips: tuple[list[Path], Plan, Machine], joined_of_chips: Joins
) -> None:
    for chip, missing in (("head", "y"), ("bed", "x")):
        found = joined_of_chips(chip == "bed", chip == "head")
        assert all(
            set(each.acceleration) == {"acc_x", "acc_y", "acc_z"} - {f"acc_{missing}"} for each in found.recordings
        )
        assert any(f"No chip feels the motion along {missing}" in sentence for sentence in found.remarks)
        gap = measure_gap(bench_of_chips[2], found.recordings).residual.total
        assert gap.nrms == pytest.approx(gap.noise_nrms, rel=0.5)


def test_a_run_without_the_beds_capture_does_not_say_that_the_bed_rests(
    bench_of_chips: tuple[list[Path], Plan, Machine],
) -> None:
    captures, plan, machine = bench_of_chips
    missing = next(p for p in captures if "-bed-" in p.name and "zigzag" in p.name and p.stem.endswith("-1"))
    found = join_captures([p for p in captures if p != missing], plan, machine)
    assert len(found.joined) == 3
    assert not any("zigzag" in each.name and each.name.endswith("1") for each in found.joined)
    assert any("feels y is missing" in sentence for sentence in found.remarks)
