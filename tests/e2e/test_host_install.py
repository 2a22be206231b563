"""`integrations/klipper/install.sh` in a home that looks like a Klipper host's."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "integrations" / "klipper" / "install.sh"
MOONRAKER = "[server]\nhost: 0.0.0.0\n\n\n[update_manager other]\ntype: web\n"

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="a script for a Linux host")


@pytest.fixture
def home(tmp_path: Path) -> Path:
    """Kalico, Moonraker, a configuration, and an environment whose ffcomp is this one."""
    for folder in ("kalico/klippy/plugins", "kalico/klippy/extras", "kalico/.git/info", "printer_data/config"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "moonraker/moonraker/components").mkdir(parents=True)
    (tmp_path / "moonraker/.git/info").mkdir(parents=True)
    (tmp_path / "printer_data/config/moonraker.conf").write_text(MOONRAKER)
    (tmp_path / "printer_data/config/printer.cfg").write_text("[printer]\n")
    program = tmp_path / "ffcomp-env/bin/ffcomp"
    program.parent.mkdir(parents=True)
    program.write_text(f'#!/bin/sh\nPYTHONPATH={SCRIPT.parents[2]} exec {sys.executable} -m ffcomp "$@"\n')
    program.chmod(0o755)
    return tmp_path


def install(home: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "HOME": str(home), "FFCOMP_AS_ROOT": "1"}
    command = ["bash", str(SCRIPT), "--no-pip", "--no-warmup", *arguments]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


def tree(home: Path) -> dict[str, str]:
    """Every file with what is in it, links with where they lead."""
    files = [path for path in home.rglob("*") if path.is_symlink() or path.is_file()]
    read = {path.relative_to(home).as_posix(): path for path in files if "ffcomp-env" not in path.parts}
    return {name: os.readlink(path) if path.is_symlink() else path.read_text() for name, path in read.items()}


def test_twice_is_once_and_uninstall_is_never(home: Path) -> None:
    before = tree(home)
    done = install(home, "--machine", "mp-delta-pro")
    assert done.returncode == 0, done.stderr
    once = tree(home)
    assert once["kalico/klippy/plugins/ffcomp_print"] == str(SCRIPT.parent / "ffcomp_print")
    assert "[ffcomp_print]" in once["printer_data/config/ffcomp.cfg"]
    assert 'MACHINE = "mp-delta-pro"' in once["moonraker/moonraker/components/ffcomp.py"]
    conf = once["printer_data/config/moonraker.conf"]
    assert conf.startswith(MOONRAKER) and conf.count("[ffcomp]\nmachine: mp-delta-pro\n") == 1
    assert "/klippy/plugins/ffcomp_print\n" in once["kalico/.git/info/exclude"]
    assert install(home).returncode == 0  # the machine is remembered
    assert tree(home) == once
    assert install(home, "--uninstall").returncode == 0
    after = {name: text for name, text in tree(home).items() if not name.endswith("exclude")}
    assert after == before


def test_klipper_has_it_among_its_extras(home: Path) -> None:
    (home / "kalico/klippy/plugins").rmdir()
    (home / "kalico").rename(home / "klipper")
    done = install(home, "--only-module")
    assert done.returncode == 0 and "[include ffcomp.cfg]" in done.stdout
    assert (home / "klipper/klippy/extras/ffcomp_print/__init__.py").exists()
    assert not (home / "moonraker/moonraker/components/ffcomp.py").exists()
