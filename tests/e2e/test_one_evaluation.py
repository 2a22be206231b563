"""One print has one number: on the terminal, as JSON, on the page, in `show` and on its picture."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from ffcomp.numerics.digits import um
from ffcomp.report.show import show_figure
from ffcomp.result import Answer
from ffcomp.serve.answers import answer_of
from ffcomp.simulation.forecast import NO_FORECAST, forecast_in
from ffcomp.simulation.preview import preview
from gcode.embedded import already_processed, find_offset
from models.file import load_machine
from tests.support.cli import ffcomp
from tests.support.configs import Delta, written
from tests.support.prints import squares

KEYS = ("predicted", "predicted_over_s", "expected", "verdict")


@pytest.fixture(scope="module")
def print_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A print beyond the length of what is simulated on every printer."""
    path = tmp_path_factory.mktemp("one") / "print.gcode"
    path.write_bytes(squares(layers=12))
    return path


def drawn(target: Path, name: str) -> str:
    """What stands above the picture that `show` draws of a file."""
    data, machine = target.read_bytes(), load_machine(name)
    stamp = already_processed(data)
    assert stamp is not None
    seen = preview(data, str(target), machine, find_offset(data), stamp.flavor)
    forecast, _ = forecast_in(data, stamp, machine, lambda: NO_FORECAST)
    return str(show_figure(seen, forecast, "a print").get_suptitle())


def test_every_surface_states_the_same_numbers(print_file: Path) -> None:
    target = print_file.with_name("out.gcode")
    call = ("compensate", print_file, "-m", "mp-delta-pro", "--flavor", "klipper", "-o", target)
    done, people = ffcomp(*call, "--json"), ffcomp(*call)
    shown = ffcomp("show", target, "--json")
    assert done.exit_code == shown.exit_code == 0, done.stderr + shown.stderr
    made, seen = json.loads(done.stdout), json.loads(shown.stdout)
    assert [made[key] for key in KEYS] == [seen[key] for key in KEYS] and seen["source"] == "file"
    headline, verdict = made["expected"]["headline"], made["verdict"]
    exact = verdict.removeprefix("If the machine file is exact: ")
    page = answer_of(made)
    assert page.headline == headline and ("If the machine file is exact", exact) in page.facts
    terminal = " ".join(people.stdout.split())
    assert headline in terminal and exact in terminal
    assert seen["answer"]["headline"] == headline and ["If the machine file is exact", exact] in seen["answer"]["facts"]
    picture = drawn(target, "mp-delta-pro")
    picture = picture.replace("\n", " ")
    assert headline in picture and verdict in picture
    assert all(um(track["contour_rms_um"]) in exact for track in made["predicted"].values())
    assert all(um(made["expected"][f"{way}_um"]) in headline for way in made["predicted"])


def test_a_file_without_its_numbers_is_evaluated_and_says_so(print_file: Path) -> None:
    target = print_file.with_name("unpredicted.gcode")
    done = ffcomp("compensate", print_file, "-m", "mp-delta-pro", "--flavor", "klipper", "-o", target, "--no-predict")
    shown = ffcomp("show", target)
    assert done.exit_code == shown.exit_code == 0, done.stderr + shown.stderr
    assert "The file contains no prediction for this machine; these errors were computed now." in shown.stdout
    assert b"; ffcomp forecast=" not in target.read_bytes() and "times less" in shown.stdout


# ---- one answer ----


SQUARE = b"G28\nG90\nM83\nG1 X10 Y0 Z20 F6000\nG1 X20 Y0 E.3\nG1 X20 Y10 E.3\nG1 X10 Y10 E.3\nG1 X10 Y0 E.3\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "print.gcode").write_bytes(SQUARE)
    written(tmp_path, Delta().klipper(), "printer.cfg")
    return tmp_path


@pytest.mark.parametrize(
    "words",
    [
        "machines list",
        "machines show ender-3",
        "machines check mp-delta-pro-as-printed",
        "machines diff mp-delta-pro kossel",
        "machines import printer.cfg -o imported.toml",
        "frf -m mp-delta-pro --at 0,0 --at -80,0",
        "estimate print.gcode -m mp-delta-pro --layers",
        "estimate print.gcode print.gcode -m mp-delta-pro",
        "record plan -m mp-delta-pro -o moves.gcode --seconds 2 --at 0,0",
        "record plan --for scan -m ender-3 -o page.gcode",
        "identify ringing --x-hz 48 --y-hz 37 -m ender-3 -o better.toml",
    ],
)
def test_the_terminal_prints_the_answer_of_the_object(words: str, folder: Path) -> None:
    printed = ffcomp(*words.split(), "-q", cwd=folder)
    for made in ("imported.toml", "better.toml"):
        (folder / made).unlink(missing_ok=True)
    objects = [json.loads(line) for line in ffcomp(*words.split(), "--json", cwd=folder).stdout.splitlines()]
    assert printed.exit_code == 0, printed.output
    assert {each["schema"].partition("/")[2] for each in objects} == {"1"}
    assert list(Answer(**objects[0]["answer"]).lines()) == printed.stdout.splitlines()
    assert objects[0]["answer"]["headline"] and len(printed.stdout.splitlines()) > 1
