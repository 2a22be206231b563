"""What is installed: the base has what every verb needs, extras have the rest, and each is told of."""

from __future__ import annotations

import ast
import email
import importlib.util
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from importlib.metadata import version
from pathlib import Path

import pytest

from ffcomp.errors import EXTRAS, not_installed

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
OPTIONAL = PROJECT["optional-dependencies"]
BROUGHT = {"distributed", "llvmlite", "pil", "pybgcode", "click", "markupsafe"}  # by others, or under another name
LATER = {"pandas"}  # told of where it is needed, and in no extra: who wants a table has it

WITH_BASH = pytest.mark.skipif(sys.platform == "win32", reason="a script for bash")


def names(requirements: list[str]) -> set[str]:
    return {re.split(r"[^\w.-]", requirement)[0].lower().replace("-", "_") for requirement in requirements}


def imported(*packages: str) -> set[str]:
    """Return the third-party packages that the files of packages import at the top of a file or anywhere in it."""
    found = set()
    for path in (
        path for package in packages for path in (ROOT / package).rglob("*.py") if "integrations" not in path.parts
    ):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                found |= {name.name.partition(".")[0] for name in node.names}
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                found.add(str(node.module).partition(".")[0])
    return {name for name in found if name not in sys.stdlib_module_names} - {"gcode", "models", "ffcomp"}


def test_what_is_imported_is_installed_by_the_base_or_an_extra() -> None:
    extras = names(
        [each for name, each_of in OPTIONAL.items() if name not in ("test", "dev", "docs") for each in each_of]
    )
    known = names(PROJECT["dependencies"]) | extras | BROUGHT | LATER
    imports = imported("gcode", "models", "ffcomp")
    assert {name.lower() for name in imports} <= known


@pytest.mark.parametrize("package", EXTRAS)
def test_each_extra_that_is_named_has_its_package(package: str) -> None:
    extra, _ = EXTRAS[package]
    installed = {"PIL": "pillow"}.get(package, package)
    assert installed in names(OPTIONAL[extra])
    assert extra == "jit" or installed not in names(PROJECT["dependencies"])  # which a wheel may do without
    assert f"pip install 'ffcomp[{extra}]'" in str(not_installed(package))


def test_the_page_lists_the_extras() -> None:
    page = (ROOT / "docs" / "INSTALL.md").read_text(encoding="utf-8")
    assert set(OPTIONAL) <= set(re.findall(r"`(\w+)`", page[page.index("## Extras") : page.index("## How much space")]))


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> zipfile.ZipFile:
    """A wheel of a copy of the sources, so that nothing is left beside them."""
    if importlib.util.find_spec("setuptools") is None or int(version("setuptools").split(".")[0]) < 77:
        pytest.skip("no setuptools 77 here to build with; pip and build fetch it by themselves")
    folder = tmp_path_factory.mktemp("sources")
    for name in (
        "pyproject.toml",
        "README.md",
        "LICENSE",
        "MANIFEST.in",
        "CHANGELOG.md",
        "CITATION.cff",
        "SECURITY.md",
    ):
        shutil.copy(ROOT / name, folder)
    for name in ("ffcomp", "gcode", "models"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    (folder / "tests").mkdir()
    (folder / "tests" / "__init__.py").touch()
    make = "import sys; from setuptools import build_meta; build_meta.build_wheel('out'); build_meta.build_sdist('out')"
    done = subprocess.run([sys.executable, "-c", make], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    return zipfile.ZipFile(next((folder / "out").glob("*.whl")))


def test_the_wheel_has_all_that_is_loaded_and_nothing_else(wheel: zipfile.ZipFile) -> None:
    """Templates, styles, scripts and machines are read at run time: a wheel without them imports, and fails later."""
    inside = {name for name in wheel.namelist() if ".dist-info/" not in name}
    sources = {
        path.relative_to(ROOT).as_posix()
        for package in ("ffcomp", "gcode", "models")
        for path in (ROOT / package).rglob("*")
        if path.is_file() and path.suffix not in (".pyc", ".nbi", ".nbc")
    }
    assert inside == sources


def test_the_wheel_says_of_itself_what_the_project_says(wheel: zipfile.ZipFile) -> None:
    of = {Path(name).name: name for name in wheel.namelist() if ".dist-info/" in name}
    metadata = email.message_from_bytes(wheel.read(of["METADATA"]))
    assert metadata["Name"] == "ffcomp" and metadata["Requires-Python"] == PROJECT["requires-python"]
    assert set(metadata.get_all("Provides-Extra", [])) == set(OPTIONAL)
    assert metadata["Description-Content-Type"] == "text/markdown" and metadata["License-Expression"] == "Apache-2.0"
    assert b"ffcomp = ffcomp.cli.app:main" in wheel.read(of["entry_points.txt"])
    assert b"Root-Is-Purelib: true" in wheel.read(of["WHEEL"]) and "LICENSE" in of


@WITH_BASH
def test_slim_refuses_what_is_no_environment(tmp_path: Path) -> None:
    """It deletes files: never in a folder that was named by mistake."""
    keep = tmp_path / "site-packages" / "a" / "tests" / "keep.py"
    keep.parent.mkdir(parents=True)
    keep.touch()
    done = subprocess.run([ROOT / "scripts" / "slim", tmp_path], capture_output=True, text=True, check=False)
    assert done.returncode == 2 and "no virtual environment" in done.stderr and keep.exists()


@WITH_BASH
def test_slim_takes_tests_and_keeps_what_is_loaded(tmp_path: Path) -> None:
    folder = tmp_path / "ffcomp"  # as pipx, uv and docs/INSTALL.md call it
    installed = folder / "lib" / "site-packages"
    tests = installed / "numpy" / "tests"
    tests.mkdir(parents=True)
    for name in ("test_a.py", "_natype.py", "__init__.py", "data.npz"):
        (tests / name).touch()
    (folder / "pyvenv.cfg").touch()
    for name in ("numpy", "ffcomp"):
        (installed / name / "__pycache__").mkdir(parents=True)
    subprocess.run([ROOT / "scripts" / "slim", folder], check=True, capture_output=True)
    assert not (installed / "numpy" / "__pycache__").exists() and (installed / "ffcomp" / "__pycache__").exists()
    assert sorted(path.name for path in tests.iterdir()) == ["__init__.py", "_natype.py"]
