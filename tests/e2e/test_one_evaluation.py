"""One print has one number: on the terminal, as JSON, on the page, in `show` and on its picture."""

from __future__ import annotations

import json
from itertools import chain
from pathlib import Path

import numpy as np
import pytest

from ffcomp.numerics.digits import um
from ffcomp.report.show import show_figure
from ffcomp.result import Result
from ffcomp.serve.messages import answer_of
from ffcomp.simulation.forecast import NO_FORECAST, forecast_in
from ffcomp.simulation.preview import preview
from gcode.embedded import already_processed
from models.file import load_machine
from tests.support.axis import write_axis
from tests.support.cli import ffcomp
from tests.support.configs import Delta, written
from tests.support.prints import squares
from tests.support.surfaces import headlines

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
    seen = preview(data, str(target), machine)
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
VERBS = [  # in this order: a verb may read what an earlier one wrote
    "compensate print.gcode -m mp-delta-pro -o out.gcode",
    "show out.gcode -o out.svg",
    "estimate print.gcode -m mp-delta-pro --layers",
    "compare long.gcode -m mp-delta-pro --only mzv --quality-um 0",
    "simulate out.gcode -m mp-delta-pro -o run-1.csv",
    "gap run-1.csv -m mp-delta-pro",
    "frf -m mp-delta-pro --at 0,0 --at -80,0",
    "record plan -m mp-delta-pro -o moves.gcode --seconds 2 --at 0,0",
    "record plan --for scan -m ender-3 -o page.gcode",
    "identify fit resonances_x.csv -m ender-3",
    "identify ringing --x-hz 48 --y-hz 37 -m ender-3 -o better.toml",
    "machines list",
    "machines show ender-3",
    "machines check mp-delta-pro-as-printed",
    "machines import printer.cfg -o imported.toml",
    "restore out.gcode -o again.gcode",
    "record plan --for check -m ender-3 -o check.gcode",
    "simulate check.gcode -m ender-3 --as-captures captures --plan check.json --rate 3200 --flavor klipper",
    "record join captures/*.csv --plan check.json -m ender-3 --output-dir runs",
    "record check captures/*.csv --plan check.json -m ender-3",
    "identify update runs/*.csv -m ender-3 -o updated.toml",
    "diagnose push-*.csv -m slide.toml -o better-slide.toml",
]


def run(words: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> Result:
    """Run a verb in a folder, with its report; return its result in place of printing it."""
    results = list[Result]()
    monkeypatch.setattr("ffcomp.cli.command.answer", lambda result, as_json: results.append(result))
    (folder / "report.html").unlink(missing_ok=True)
    files = [sorted(map(str, folder.glob(each))) if "*" in each else [each] for each in words.split()]
    done = ffcomp(*chain.from_iterable(files), "--quiet", "--report", "report.html", cwd=folder)
    assert done.exit_code == 0, done.output
    return results[0]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("verbs")
    (folder / "print.gcode").write_bytes(SQUARE)
    (folder / "long.gcode").write_bytes(squares(layers=1))
    f = np.arange(5.0, 120.0)
    power = 1e4 / ((1 - (f / 50) ** 2) ** 2 + (0.1 * f / 50) ** 2)
    rows = np.column_stack([f, power, 0.01 * power, 0.01 * power, 1.02 * power])
    np.savetxt(folder / "resonances_x.csv", rows, delimiter=",", header="freq,psd_x,psd_y,psd_z,psd_xyz", comments="")
    written(folder, Delta().klipper(), "printer.cfg")
    write_axis(folder)
    return folder


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("words", VERBS)
def test_terminal_json_page_and_report_say_the_same(words: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patched:
        result = run(words, folder, patched)
    monkeypatch.chdir(folder)
    said, objects = headlines(result, folder / "report.html")
    assert len(set(said)) == 1 and said[0]
    assert {each["schema"].partition("/")[2] for each in objects} == {"1"}
