"""A page that an independent printer has drawn, seen by a scanner and by a phone, and what the pictures tell of it.

To be cheap, the page is the first cell of one, seen at 300 dpi.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image, ImageFilter

from ffcomp.errors import MeasurementError, RequestError
from ffcomp.identification.machine_fit import Origin
from ffcomp.identification.page.fit import _swept, fit_page
from ffcomp.identification.page.lines import ENDS_MM, STEP_MM, ReadLine, read_lines
from ffcomp.identification.page.picture import find_page, read_picture
from ffcomp.identification.page.scan import ScanFit, _advice, _file_text, fit_pictures
from ffcomp.identification.request import ScanRequest
from ffcomp.record.page import DISC, PageRequest, discs_of, last_line, make_page, twins
from ffcomp.record.plan import Plan, save_plan
from models.file import load_machine, machine_of_text
from models.machine import Machine, with_values
from tests.support.surfaces import headlines
from validation.drawn_page import LEAD_S, SCANNER, Bead, Conditions, Drawing, draw, photograph, straight_player, zv
from validation.plants.straight_plant import COREXY, Plant

PRINTER = Plant(
    motors=((1.0, 1.0), (1.0, -1.0)),
    carriage_kg=(0.42, 0.55),
    belt_n_per_m=(3e4, 3e4),
    guide_n_s_per_m=(18.0, 25.0),
    friction_n=(0.0, 0.4),
    bristle_n_per_m=8e4,
)  # x rings at 60.2 Hz, y at 52.6; the file says 57 and 48
assert np.array_equal(PRINTER.motors, COREXY)
STIFF = Plant(
    motors=((1.0, 1.0), (1.0, -1.0)),
    carriage_kg=(0.2, 0.58),
    tool_kg=(0.0, 0.42),
    belt_n_per_m=(24_080.0, 24_080.0),
    mount_n_per_m=(0.0, 53_000.0),
    mount_n_s_per_m=(0.0, 19.0),
    guide_n_s_per_m=(5.9, 22.0),
    belt_n_s_per_m=(1.27, 1.27),
    friction_n=(0.243, 0.222),
    bristle_n_per_m=36_000.0,
)  # x rings at 78.1 Hz, y at 32.0 and 81.4
QUICK = replace(
    PRINTER, carriage_kg=(0.4, 0.33), guide_n_s_per_m=(13.0, 16.0), friction_n=(0.14, 0.1), bristle_n_per_m=2e4
)
TWO_MASSES = Plant(
    carriage_kg=(0.375, 0.6),
    tool_kg=(0.125, 0.0),
    belt_n_per_m=(53_400.0, 45_900.0),
    mount_n_per_m=(22_550.0, 1.0),
    mount_n_s_per_m=(5.3, 0.0),
    guide_n_s_per_m=(19.6, 19.9),
    friction_n=(0.12, 0.1),
    bristle_n_per_m=6e4,
)  # x rings at 46.9 and 86.6 Hz, y at 44.0
COARSE = replace(SCANNER, dpi=300.0, dust=50, margin_mm=6.0)


@pytest.fixture(scope="module")
def machine() -> Machine:
    return load_machine("voron-250")


@pytest.fixture(scope="module")
def plan(machine: Machine) -> Plan:
    whole = make_page(machine, PageRequest())
    return replace(whole, experiments=tuple(each for each in whole.experiments if each.kind == DISC or each.place == 0))


@pytest.fixture(scope="module")
def drawings(plan: Plan) -> list[Drawing]:
    return draw(plan, straight_player(PRINTER), Bead(), seed=1)


@pytest.fixture(scope="module")
def scan(drawings: list[Drawing]) -> NDArray[np.uint8]:
    return photograph(drawings, COARSE, seed=2)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, plan: Plan, scan: NDArray[np.uint8]) -> Path:
    folder = tmp_path_factory.mktemp("scan")
    save_plan(plan, folder / "page.json")
    Image.fromarray(scan).save(folder / "scan.jpg", quality=92)
    wide = round(0.58 * scan.shape[1])
    Image.fromarray(scan[:, :wide]).save(folder / "left.jpg", quality=92)
    Image.fromarray(scan[:, -wide:]).save(folder / "right.jpg", quality=92)
    return folder


def fitted(machine: Machine, folder: Path, *pictures: str) -> ScanFit:
    request = ScanRequest(
        pictures=tuple(folder / name for name in pictures), plan=folder / "page.json", machine=machine.path
    )
    return fit_pictures(machine, request)


def test_a_picture_tells_frequencies_and_damping(machine: Machine, folder: Path) -> None:
    fit = fitted(machine, folder, "left.jpg", "right.jpg")  # overlapping pictures are joined
    assert len({line.stroke.name for line in fit.result.lines}) == 10 < len(fit.result.lines) < 20
    written = machine_of_text(fit.text, "scanned")
    assert json.loads(json.dumps(fit.to_dict()))["schema"] == "ffcomp-identify-scan/1"
    for axis, name in enumerate("xy"):
        (frequency,), (damping,), _ = PRINTER.axis_modes(axis)
        f, d = (fit.result.estimates[f"axes.{name}.{key}[0]"] for key in ("frequency_hz", "damping_ratio"))
        # five strokes a direction, of the twenty of a page
        assert f.value == pytest.approx(frequency, rel=0.025)
        assert abs(np.log(d.value / damping)) < 0.35
        assert abs(f.value - frequency) < 3 * f.sd < 0.05 * frequency
        assert abs(np.log(d.value / damping)) < 3 * d.relative_sd < 0.9  # of a quarter of a page
        assert written.vibration.value(f"axes.{name}.frequency_hz[0]") == pytest.approx(f.value, rel=1e-3)
        assert written.uncertainty[f"axes.{name}.frequency_hz"] < 0.02
    rubbing, dry = written.effects["coulomb_friction"], fit.result.bead["friction_b"]
    assert 0.0 < dry.low < 0.4 / 0.55 < dry.high  # per kilogram, for nobody knows the masses
    assert rubbing["force_n"][1] == pytest.approx(dry.value, rel=0.01) and rubbing["force_n"][0] < 0.15
    assert 0.001 < rubbing["presliding_mm"] < 0.02
    fit.write_report(folder / "report.html")
    said, _ = headlines(fit, folder / "report.html")
    assert len(set(said)) == 1 and said[0]
    assert all(each.startswith("The picture hardly determines") for each in fit.advice)
    warning, *_ = _advice(with_values(machine, {"axes.x.frequency_hz[0]": 35.0}), fit.result)
    assert warning.startswith("axes.x.frequency_hz[0]: further from") and "another printer of the same kind" in warning


def lines_as_drawn(plan: Plan, plant: Plant, bead: Bead, seed: int) -> list[ReadLine]:
    """Read a plan's strokes without a picture: the middle between the edges of what the plant draws, with noise."""
    rng, pairs = np.random.default_rng(seed), twins(plan)
    strokes = replace(plan, experiments=tuple(stroke for stroke, _ in pairs))
    lines = []
    for stroke, drawn in zip(strokes.experiments, draw(strokes, straight_player(plant), bead, seed), strict=True):
        line = last_line(stroke.motion)
        s = np.arange(ENDS_MM[0], line.length_mm - ENDS_MM[1], STEP_MM)
        away = drawn.points_mm - line.foot
        middle = _swept(np.column_stack([away @ line.along, away @ line.across]), drawn.width_mm / 2, s[0], len(s), 0.1)
        lines.append(ReadLine(stroke, line, s, middle + 0.003 * rng.standard_normal(len(s)), "page"))
    return lines


@pytest.mark.parametrize(
    ("printer", "bead", "axes"),
    [
        # x rings at 78.1 Hz with much friction where the file says 57: at 50 Hz the lines look more alike at first
        (STIFF, Bead(pressure_s=0.004), "x"),
        # waves that end after 5 mm of 25, on rough lines: roughness is no wave that the machine fails to explain
        (QUICK, Bead(drag_mm=0.28, bore_mm=0.34, rough_mm=0.01, rough_length_mm=0.28), "xy"),
    ],
)
def test_two_cells_tell_frequencies_far_from_the_file(machine: Machine, printer: Plant, bead: Bead, axes: str) -> None:
    plan = make_page(machine, PageRequest())
    cells = replace(plan, experiments=tuple(each for each in plan.experiments if each.place < 2))
    lines = [
        each for each in lines_as_drawn(cells, printer, bead, 5004) if abs(each.line.across[0]) > 0.5 or "y" in axes
    ]
    fit = fit_page(machine, lines, 0.45)
    for axis, name in enumerate(axes):
        frequency = fit.estimates[f"axes.{name}.frequency_hz[0]"]
        assert frequency.value == pytest.approx(printer.axis_modes(axis)[0][0], rel=0.02)
        assert frequency.relative_sd < 0.02
    assert fit.explained > 0.93  # by the calm halves of the rough lines, which are also the less rough ones: 0.916


def test_a_strong_second_mode_is_written_and_none_where_there_is_none() -> None:
    """Taken for more ringing of the first mode, it lowered the first one's damping by 28 %."""
    machine, plan = load_machine("ender-3"), make_page(load_machine("ender-3"), PageRequest())
    cells = replace(plan, experiments=tuple(each for each in plan.experiments if each.place < 1))
    fit = fit_page(machine, lines_as_drawn(cells, TWO_MASSES, Bead(rough_mm=0.004), 0), 0.45)
    assert fit.second == ["x"]
    hz, dampings, (_, share) = TWO_MASSES.axis_modes(0)
    for i in range(2):
        assert fit.estimates[f"axes.x.frequency_hz[{i}]"].value == pytest.approx(hz[i], rel=0.02)
        assert fit.estimates[f"axes.x.damping_ratio[{i}]"].value == pytest.approx(dampings[i], rel=0.15)
    assert fit.estimates["axes.x.share[1]"].value == pytest.approx(share, abs=0.06)
    (y,), (damping,), _ = TWO_MASSES.axis_modes(1)
    assert fit.estimates["axes.y.damping_ratio[0]"].value == pytest.approx(damping, rel=0.15)
    written = machine_of_text(_file_text(Origin(machine, "scanned"), fit), "scanned")
    expected = sorted([y, *hz])
    assert written.vibration.modes_at(np.zeros(2)).frequencies_hz == pytest.approx(expected, rel=0.02)


Spoil = Callable[[NDArray[np.uint8]], NDArray[np.uint8]]
SPOILED: dict[str, tuple[Spoil, str]] = {
    "mirrored": (lambda picture: picture[:, ::-1], "mirrored"),
    "a corner of it": (lambda picture: picture[: len(picture) // 3, : picture.shape[1] // 2], "discs"),
    "too small": (lambda picture: picture[::3, ::3], "pixels a mm"),
}


@pytest.mark.parametrize("spoiled", SPOILED)
def test_a_bad_picture_is_refused_with_the_remedy(
    scan: NDArray[np.uint8], plan: Plan, tmp_path: Path, spoiled: str
) -> None:
    spoil, words = SPOILED[spoiled]
    Image.fromarray(np.ascontiguousarray(spoil(scan))).save(tmp_path / "bad.png", compress_level=1)
    with pytest.raises(MeasurementError, match=words):
        find_page(read_picture(tmp_path / "bad.png"), plan)


def test_a_blurred_picture_is_refused(scan: NDArray[np.uint8], plan: Plan, tmp_path: Path) -> None:
    Image.fromarray(scan).filter(ImageFilter.GaussianBlur(8)).save(tmp_path / "blurred.png", compress_level=1)
    with pytest.raises(MeasurementError, match=r"0 of 10 strokes can be read: .* blurred"):
        read_lines([find_page(read_picture(tmp_path / "blurred.png"), plan)], plan)


def test_a_picture_may_be_turned_coloured_bright_on_dark_or_lack_a_corner(
    scan: NDArray[np.uint8], plan: Plan, tmp_path: Path
) -> None:
    grey = Image.fromarray(255 - scan).rotate(90, expand=True)
    Image.merge("RGB", [grey, grey.point(lambda v: 120 + v // 2), grey.point(lambda v: 255)]).save(tmp_path / "p.tiff")
    sight = find_page(read_picture(tmp_path / "p.tiff"), plan)
    assert len(sight.disc_mm) == 10 and sight.misfit_mm < 0.03
    without = scan.copy()
    row, column = np.rint(_pixels(scan, plan, tmp_path)[0]).astype(int)[::-1]
    without[max(0, row - 60) : row + 60, max(0, column - 60) : column + 60] = 230
    Image.fromarray(without).save(tmp_path / "corner.png", compress_level=1)
    assert len(find_page(read_picture(tmp_path / "corner.png"), plan).disc_mm) == 9


def _pixels(scan: NDArray[np.uint8], plan: Plan, tmp_path: Path) -> NDArray[np.float64]:
    Image.fromarray(scan).save(tmp_path / "whole.png", compress_level=1)
    return find_page(read_picture(tmp_path / "whole.png"), plan).pixels(discs_of(plan))


def test_blots_at_the_ends_of_lines_are_no_discs(machine: Machine, plan: Plan, tmp_path: Path) -> None:
    """Without pressure advance lines end in blots of one size, more of them than there are discs."""
    blotted = photograph(draw(plan, commanded, Bead(pressure_s=0.03), seed=1), COARSE, seed=2)
    Image.fromarray(blotted).save(tmp_path / "blots.png", compress_level=1)
    picture = read_picture(tmp_path / "blots.png")
    sight = find_page(picture, plan)
    assert len(sight.disc_mm) == 10 and sight.misfit_mm < 0.03
    other = make_page(machine, PageRequest(seed=2))
    with pytest.raises(MeasurementError, match="of another machine"):  # and not: mirrored
        find_page(picture, other)


def test_the_page_of_another_seed_or_machine_is_refused(folder: Path, machine: Machine) -> None:
    other = make_page(machine, PageRequest(seed=2))
    with pytest.raises(MeasurementError, match="another plan"):
        find_page(read_picture(folder / "scan.jpg"), other)
    with pytest.raises(RequestError, match="give the machine that the page was planned for"):
        fitted(load_machine("ender-3"), folder, "scan.jpg")


def commanded(experiment: Any, step_s: float) -> NDArray[np.float64]:
    """Play an experiment on a printer that does not vibrate."""
    times = step_s * np.arange(int((experiment.duration_s + LEAD_S) / step_s) + 1, dtype=np.float64) - LEAD_S
    return np.asarray(experiment.motion.nozzle(times)[:, :2])


X_HZ, Y_HZ = (PRINTER.axis_modes(axis)[0][0] for axis in range(2))
CONDITIONS: dict[str, tuple[Conditions, str]] = {
    "a little slower": (Conditions(speed_factor=0.9), r"drawn at (8[6-9]|9[0-4]) % .* of its speed"),
    "shaper tuned 30 % too high": (zv((1.3 * X_HZ, 1.3 * Y_HZ)), "rings .* input shaper"),
}


@pytest.mark.parametrize("name", CONDITIONS)
def test_a_page_drawn_under_other_conditions_is_refused(
    machine: Machine, plan: Plan, tmp_path: Path, name: str
) -> None:
    conditions, words = CONDITIONS[name]
    drawn = draw(plan, straight_player(PRINTER), Bead(), seed=1, conditions=conditions)
    save_plan(plan, tmp_path / "page.json")
    Image.fromarray(photograph(drawn, COARSE, seed=2)).save(tmp_path / "scan.jpg")
    with pytest.raises(MeasurementError, match=words):
        fitted(machine, tmp_path, "scan.jpg")
