from __future__ import annotations

import stat
from collections.abc import Iterator
from pathlib import Path

import pytest

from gcode.container import read_bytes, replace_atomically
from gcode.errors import GcodeError, UnsupportedGcode


@pytest.mark.parametrize("head", [b"GCDE\x01", b"PK\x03\x04", b"\x1f\x8b\x08"])
def test_other_containers_are_named(tmp_path: Path, head: bytes) -> None:
    path = tmp_path / "part.gcode"
    path.write_bytes(head + b"rest")
    with pytest.raises(UnsupportedGcode) as caught:
        read_bytes(path)
    assert str(caught.value).startswith(f"{path}: The file is ")


def test_an_empty_file_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"\n \n")
    with pytest.raises(GcodeError, match="nothing to compensate"):
        read_bytes(tmp_path / "a")


def test_replacing_keeps_permissions_and_links(tmp_path: Path) -> None:
    file, link = tmp_path / "file", tmp_path / "link"
    file.write_bytes(b"old")
    file.chmod(0o640)
    link.symlink_to(file)
    replace_atomically(link, [b"n", b"ew"])
    assert link.is_symlink()
    assert read_bytes(file) == b"new"
    assert stat.S_IMODE(file.stat().st_mode) == 0o640
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "link"]


def test_a_failure_leaves_the_old_file_alone(tmp_path: Path) -> None:
    def broken() -> Iterator[bytes]:
        yield b"half"
        raise RuntimeError("out of ideas")

    file = tmp_path / "file"
    file.write_bytes(b"old")
    with pytest.raises(RuntimeError):
        replace_atomically(file, broken())
    assert file.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [file]


def test_a_new_file_can_be_written(tmp_path: Path) -> None:
    replace_atomically(tmp_path / "new", [b"x"])
    assert (tmp_path / "new").read_bytes() == b"x"
