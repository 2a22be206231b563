from __future__ import annotations

import gzip
import io
import os
import re
from pathlib import Path
from zipfile import ZipFile

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gcode.bgcode import GCODE, Block, blocks_of, metadata_of
from gcode.container import opened, read_bytes
from gcode.errors import GcodeError, UnsupportedGcode
from tests.support.containers import PRINT, archive_3mf, bgcode, contents, gzipped, rewritten, zipped

OTHER = PRINT.replace(b"X30", b"X31").replace(b"1m 1s", b"2m 2s")


# -- gzip --


def test_gzip_keeps_name_and_time() -> None:
    packed = gzipped(PRINT)
    new = rewritten(packed, OTHER)
    assert gzip.decompress(new) == OTHER
    assert new[:8] == packed[:8] and new[10:21] == packed[10:21] == b"part.gcode\0"


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda data: data[:60], "cut short"),
        (lambda data: data[:-2], "cut short"),
        (lambda data: data[:-8] + bytes(4) + data[-4:], "CRC"),
        (lambda data: data + b"junk", "damaged"),
        (lambda data: gzipped(data), "compressed twice"),
        (lambda data: gzipped(b""), "empty"),
    ],
)
def test_what_is_wrong_with_gzip_is_said(damage: object, said: str) -> None:
    with pytest.raises(GcodeError, match=said):
        contents(damage(gzipped(PRINT)))  # type: ignore[operator]


def test_bombs_are_not_unpacked() -> None:
    bomb = b"G1 X1 Y1 E1\n" * (6 << 20)  # 72 MiB
    with pytest.raises(GcodeError, match="more than 64 MiB; no sliced print does"):
        contents(gzip.compress(bomb, 1))
    with pytest.raises(GcodeError, match="more than 64 MiB"):
        contents(zipped([("Metadata/plate_1.gcode", bomb)]))


# -- archives --


@pytest.mark.parametrize(
    ("content", "plate", "said"),
    [
        (archive_3mf(PRINT, OTHER), None, "plate_1.gcode, Metadata/plate_2.gcode; choose one with --plate N"),
        (archive_3mf(PRINT, OTHER), 3, "there is no plate 3"),
        (PRINT, 1, "one print, and no plates; there is no plate 1"),
    ],
)
def test_one_plate_of_several_has_to_be_chosen(content: bytes, plate: int | None, said: str, tmp_path: Path) -> None:
    (tmp_path / "two").write_bytes(archive_3mf(PRINT, OTHER))
    assert read_bytes(tmp_path / "two", 2) == OTHER
    (tmp_path / "two").write_bytes(content)
    with pytest.raises(UnsupportedGcode, match=said):
        read_bytes(tmp_path / "two", plate)


@pytest.mark.parametrize("upper", [True, False])
def test_an_archive_keeps_all_else_byte_for_byte(upper: bool) -> None:
    packed = archive_3mf(PRINT, PRINT, upper=upper)
    new = rewritten(packed, OTHER, PRINT + b"M84\n")
    assert new == rewritten(new, OTHER, PRINT + b"M84\n")
    before, after = ZipFile(io.BytesIO(packed)), ZipFile(io.BytesIO(new))
    assert after.testzip() is None and after.comment == before.comment
    assert new.startswith(packed[: before.getinfo("Metadata/plate_1.gcode").header_offset])
    for old, found in zip(before.infolist(), after.infolist(), strict=True):
        assert (old.filename, old.date_time, old.compress_type) == (
            found.filename,
            found.date_time,
            found.compress_type,
        )
        assert old.external_attr == found.external_attr
        if "plate_1.gcode" not in old.filename and "plate_2.gcode" not in old.filename:
            assert before.read(old) == after.read(found) and old.CRC == found.CRC
    assert contents(new) == {"Metadata/plate_1.gcode": OTHER, "Metadata/plate_2.gcode": PRINT + b"M84\n"}
    same = archive_3mf(OTHER, PRINT + b"M84\n", upper=upper)
    for name in ("Metadata/plate_1.gcode.md5", "Metadata/plate_2.gcode.md5"):
        assert after.read(name) == ZipFile(io.BytesIO(same)).read(name)


def test_other_members_are_never_unpacked() -> None:
    """One of a compression that nobody knows stays as it is."""
    packed = bytearray(archive_3mf(PRINT))
    for record in (packed.index(b"PK\3\4") + 8, packed.index(b"PK\1\2") + 10):  # of the first member
        packed[record : record + 2] = (97).to_bytes(2, "little")
    assert rewritten(bytes(packed), OTHER)[:60] == packed[:60]


def _entry(name: str, content: bytes = b"x") -> bytes:
    return zipped([(name, content), ("Metadata/plate_1.gcode", PRINT)])


def _link() -> bytes:
    packed = bytearray(_entry("link"))
    at = packed.index(b"PK\1\2") + 38
    packed[at : at + 4] = (0o120777 << 16).to_bytes(4, "little")
    return bytes(packed)


def _flagged() -> bytes:
    packed = bytearray(archive_3mf(PRINT))
    packed[packed.rindex(b"PK\1\2") + 8] |= 1
    return bytes(packed)


@pytest.mark.parametrize(
    ("packed", "said"),
    [
        (_entry("../x"), "leads out of it"),
        (_entry("/etc/passwd"), "leads out of it"),
        (_entry("metadata/PLATE_1.gcode"), "two members named"),
        (_link(), "a symbolic link"),
        (_flagged(), "encrypted"),
        (zipped([("3D/3dmodel.model", b"<model/>")]), "not sliced: slice it"),
        (zipped([("readme.txt", b"hello")]), "zip archive without G-code"),
        (zipped([("Metadata/plate_1.gcode", PRINT), ("Metadata/plate_1.gcode.md5", b"0" * 32)]), "its MD5 is"),
        (zipped([("Metadata/plate_1.gcode", gzipped(PRINT))]), "compressed twice"),
        (archive_3mf(PRINT)[:-30], "damaged"),
    ],
)
def test_what_is_wrong_with_an_archive_is_said(packed: bytes, said: str) -> None:
    with pytest.raises(GcodeError, match=said):
        contents(packed)


# -- binary --


def _blocks(packed: bytes) -> list[Block]:
    return list(blocks_of(io.BytesIO(packed), ""))


@pytest.mark.parametrize("encoding", ["none", "MeatPack", "MeatPackComments"])
def test_binary_gcode_is_changed_and_restored(tmp_path: Path, encoding: str) -> None:
    packed = bgcode(PRINT, tmp_path, encoding)
    (text,) = contents(packed).values()
    assert b"G1 X30 Y12 E1\n" in text and text.count(b"(normal mode) = 1m 1s\n") == 2 and b"gcode_flavor" in text
    ours = text.replace(b"X30", b"X31").replace(b"= 1m 1s\n", b"= 2m 2s\n")
    ours = ours.replace(
        b"M107\n", b"M204 P1 ; ffcomp\n;~M107 ; x\n; max_layer_z = 6.2\n;x\n; ffcomp was P0 R1\nM73 P1 R1\n"
    )
    new = rewritten(packed, ours)
    before, after = _blocks(packed), _blocks(new)
    assert [block.kind for block in before] == [block.kind for block in after]
    assert [block.compression for block in before] == [block.compression for block in after]
    key = b"estimated printing time (normal mode)"
    assert {metadata_of(block)[key] for block in after if metadata_of(block)} == {b"2m 2s"}
    (back,) = contents(new).values()
    assert back == ours.replace(b"= 2m 2s\n", b"= 1m 1s\n")  # whoever reads it gets the slicer's times
    restored = rewritten(new, text)
    assert contents(restored) == {"": text}
    assert [b.raw for b in _blocks(restored) if b.kind != GCODE] == [b.raw for b in before if b.kind != GCODE]


def test_binary_gcode_that_cannot_be_read_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    packed = bgcode(PRINT, tmp_path)
    first = _blocks(packed)[0].raw
    for damaged, said in (
        (packed[:-7], "cut short"),
        (packed[:-20] + bytes(8) + packed[-12:], "checksum of block 5 is wrong"),
        (packed[:4] + b"\7" + packed[5:], "another kind"),
        (packed[:10] + first, "without a block of G-code"),
        (packed.replace(_blocks(packed)[1].raw, b""), "cannot be converted"),
    ):
        with pytest.raises(GcodeError, match=said):
            contents(damaged)
    monkeypatch.setattr("gcode.bgcode.find_spec", lambda name: None)
    with pytest.raises(UnsupportedGcode, match=r"pip install 'ffcomp\[bgcode\]'"):
        contents(packed)


# -- everything --


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "empty"),
        (b"\n \n", "nothing to compensate"),
        (PRINT.decode().encode("utf-16"), "UTF-16"),
        (b"\x89PNG\r\n\x1a\n", "PNG"),
        (b"cube".ljust(84, b"\0"), "not text"),
        (b"G28\nG1 X1\nG1 \0\n", "3: The file is not text"),
    ],
)
def test_what_is_no_gcode_is_named_with_its_line(tmp_path: Path, content: bytes, said: str) -> None:
    file = tmp_path / "part.gcode"
    file.write_bytes(content)
    with pytest.raises(GcodeError, match=said) as caught:
        read_bytes(file)
    assert re.match(rf"{re.escape(str(file))}:[13]: The file is ", str(caught.value))


def test_pipes_and_folders_are_no_files(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OSError, match="pipe or a device"), opened(tmp_path / "pipe"):
        pass
    with pytest.raises(IsADirectoryError), opened(tmp_path):
        pass


def _read(data: bytes) -> dict[str, bytes] | None:
    """The prints; None for what is refused with a sentence."""
    try:
        return contents(data)
    except GcodeError as error:
        return None if re.fullmatch(r"print\S*: .+\.", str(error), re.DOTALL) else {"": str(error).encode()}


PACKED = [gzipped(PRINT), archive_3mf(PRINT), PRINT]


@settings(max_examples=100, deadline=None)
@given(st.data())
def test_damage_is_found_or_harmless(data: st.DataObject) -> None:
    packed = bytearray(data.draw(st.sampled_from(PACKED)))
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(packed) - 1))
        end = at + data.draw(st.integers(0, 20))
        packed[at:end] = data.draw(st.binary(max_size=20))
        if not packed:
            return
    before = _read(bytes(packed))
    if before is not None:
        assert contents(rewritten(bytes(packed), *before.values())) == before


@settings(max_examples=100, deadline=None)
@given(st.sampled_from([b"", b"\x1f\x8b\x08", b"PK\3\4", b"PK\5\6", b"GCDE\1\0\0\0\1\0"]), st.binary(max_size=300))
def test_random_bytes_are_refused_or_read(magic: bytes, rest: bytes) -> None:
    assert _read(magic + rest) in (None, {"": magic + rest})
