"""What viewers and hosts read of a compensated print."""

from __future__ import annotations

from pathlib import Path

import pytest

from ffcomp.cli.app import app
from tests.support.cli import CliRunner
from tests.support.docs_runner import ROOT
from tests.support.moonraker import thumbnail

OBJECT = b"EXCLUDE_OBJECT_DEFINE NAME=tower CENTER=0,0\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`tower.gcode`, compensated to `done.gcode`."""
    folder = tmp_path_factory.mktemp("viewers")
    lines = (ROOT / "sample_prints" / "ringing_tower.gcode").read_bytes().splitlines(keepends=True)
    sliced = [lines[0], *thumbnail(), OBJECT, *lines[1:160], *lines[-300:]]
    (folder / "tower.gcode").write_bytes(b"".join(sliced))
    words = ["compensate", folder / "tower.gcode", "-o", folder / "done.gcode", "-m", "mp-delta-pro", "--no-predict"]
    done = CliRunner().invoke(app, [str(word) for word in words])
    assert done.exit_code == 0, done.output
    return folder


def comments(path: Path, *begins: bytes) -> list[bytes]:
    return [line for line in path.read_bytes().splitlines(keepends=True) if line.startswith(begins)]


def test_a_compensated_print_keeps_what_viewers_read(folder: Path) -> None:
    sliced, done = folder / "tower.gcode", folder / "done.gcode"
    first = sliced.read_bytes().partition(b"\n")[0]
    assert done.read_bytes().startswith(first + b"\n")  # by which viewers know the slicer
    assert b"".join(thumbnail()) in done.read_bytes()
    for begins in ((b";LAYER_CHANGE",), (b";Z:", b";HEIGHT:", b";WIDTH:"), (b";TYPE:",), (b"EXCLUDE_OBJECT",)):
        kept = comments(sliced, *begins)
        assert kept and comments(done, *begins) == kept, begins
