"""Tests of the import contract, and of scripts/structure, which measures it."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest

from scripts.structure import INDEPENDENT, LAYERS, OUTSIDE, Checkout, cycles, floors, main, shortest_cycle

ROOT = Path(__file__).parents[1]
Write = Callable[[dict[str, str]], Checkout]


@pytest.fixture(scope="module")
def here() -> Checkout:
    return Checkout(ROOT)


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Return a function that writes files and reads them as a checkout; packages without an `__init__` get one."""

    def written(files: dict[str, str]) -> Checkout:
        for name, text in {"ffcomp/__init__.py": "", **files}.items():
            path = tmp_path / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
        return Checkout(tmp_path)

    return written


# This checkout


def test_the_contract_holds() -> None:
    command = [sys.executable, "scripts/structure", "--check"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("package", ["gcode", "models"])
def test_gcode_and_models_stand_on_their_own(here: Checkout, package: str) -> None:
    assert package in INDEPENDENT
    assert [line for line in here.forbidden if line.startswith(f"{package}/")] == []


def test_the_product_does_not_import_what_tests_or_measures_it(here: Checkout) -> None:
    assert [
        i for i in here.imports if i.importer.split(".")[0] not in OUTSIDE and i.imported.split(".")[0] in OUTSIDE
    ] == []


def test_all_imported_modules_exist(here: Checkout) -> None:
    assert here.missing == []


def test_files_of_gcode_and_of_the_effects_are_in_no_cycle(here: Checkout) -> None:
    circular = {name for group in here.file_cycles() for name in group}
    assert [
        name for name in circular if name.startswith(("gcode", "models.effects", "ffcomp.cli", "ffcomp.report"))
    ] == []


def test_import_linter_has_the_same_layers() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]
    layers = next(contract for contract in settings["contracts"] if contract["type"] == "layers")["layers"]
    theirs = [{name.strip(" ()") for name in layer.split(":")} for layer in reversed(layers)]
    inside = [{unit.removeprefix("ffcomp.") for unit in layer if unit.startswith("ffcomp.")} for layer in LAYERS]
    assert theirs == [
        layer for layer in inside if layer and layer != {"__init__"}
    ]  # no layer for a container's own file


# Imports


def test_imports_count_wherever_they_stand(write: Write) -> None:
    checkout = write(
        {
            "ffcomp/planner/a.py": "from __future__ import annotations\n"
            "from typing import TYPE_CHECKING\n"
            "import ffcomp.errors\n"
            "from . import b\n"
            "from .b import name\n"
            "if TYPE_CHECKING:\n    from models import machine\nelse:\n    from models import other\n"
            'def f():\n    from gcode.reader import read\n    import_module("gcode.words")\n',
            "ffcomp/planner/__init__.py": "",
            "ffcomp/planner/b.py": "name = 1\n",
            "ffcomp/errors.py": "",
            "models/__init__.py": "",
            "models/machine.py": "",
            "models/other.py": "",
            "gcode/reader.py": "read = 1\n",
            "gcode/words.py": "",
        }
    )
    found = {(i.imported, i.line): (i.lazy, i.typing) for i in checkout.imports}
    assert found == {
        ("ffcomp.errors", 3): (False, False),
        ("ffcomp.planner.b", 4): (False, False),
        ("ffcomp.planner.b", 5): (False, False),
        ("models.machine", 7): (False, True),
        ("models.other", 9): (False, False),
        ("gcode.reader", 11): (True, False),
        ("gcode.words", 12): (True, False),
    }
    assert checkout.problems() == []


def test_imports_of_what_does_not_exist_are_problems(write: Write) -> None:
    checkout = write({"ffcomp/steps/a.py": "from ffcomp.gone import x\nfrom ..host import y\nimport numpy\n"})
    assert checkout.problems() == ["ffcomp/steps/a.py:1 imports ffcomp.gone, which does not exist"]


# Cycles


def test_cycles_through_functions_and_types_are_found(write: Write) -> None:
    checkout = write(
        {
            "ffcomp/steps/a.py": "import ffcomp.inverse.b\n",
            "ffcomp/inverse/b.py": "def f():\n    from ffcomp.steps import a\n",
            "models/one.py": "from models.two import x\n",
            "models/two.py": "import typing\nif typing.TYPE_CHECKING:\n    from models.one import y\nx = 1\n",
        }
    )
    assert checkout.file_cycles() == [["ffcomp.inverse.b", "ffcomp.steps.a"], ["models.one", "models.two"]]
    assert checkout.file_cycles(typing=False) == [["ffcomp.inverse.b", "ffcomp.steps.a"]]
    assert checkout.folder_cycles() == {
        "ffcomp": [["ffcomp.inverse", "ffcomp.steps"]],
        "models": [["models.one", "models.two"]],
    }
    assert len(checkout.problems()) == 4
    assert "ffcomp/inverse/b.py:2 imports ffcomp.steps.a (in a function)" in checkout.problems()[0]


def test_folders_can_be_in_a_cycle_when_no_file_is(write: Write) -> None:
    checkout = write(
        {
            "ffcomp/steps/a.py": "import ffcomp.inverse.b\n",
            "ffcomp/steps/c.py": "",
            "ffcomp/inverse/b.py": "import ffcomp.steps.c\n",
        }
    )
    assert checkout.file_cycles() == []
    assert checkout.problems() == [
        "cycle of 2 units in ffcomp: ffcomp/inverse/b.py:1 imports ffcomp.steps.c; "
        "ffcomp/steps/a.py:1 imports ffcomp.inverse.b"
    ]


def test_graphs() -> None:
    graph = {"a": {"b"}, "b": {"c"}, "c": {"a", "d", "e"}, "d": {"e"}, "e": set[str](), "f": {"e"}}
    assert cycles(graph) == [["a", "b", "c"]]
    assert shortest_cycle(graph, "b") == ["b", "c", "a"]
    assert floors(graph) == 3
    assert floors({}) == 0


# The rest of the contract


@pytest.mark.parametrize(
    ("path", "text", "reason"),
    [
        ("gcode/a.py", "from models import machine", "gcode must not import models"),
        ("models/a.py", "import gcode.reader", "models must not import gcode"),
        ("models/a.py", "import ffcomp.errors", "models must not import ffcomp"),
        (
            "ffcomp/planner/a.py",
            "from ffcomp.inverse import b",
            "ffcomp.planner (layer 2) is below ffcomp.inverse (layer 3)",
        ),
        ("ffcomp/report/a.py", "from ffcomp import load", "ffcomp.report (layer 7) is below ffcomp.__init__ (layer 9)"),
        ("ffcomp/cli/a.py", "from tests.x import y", "tests/ is never imported by the product"),
        ("ffcomp/cli/a.py", "from studies.x import y", "studies/ is never imported by the product"),
        ("ffcomp/cli/a.py", "from ffcomp import load", None),
        ("ffcomp/inverse/a.py", "from ffcomp.steps import a", None),
        ("studies/a.py", "from ffcomp import load\nimport validation.plant", None),
    ],
)
def test_imports_go_down(write: Write, path: str, text: str, reason: str | None) -> None:
    there = ("models/machine.py", "gcode/reader.py", "ffcomp/errors.py", "ffcomp/inverse/b.py", "ffcomp/steps/a.py")
    checkout = write({**dict.fromkeys((*there, "studies/x.py", "validation/plant.py"), ""), path: text})
    assert [problem.split(": ", 1)[1] for problem in checkout.problems()] == ([reason] if reason else [])


def test_folders_without_a_layer_and_loose_files_are_problems(write: Write) -> None:
    extra = {f"ffcomp/{name}": "" for name in ("errors.py", "metrics.py", "version.py", "__main__.py", "py.typed")}
    assert write(extra).problems() == []
    checkout = write({"ffcomp/attic/a.py": "", "ffcomp/notes.txt": ""})
    assert [problem[:34] for problem in checkout.problems()] == [
        "no layer for ffcomp.attic: add it ",
        "7 files directly in ffcomp/, allow",
    ]


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("if machine.has_straight_axes: pass", 1),
        ("isinstance(m.kinematics, DeltaGeometry)", 1),
        ("isinstance(m.kinematics, (int, geometry.StraightGeometry))", 1),
        ("type(m) is DeltaGeometry", 1),
        ("match m:\n    case DeltaGeometry():\n        pass", 1),
        ("machine.delta.towers_mm + self.machine.delta.arms_mm", 2),
        ("x = first_share", 1),
        ("f(first_share=2)", 1),
        ("inverter.kinematics.inverse(q); import gap.delta; DeltaGeometry(1)", 0),
    ],
)
def test_switches_on_the_kind_of_machine_are_found(write: Write, text: str, count: int) -> None:
    checkout = write({"ffcomp/report/a.py": text, "models/a.py": text})
    assert len(checkout.kind_switches) == count
    assert len(checkout.problems()) == count


# Measures and the command line


def test_measures(write: Write) -> None:
    checkout = write(
        {
            "models/a.py": "FloatArray = NDArray[float64]\nLIMIT, _own = 1, 2\n\n"
            "def f():\n    def g():\n        p\n    return g\n",
            "gcode/b.py": "FloatArray: TypeAlias = npt.NDArray[float64]\n"
            "try:\n    LIMIT = 3\nexcept E:\n    _own = 2\n",
            "ffcomp/steps/c.py": "from gcode.b import FloatArray\nclass C:\n    def f(self): pass\n",
            "ffcomp/inverse/d.py": "import ffcomp.steps.c\n",
        }
    )
    assert checkout.named_twice == {"FloatArray": ["gcode/b.py", "models/a.py"], "LIMIT": ["gcode/b.py", "models/a.py"]}
    table = dict(checkout.table())
    assert table["Definitions of `FloatArray`"] == "2"
    assert table["Longest function"] == "4 (models/a.py: f)"
    assert table["Largest file"] == "7 (models/a.py)"
    assert table["Lines of code of a function, median"] == "2"
    assert table["Floors (longest chain of units)"] == "2"
    assert table["Arrows (unit to unit)"] == "1"


@pytest.mark.skipif(shutil.which("git") is None, reason="needs git")
def test_commits_are_compared(write: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    git = ["git", "-C", str(tmp_path), "-c", "user.name=a", "-c", "user.email=a@b"]
    write({"ffcomp/errors.py": "x = 1\n", "ffcomp/steps/a.py": "def f():\n    pass\n", "notes.txt": ""})
    for command in (["init", "-q"], ["add", "."], ["commit", "-q", "-m", "first"]):
        subprocess.run([*git, *command], check=True)
    write({"ffcomp/inverse/b.py": "import ffcomp.cli.c", "ffcomp/cli/c.py": ""})
    assert main([str(tmp_path), "--check"]) == 1
    assert "ffcomp.inverse (layer 3) is below ffcomp.cli (layer 10)" in capsys.readouterr().out
    assert main([str(tmp_path), "--check", "--ref", "HEAD"]) == 0
    assert capsys.readouterr().out == "structure: no problems\n"
    assert main([str(tmp_path), "--compare", "HEAD"]) == 0
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in capsys.readouterr().out.splitlines()]
    assert ["Units (direct children of `ffcomp/`)", "2", "4"] in rows
    with pytest.raises(SystemExit, match="nowhere"):
        main([str(tmp_path), "--ref", "nowhere"])


@pytest.mark.parametrize("option", ["--table", "--twice", "--dot", "--files", None])
def test_each_output_is_written(
    write: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str], option: str | None
) -> None:
    write({"ffcomp/steps/a.py": "import gcode.b\ndef f(): pass\n", "gcode/b.py": "def f(): pass\n"})
    assert main([str(tmp_path), *([option] if option else [])]) == 0
    assert capsys.readouterr().out.strip()
