"""docs/reference and docs/explanation say what the code does: verbs, machine files, formats, exit codes, numbers."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from ffcomp.cli.app import app
from ffcomp.cli.command import commands
from ffcomp.errors import FfcompError
from ffcomp.measurement.frf import KEYS
from ffcomp.measurement.frf_files import _COLUMNS as FRF_COLUMNS
from ffcomp.measurement.frf_files import read_frfs
from ffcomp.measurement.recording import COLUMNS, check_header
from models.errors import MachineFileError
from models.file import load_machine, load_plant
from scripts.pages import dialects, machine_file
from scripts.pages.__main__ import made
from tests.support.reference import MACHINE, MACHINE_FILE, REFERENCE, ROOT, SMALL, call, examples, rows_of


def test_pages_say_what_the_code_does() -> None:
    stale = [path.name for path, text in made().items() if path.read_text(encoding="utf-8") != text]
    assert not stale, "python -m scripts.pages --write"
    for section in machine_file.SECTIONS:
        assert all(row[4] for row in rows_of(MACHINE_FILE, section)), f"{section}: a key is not explained"
    rows = dialects.rows(dialects.PAGE.read_text(encoding="utf-8"))
    assert len(rows) > 100 and {row.outcome for row in rows} == dialects.OUTCOMES.keys()


# ---- cli.md --------------------------------------------------------------------------------------


def test_every_example_of_a_verb_names_options_that_it_has() -> None:
    shown = 0
    for path, command, options in commands(app):
        known = {name for each in options for name in (*each.names, each.negative)} | {"-q", "--quiet", "--json"}
        for example in re.findall("^Example: (.*)$", command.help, re.MULTILINE):
            shown += 1
            assert f"{example} ".startswith(f"ffcomp {' '.join(path)} ")
            assert set(re.findall(r" (--?[a-z][\w-]*)", example)) <= known
    assert shown > 8


# ---- machine_file.md -----------------------------------------------------------------------------


def test_the_examples_are_machines_and_the_mistakes_are_found(tmp_path: Path) -> None:
    *good, bad = examples(MACHINE_FILE, "toml")
    kinds = []
    for number, text in enumerate(good):
        path = tmp_path / f"{number}.toml"
        path.write_text(text, encoding="utf-8")
        kinds.append(load_plant(path).vibration.moves)
    assert kinds == ["carriages", "axes", "axis"]
    path = tmp_path / "mistakes.toml"
    path.write_text(bad, encoding="utf-8")
    with pytest.raises(MachineFileError) as told:
        load_machine(path)
    (quoted,) = examples(MACHINE_FILE, "text")
    assert str(told.value).replace(str(path), "mistakes.toml") == quoted.rstrip("\n")


# ---- files.md ------------------------------------------------------------------------------------

FILES = REFERENCE / "files.md"


def names_of(page: Path, section: str, header: str) -> list[str]:
    """What stands in backticks in the first column of the table that begins with this header."""
    body = re.split(rf"^##+ {re.escape(section)}\n", page.read_text(encoding="utf-8"), flags=re.MULTILINE)[1]
    rows = body.partition(f"\n| {header} |")[2].partition("\n\n")[0].splitlines()[2:]
    return [name for row in rows for name in re.findall(r"`([^`]+)`", row.split("|")[1])]


def test_the_columns_of_measurements_are_told() -> None:
    assert sorted(names_of(FILES, "Measured run", "column")) == sorted(COLUMNS)
    assert names_of(FILES, "Frequency response", "label") == list(KEYS)
    assert names_of(FILES, "Frequency response", "column") == list(FRF_COLUMNS)


def test_the_examples_of_measurements_can_be_read(tmp_path: Path) -> None:
    run, response = examples(FILES, "csv")
    assert check_header(run.splitlines()[2].split(",")) == []
    (tmp_path / "response.csv").write_text(response, encoding="utf-8")
    (read,) = read_frfs(tmp_path / "response.csv")
    assert (read.input, read.output, read.position_mm, len(read.frequency_hz)) == (
        "cmd_A",
        "pos_A",
        (0.0, 0.0, 30.0),
        10,
    )


@pytest.mark.parametrize("kind", ["steps", "klipper-steps"])
def test_the_arrays_of_a_step_archive_are_told(tmp_path: Path, kind: str) -> None:
    small, target = tmp_path / "small.gcode", tmp_path / "small.npz"
    small.write_bytes(SMALL)
    options = ("--kind", kind, "--extruder-steps-per-mm", "400", "-o", target, "-q", "--no-predict")
    call("compensate", small, *MACHINE, *options)
    told = {row[0].strip("`"): (row[1], row[2]) for row in rows_of(FILES, "Step archive")}
    here = {name for name, (_, where) in told.items() if where in ("both", f"`{kind}`")}
    with np.load(target) as archive:
        assert {re.sub("^[abce]_", "m_", name) for name in archive.files} == here
        for name in archive.files:
            said = told[re.sub("^[abce]_", "m_", name)][0].partition(",")
            assert archive[name].dtype.kind == "S" if said[0] == "bytes" else archive[name].dtype == said[0], name
            assert (archive[name].ndim == 0) == (said[2] == " one number")


# ---- exit codes ----------------------------------------------------------------------------------


def test_exit_codes_are_those_of_the_errors() -> None:
    codes = {int(row[0]) for row in rows_of(REFERENCE / "files.md", "Exit codes")}
    errors = [each for each in FfcompError.__subclasses__() if each.__module__ == FfcompError.__module__]
    assert {each.exit_code for each in errors} | {0, 1, 2, 4, 130, 141, 143} == codes
    table = rows_of(REFERENCE / "python.md", "Errors")
    told = {row[0].strip("`").rpartition(".")[2]: int(row[2]) for row in table}
    ours = {
        each.__name__: each.exit_code for each in FfcompError.__subclasses__() if each.__module__ == "ffcomp.errors"
    }
    assert told == {**ours, "GcodeError": 4, "MachineFileError": 5}


# ---- json.md -------------------------------------------------------------------------------------


def test_the_page_names_every_schema_that_the_code_prints() -> None:
    code = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "ffcomp").rglob("*.py"))
    made_by = set(re.findall(r'"(ffcomp-[a-z-]+/1)"', code))
    files = {"ffcomp-machine/1", "ffcomp-check-history/1", "ffcomp-motion/1"}  # described on their own pages
    told_of = re.findall(r"^#+ (ffcomp-[\w-]+/\d+)$", (REFERENCE / "json.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert set(told_of) == made_by - files


# ---- the map -------------------------------------------------------------------------------------


def test_every_page_is_on_the_map() -> None:
    docs = ROOT / "docs"
    reached, ahead = set[Path](), {docs / "README.md"}
    while ahead:
        page = ahead.pop()
        reached.add(page)
        links = re.findall(r"\]\(([^)#:]+\.md)", page.read_text(encoding="utf-8"))
        ahead |= {path for link in links if (path := (page.parent / link).resolve()).is_relative_to(docs)} - reached
    assert set(docs.rglob("*.md")) - reached == set()
