"""Containers through the verbs: the same kind comes out, a second call is harmless, the original comes back."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from pathlib import Path
from zipfile import ZipFile

import pytest

from ffcomp.cli.app import app
from gcode.metadata import slicer_time_s
from tests.support.cli import CliRunner, Result
from tests.support.containers import PRINT, archive_3mf, bgcode, contents, gzipped, zipped

MACHINE = "mp-delta-pro"
OTHER = PRINT.replace(b"X30", b"X31")
KINDS: dict[str, Callable[[Path], bytes]] = {
    "gzip": lambda folder: gzipped(PRINT),
    "3mf": lambda folder: archive_3mf(PRINT),
    "two plates": lambda folder: archive_3mf(PRINT, OTHER),
    "bgcode": lambda folder: bgcode(PRINT, folder, "MeatPack"),
}


def call(verb: str, *words: str | Path) -> Result:
    return CliRunner().invoke(app, [verb, *map(str, words)])


@pytest.fixture(params=KINDS)
def packed(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A file whose name says nothing about what it is."""
    path = tmp_path / "part.gcode.pp"
    path.write_bytes(KINDS[request.param](tmp_path))
    for other in set(tmp_path.iterdir()) - {path}:
        other.unlink()
    return path


def test_the_way_there_and_back(packed: Path) -> None:
    before = packed.read_bytes()
    done = call("compensate", packed, "-m", MACHINE, "--json", "-q", "--no-predict")
    assert done.exit_code == 0, done.output
    result, after = json.loads(done.stdout), packed.read_bytes()
    assert result["output"] == result["input"] == str(packed)
    assert result["moves"] == 2 * len(contents(before))
    assert after[:4] == before[:4]
    texts = contents(after)
    assert texts.keys() == contents(before).keys()
    assert all(text.count(b"; Processed by ffcomp") == 2 and b";~G1 X28 Y30 E1" in text for text in texts.values())
    again = call("compensate", packed, "-m", MACHINE)
    assert again.exit_code == 0 and "already processed" in again.output and packed.read_bytes() == after
    forced = call("compensate", packed, "-m", MACHINE, "--force", "-q", "--no-predict")
    assert forced.exit_code == 0 and contents(packed.read_bytes()) == texts
    assert call("restore", packed).exit_code == 0
    assert contents(packed.read_bytes()) == contents(before)
    assert call("restore", packed).exit_code == 3
    assert [path.name for path in packed.parent.iterdir()] == [packed.name]


def test_one_plate_that_is_done_stays_as_it_is(tmp_path: Path) -> None:
    plain, archive = tmp_path / "plain", tmp_path / "archive"
    plain.write_bytes(PRINT)
    assert call("compensate", plain, "-m", MACHINE, "-q", "--no-predict").exit_code == 0
    archive.write_bytes(archive_3mf(plain.read_bytes(), OTHER))
    done = call("compensate", archive, "-m", MACHINE, "--json", "-q", "--no-predict")
    assert json.loads(done.stdout)["moves"] == 2
    first, second = contents(archive.read_bytes()).values()
    assert first == plain.read_bytes() and b"Processed by ffcomp" in second


def test_the_archives_own_prediction_follows_the_time_in_the_gcode(tmp_path: Path) -> None:
    """BambuStudio's account of its plates: the second one's is told in seconds, and comes back with `restore`."""
    said = b"; total estimated time: 1h 1m 0s\n"
    plates = [PRINT, said + PRINT]
    info = b'<config><plate><metadata key="index" value="2"/><metadata key="prediction" value="3660"/></plate></config>'
    packed = archive_3mf(*plates)
    path = tmp_path / "plates.gcode.3mf"
    path.write_bytes(with_member(packed, "Metadata/slice_info.config", info))
    assert call("compensate", path, "-m", MACHINE, "-q", "--no-predict").exit_code == 0
    with ZipFile(path) as archive:
        told = archive.read("Metadata/slice_info.config")
        text = archive.read("Metadata/plate_2.gcode")
    now = slicer_time_s(text.splitlines(keepends=True)[:5])
    assert now is not None and now < 60
    assert told == info.replace(b"3660", b"%d" % now)
    restored = tmp_path / "restored.gcode.3mf"
    assert call("restore", path, "-o", restored).exit_code == 0
    with ZipFile(restored) as archive:
        assert archive.read("Metadata/slice_info.config") == info


def with_member(packed: bytes, name: str, content: bytes) -> bytes:
    """The archive with another content in one of its members."""
    with ZipFile(io.BytesIO(packed)) as old:
        return zipped([(each, content if each.filename == name else old.read(each)) for each in old.infolist()])
