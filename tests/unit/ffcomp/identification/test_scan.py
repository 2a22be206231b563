"""A page that an independent printer has drawn, seen by a scanner and by a phone, and what the pictures tell of it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from ffcomp.errors import MeasurementError, RequestError
from ffcomp.identification.machine_fit import ScanFit
from ffcomp.identification.page_picture import find_page, read_picture
from ffcomp.identification.request import ScanRequest
from ffcomp.identification.scanning import fit_pictures
from ffcomp.record.page import PageRequest, make_page
from ffcomp.record.plan import Experiment, Plan, save_plan
from models.file import load_machine, machine_of_text
from models.machine import Machine
from tests.support.json_page import Page
from tests.support.reference import REFERENCE
from validation.drawn_page import LEAD_S, PHONE, SCANNER, Bead, Drawing, draw, photograph, straight_player
from validation.plants.straight_plant import COREXY, Plant

PRINTER = Plant(
    motors=((1.0, 1.0), (1.0, -1.0)),
    carriage_kg=(0.42, 0.55),
    belt_n_per_m=(3e4, 3e4),
    guide_n_s_per_m=(18.0, 25.0),
)  # x rings at 60.2 Hz, y at 52.6; the file says 57 and 48
assert np.array_equal(PRINTER.motors, COREXY)


@pytest.fixture(scope="module")
def machine() -> Machine:
    return load_machine("voron-250")


@pytest.fixture(scope="module")
def plan(machine: Machine) -> Plan:
    return make_page(machine, PageRequest())


@pytest.fixture(scope="module")
def drawings(plan: Plan) -> list[Drawing]:
    return draw(plan, straight_player(PRINTER), Bead(), seed=1)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, plan: Plan, drawings: list[Drawing]) -> Path:
    folder = tmp_path_factory.mktemp("scan")
    save_plan(plan, folder / "page.json")
    for name, camera in (("scan", SCANNER), ("phone", PHONE)):
        Image.fromarray(photograph(drawings, camera, seed=2)).save(folder / f"{name}.jpg", quality=camera.quality)
    Image.open(folder / "phone.jpg").reduce(2).save(folder / "half.png")  # enough to find a page
    return folder


def fitted(machine: Machine, folder: Path, *pictures: str) -> ScanFit:
    request = ScanRequest(
        pictures=tuple(folder / name for name in pictures), plan=folder / "page.json", machine=machine.path
    )
    return fit_pictures(machine, request)


@pytest.mark.slow
@pytest.mark.parametrize("picture", ["scan.jpg", "phone.jpg"])
def test_a_picture_tells_frequencies_and_damping(machine: Machine, folder: Path, picture: str) -> None:
    fit = fitted(machine, folder, picture)
    written = machine_of_text(fit.text, "scanned")
    page = Page(REFERENCE / "json.md")
    assert page.problems(json.loads(json.dumps(fit.to_dict())), "ffcomp-identify-scan/1") == []
    assert [key for key in page.not_met("ffcomp-identify-scan/1") if not key.startswith("MACHINE ")] == []
    for axis, name in enumerate("xy"):
        (frequency,), (damping,), _ = PRINTER.axis_modes(axis)
        f, d = (fit.result.estimates[f"axes.{name}.{key}[0]"] for key in ("frequency_hz", "damping_ratio"))
        assert f.value == pytest.approx(frequency, rel=0.01 if picture == "scan.jpg" else 0.02)
        assert d.value == pytest.approx(damping, rel=0.15)
        assert abs(f.value - frequency) < 3 * f.sd and abs(d.value - damping) < 3 * d.sd
        assert written.vibration.value(f"axes.{name}.frequency_hz[0]") == pytest.approx(frequency, rel=0.02)
        assert written.uncertainty[f"axes.{name}.frequency_hz"] < 0.02


def test_the_page_is_found_to_a_fraction_of_a_line(folder: Path, plan: Plan) -> None:
    """The phone's, which looks from aside through a lens; the frequencies of both tell that the scan's is found."""
    sight = find_page(read_picture(folder / "phone.jpg"), plan)
    assert len(sight.discs) == 10 and sight.misfit_mm < 0.03


Spoil = Callable[[NDArray[np.uint8]], NDArray[np.uint8]]
SPOILED: dict[str, tuple[Spoil, str]] = {
    "mirrored": (lambda picture: picture[:, ::-1], "mirrored"),
    "empty": (lambda picture: np.full_like(picture, 230), "0 of the page's 10 discs"),
    "a corner of it": (lambda picture: picture[: len(picture) // 3, : len(picture) // 2], "discs"),
    "two pages": (lambda picture: np.concatenate([picture, picture]), "two pages"),
    "too small": (lambda picture: picture[::3, ::3], "pixels a mm"),
    "tiny": (lambda picture: picture[::15, ::15], "too few"),
}


@pytest.mark.parametrize("spoiled", SPOILED)
def test_a_bad_picture_is_refused_with_the_remedy(folder: Path, plan: Plan, tmp_path: Path, spoiled: str) -> None:
    spoil, words = SPOILED[spoiled]
    picture = spoil(np.asarray(Image.open(folder / "half.png")))
    Image.fromarray(np.ascontiguousarray(picture)).save(tmp_path / "bad.png")
    with pytest.raises(MeasurementError, match=words):
        find_page(read_picture(tmp_path / "bad.png"), plan)


def test_a_turned_colour_picture_is_as_good(folder: Path, plan: Plan, tmp_path: Path) -> None:
    grey = Image.open(folder / "half.png").rotate(90, expand=True)
    Image.merge("RGB", [grey, grey.point(lambda v: 120 + v // 2), grey.point(lambda v: 255)]).save(tmp_path / "p.tiff")
    assert len(find_page(read_picture(tmp_path / "p.tiff"), plan).discs) == 10


def test_bright_lines_on_a_dark_bed_are_seen(folder: Path, plan: Plan, tmp_path: Path) -> None:
    Image.open(folder / "half.png").point(lambda v: 255 - v).save(tmp_path / "dark.png")
    assert len(find_page(read_picture(tmp_path / "dark.png"), plan).discs) == 10


def test_a_file_cut_off_and_a_file_of_text_are_refused(folder: Path, tmp_path: Path) -> None:
    whole = (folder / "phone.jpg").read_bytes()
    (tmp_path / "cut.jpg").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "text.jpg").write_text("no picture")
    with pytest.raises(MeasurementError, match="not complete"):
        read_picture(tmp_path / "cut.jpg")
    with pytest.raises(MeasurementError, match="JPEG, PNG or TIFF"):
        read_picture(tmp_path / "text.jpg")


def test_the_page_of_another_seed_or_machine_is_refused(folder: Path, machine: Machine, tmp_path: Path) -> None:
    other = make_page(machine, PageRequest(seed=2))
    with pytest.raises(MeasurementError, match="another plan"):
        find_page(read_picture(folder / "half.png"), other)
    with pytest.raises(RequestError, match="give the machine that the page was planned for"):
        fitted(load_machine("ender-3"), folder, "half.png")


@pytest.mark.slow
def test_a_page_drawn_with_a_shaper_on_is_refused(machine: Machine, plan: Plan, tmp_path: Path) -> None:

    def obedient(experiment: Experiment, step_s: float) -> NDArray[np.float64]:
        times = step_s * np.arange(int((experiment.duration_s + LEAD_S) / step_s) + 1, dtype=np.float64) - LEAD_S
        return experiment.motion.nozzle(times)[:, :2]

    drawn = draw(plan, obedient, Bead(), seed=1)
    save_plan(plan, tmp_path / "page.json")
    Image.fromarray(photograph(drawn, PHONE, seed=2)).save(tmp_path / "phone.jpg")
    with pytest.raises(MeasurementError, match="shaper"):
        fitted(machine, tmp_path, "phone.jpg")
