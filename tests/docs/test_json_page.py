"""docs/reference/json.md: the verbs run, and every key and type is compared with the page, in both directions."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ffcomp.cli.app import app
from ffcomp.measurement.frf_files import write_frf
from models.file import LIBRARY, load_machine
from scripts.pages import json_objects
from tests.support.axis import write_axis
from tests.support.cli import CliRunner
from tests.support.configs import COREXY, SHAPER, Delta, written
from tests.support.containers import archive_3mf
from tests.support.identification import blank, measured, paper_bench, towers_bench
from tests.support.json_page import Page
from tests.support.prints import squares
from tests.support.recordings import write_captures
from tests.support.reference import MACHINE, MACHINE_FILE, REFERENCE, ROOT, SMALL, call, examples

TRUTH = load_machine("mp-delta-pro")
pytestmark = pytest.mark.usefixtures("undrawn")


@pytest.fixture(scope="module")
def page() -> Page:
    return Page(REFERENCE / "json.md")


@pytest.fixture(scope="module")
def corexy(folder: Path) -> Path:
    """The page's own example."""
    path = folder / "corexy.toml"
    path.write_text(examples(MACHINE_FILE, "toml")[1], encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small print, compensated: small.gcode and out.gcode."""
    folder = tmp_path_factory.mktemp("reference")
    (folder / "small.gcode").write_bytes(SMALL)
    call("compensate", folder / "small.gcode", *MACHINE, "-q", "-o", folder / "out.gcode")
    return folder


def told(*arguments: object, code: int = 0) -> list[dict[str, Any]]:
    """The objects that a verb prints."""
    return [json.loads(line) for line in call(*arguments, "--json", code=code).stdout.splitlines()]


def hold(page: Page, schema: str, objects: Sequence[dict[str, Any]]) -> None:
    """Every key is on the page with its type, and every key of the page is in one of the objects."""
    for each in objects:
        assert each["schema"] == schema
        assert page.problems(each, schema) == []
    assert page.not_met(schema) == []


def test_compensate(page: Page, folder: Path) -> None:
    small, out = folder / "small.gcode", folder / "out.gcode"
    weak = _changed(
        folder / "weak.toml", "carriage_acceleration_mm_per_s2 = 30000.0", "carriage_acceleration_mm_per_s2 = 4000.0"
    )
    plates = folder / "two.gcode.3mf"
    plates.write_bytes(archive_3mf(SMALL, SMALL))
    steps = ("--kind", "klipper-steps", "--extruder-steps-per-mm", "400", "-o", folder / "small.npz")
    answers = [
        *told("compensate", small, *MACHINE, "-q", "--dry-run"),
        *told("compensate", out, *MACHINE, "-q"),
        *told("compensate", small, *MACHINE, "-q", *steps),
        *told("compensate", small, "-m", weak, "-q", "--tolerance-um", "0.1", "-o", folder / "slow.gcode"),
        *told(
            "compensate",
            small,
            *MACHINE,
            "-q",
            "--max-error-um",
            "200",
            "-o",
            folder / "quick.gcode",
        ),
        *told("compensate", plates, *MACHINE, "-q", "-o", folder / "plates.gcode.3mf"),
    ]
    hold(page, "ffcomp-compensate/1", answers)
    batch = ("compensate", out, folder / "none.gcode", *MACHINE, "-q", "--json")
    result = CliRunner().invoke(app, [*map(str, batch)])
    hold(page, "ffcomp-compensate-batch/1", [json.loads(result.stdout)])


def _changed(target: Path, old: str, new: str) -> Path:
    """A copy of the library's machine with one text replaced."""
    text = (LIBRARY / "mp-delta-pro.toml").read_text(encoding="utf-8")
    assert old in text
    target.write_text(text.replace(old, new), encoding="utf-8")
    return target


def test_estimate_show_and_simulate(page: Page, folder: Path) -> None:
    small, out = folder / "small.gcode", folder / "out.gcode"
    hold(page, "ffcomp-estimate/1", [*told("estimate", out), *told("estimate", small, *MACHINE)])
    hold(page, "ffcomp-estimate-batch/1", told("estimate", small, small, *MACHINE))
    hold(page, "ffcomp-show/1", told("show", out, "--gcode-preview", folder / "preview.gcode"))
    hold(page, "ffcomp-simulate/1", told("simulate", small, *MACHINE, "-q"))


def test_compare(page: Page, folder: Path) -> None:
    print_ = folder / "squares.gcode"
    print_.write_bytes(squares(1))
    options = ("--only", "mzv", "--quality-um", "60", "-q")
    hold(page, "ffcomp-compare/1", told("compare", print_, *MACHINE, *options))


def test_frf(page: Page, folder: Path, corexy: Path) -> None:
    files = _measured(folder, towers_bench(-80.0, 0.0, np.arange(4.0, 125.0, 4.0)))
    answers = [*told("frf", *MACHINE, "--measured", files[0]), *told("frf", *MACHINE)]
    alone = told("frf", *MACHINE, "--of", "carriage-alone", "--step-hz", "10")
    hold(page, "ffcomp-frf/1", [*answers, *alone, *told("frf", "-m", corexy, "--step-hz", "10")])


def _measured(folder: Path, bench: Any) -> list[Path]:
    """Files of a bench's responses, all by one logger."""
    files = []
    for number, response in enumerate(measured(TRUTH, bench, 40.0, 0)):
        files.append(folder / f"response-{number}.csv")
        write_frf(files[-1], replace(response, clock="logger"))
    return files


def test_gap(page: Page, folder: Path) -> None:
    call("simulate", folder / "small.gcode", *MACHINE, "-q", "-o", folder / "run.csv")
    text = (folder / "run.csv").read_text(encoding="utf-8")
    head, rows = text[: text.index("\n0.") + 1], np.loadtxt(folder / "run.csv", delimiter=",", skiprows=_head(text))
    rng = np.random.default_rng(1)
    for number in (1, 2):
        noisy = rows + np.where(np.arange(rows.shape[1]) > 3, rng.normal(0, 0.05, rows.shape), 0.0)
        with (folder / f"run-{number}.csv").open("w", encoding="utf-8") as file:
            file.write(head)
            np.savetxt(file, noisy, fmt="%.6f", delimiter=",")
    hold(page, "ffcomp-gap/1", told("gap", folder / "run-1.csv", folder / "run-2.csv", *MACHINE))


def _head(text: str) -> int:
    """How many lines stand before the rows."""
    return next(k for k, line in enumerate(text.splitlines()) if line[:1].isdigit())


def test_record(page: Page, folder: Path, corexy: Path) -> None:
    plan = ("record", "plan", *MACHINE, "-o", folder / "moves.gcode", "--seconds", "2", "--at", "0,0")
    example = (
        "record",
        "plan",
        *MACHINE,
        "-o",
        folder / "print.g",
        "--print",
        ROOT / "docs" / "examples" / "print.gcode",
    )
    quick = ("--period-s", "2", "--periods", "1", "--highest-hz", "60")
    excite = ("record", "plan", "--for", "identify", "-m", corexy, "-o", folder / "excite.gcode", *quick)
    hold(page, "ffcomp-record-plan/1", [*told(*plan), *told(*example), *told(*excite)])
    told("record", "plan", "--for", "scan", "-m", corexy, "-o", folder / "page.gcode")
    files = ("moves.json", "print.json", "excite.json", "page.json")
    plans = [json.loads((folder / name).read_text(encoding="utf-8")) for name in files]
    hold(page, "ffcomp-moves/1", plans)
    captures = write_captures(folder / "moves.json", TRUTH, folder / "captures", kinds=("zigzag",))
    captures[1].write_text(captures[0].read_text(encoding="utf-8").replace("accel_x", "##drops=1"), encoding="utf-8")
    joined = ("record", "join", *captures, "--plan", folder / "moves.json", *MACHINE, "-o", folder / "runs", "-q")
    hold(page, "ffcomp-join/1", told(*joined))
    stretches = write_captures(folder / "print.json", TRUTH, folder / "stretches")
    of_print = ("--plan", folder / "print.g", "-o", folder / "updated.toml")
    hold(page, "ffcomp-update/1", told("identify", "update", *stretches, *of_print, *MACHINE, "-q"))
    checks = ("record", "check", *captures, "--plan", folder / "moves.json", *MACHINE, "--history", folder / "h.jsonl")
    soft = replace(TRUTH, effects={"belt_stiffness": {"relative_change": [0.0, -0.1, 0.0]}})
    later = write_captures(folder / "moves.json", soft, folder / "later", kinds=("zigzag",))
    other = ("record", "check", *later, *checks[2 + len(captures) :])
    hold(page, "ffcomp-check/1", [*told(*checks, "-q"), *told(*other, "-q"), *told(*other, "-q")])
    sensor = ("--as-captures", folder / "played", "--plan", folder / "moves.json", "--rate", "800")
    hold(page, "ffcomp-captures/1", told("simulate", folder / "moves.gcode", *MACHINE, *sensor, "-q"))


def test_identify_fit(page: Page, folder: Path, corexy: Path) -> None:
    known = ("--known", "effector.total_mass_kg=0.651")
    files = _measured(folder, paper_bench(np.arange(2.0, 200.1, 9.0))[:5])  # without the whole printer: quicker
    answers = [
        *told("identify", "fit", *files[:2], *MACHINE, *known, "-q"),  # of a carriage alone: the rest is weak
        *told("identify", "fit", *files, *MACHINE, *known, "-q", "--method", "stepwise"),
        *told("identify", "fit", _spectrum(folder), *MACHINE, "-q", "-o", folder / "modes.toml"),
        *told("identify", "fit", _spectrum(folder), "-m", corexy, "-q"),
        *told("identify", "fit", *_of_belts(folder), "-m", corexy, "-q"),
        *told("identify", "fit", *_of_captures(folder), *MACHINE, "-q"),  # nothing is weighed
        *told("identify", "fit", *write_axis(folder), "-m", folder / "slide.toml", "-q"),
    ]
    hold(page, "ffcomp-identify-fit/1", answers)


def _spectrum(folder: Path) -> Path:
    """As Klipper writes it: one resonance at 50 Hz over noise."""
    f = np.arange(5.0, 120.0, 1.0)
    noise = np.random.default_rng(2).uniform(0.9, 1.1, len(f))
    power = noise * 10 * f**2 / ((1 - (f / 50) ** 2) ** 2 + (0.1 * f / 50) ** 2)
    path = folder / "resonances_x_20260101.csv"
    rows = np.column_stack([f, power, 0.01 * power, 0.01 * power, 1.02 * power])
    np.savetxt(path, rows, fmt="%.6e", delimiter=",", header="freq,psd_x,psd_y,psd_z,psd_xyz", comments="")
    return path


def _of_belts(folder: Path) -> list[Path]:
    """Two tests along belts: the same resonance twice."""
    first = folder / "resonances_axis=1.000,1.000_1.csv"
    first.write_text(_spectrum(folder).read_text(encoding="utf-8"), encoding="utf-8")
    second = folder / "resonances_axis=1.000,-1.000_1.csv"
    second.write_text(first.read_text(encoding="utf-8"), encoding="utf-8")
    return [first, second]


def _of_captures(folder: Path) -> list[Path]:
    """Responses of one accelerometer, whose start is unknown."""
    f, place = np.arange(4.0, 121.0, 9.0), (20.0, 10.0, 30.0)
    bench = [
        blank(f, input=f"cmd_{a}", output=f"acc_{o}", position_mm=place, clock="chip") for a in "ABC" for o in "xyz"
    ]
    return _measured(folder, bench)


def test_machines(page: Page, folder: Path, corexy: Path) -> None:
    hold(page, "ffcomp-machines-list/1", told("machines", "list"))
    hold(page, "ffcomp-machine-show/1", [*told("machines", "show", "kossel"), *told("machines", "show", corexy)])
    checked = [*told("machines", "check", "mp-delta-pro-as-printed"), *told("machines", "check", corexy)]
    hold(page, "ffcomp-machine-check/1", checked)
    bad = folder / "bad.toml"
    bad.write_text(examples(MACHINE_FILE, "toml")[-1], encoding="utf-8")
    hold(page, "ffcomp-machine-error/1", told("machines", "check", bad, code=5))


def test_machines_import(page: Page, folder: Path) -> None:
    delta = written(folder, Delta().klipper() + SHAPER, "printer.cfg")
    answers = told("machines", "import", delta, "-o", folder / "imported.toml")
    straight = written(folder, COREXY, "other.cfg")
    answers += told("machines", "import", straight, "-o", folder / "other.toml", code=5)
    hold(page, "ffcomp-machine-import/1", answers)


def test_the_page_names_every_schema_that_the_code_prints() -> None:
    code = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "ffcomp").rglob("*.py"))
    made = set(re.findall(r'"(ffcomp-[a-z-]+/1)"', code))
    made |= {f"ffcomp-{name}/1" for name in re.findall(r'_print_json\(\s*"([a-z-]+)"', code)}
    told_of = {name for name in Page(REFERENCE / "json.md").objects if name.startswith("ffcomp-")}
    assert told_of == made - {
        "ffcomp-machine/1",
        "ffcomp-check-history/1",
        "ffcomp-motion/1",
    }  # files, described on their own pages


def test_the_tables_are_those_of_the_classes() -> None:
    assert (REFERENCE / "json.md").read_text(encoding="utf-8") == json_objects.page(), "python -m scripts.pages --write"


def test_the_example_is_such_an_object(page: Page) -> None:
    (text,) = examples(REFERENCE / "json.md", "json")
    assert page.problems(json.loads(text), "ffcomp-compensate/1") == []
