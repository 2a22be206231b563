"""What a computer can do to us while we write: whatever happens, the print is whole and nothing is left lying about."""

from __future__ import annotations

import contextlib
import errno
import os
import signal
import stat
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import pytest

from ffcomp.compensation.file import compensate_file
from ffcomp.compensation.request import CompensateOptions
from ffcomp.compensation.result import failure_of
from ffcomp.numerics.numba_cache import VARIABLE, ensure_cache_folder
from gcode.embedded import already_processed, original
from tests.support.compensated import plainly
from tests.support.machines import machine

resource = pytest.importorskip("resource", reason="These faults are made with a POSIX system's means.")

ROOT = Path(__file__).parents[2]
SMALL = b"G28\nG90\nM83\nG1 Z0.3 F6000\nG1 X10 Y10 F9000\n;LAYER:0\nG1 X30 Y12 E1\nG1 X28 Y30 E1\nM107\n"


@cache
def options() -> CompensateOptions:
    return plainly(predict=False)


def compensated(file: Path, target: Path | None = None, progress: Callable[[float], None] = lambda share: None) -> None:
    compensate_file(file, str(file), machine(), options(), target or file, progress=progress)


def refused(file: Path, target: Path | None = None, progress: Callable[[float], None] = lambda share: None) -> str:
    """The sentence that the user gets; the exit code is that of files that cannot be used."""
    with pytest.raises(OSError) as caught:  # noqa: PT011 (its sentence is what the callers look at)
        compensated(file, target, progress)
    failure = failure_of(caught.value, file)
    assert failure.exit_code == 2 and not failure.trace
    return failure.sentence


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.fixture
def small(tmp_path: Path) -> Path:
    path = tmp_path / "small.gcode"
    path.write_bytes(SMALL)
    return path


# -- the disk --


@contextlib.contextmanager
def no_file_above(size: int) -> Iterator[None]:
    """As on a full disk, every write beyond so many bytes fails."""
    usual = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, usual[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, usual)
        signal.signal(signal.SIGXFSZ, before)


@pytest.mark.parametrize("size", [0, 700, 2000])
def test_a_full_disk(small: Path, size: int) -> None:
    compensated(small, small.with_name("warm"))
    with no_file_above(size):
        sentence = refused(small)
    assert str(small) in sentence and os.strerror(errno.EFBIG) in sentence
    assert small.read_bytes() == SMALL and names(small.parent) == ["small.gcode", "warm"]


# -- others --


def once(do: Callable[[], object]) -> Callable[[float], None]:
    """Progress that does something else when the print has been read and half of it is written."""
    left = [do]
    return lambda share: left.pop()() and None if left else None


def test_a_file_that_is_sliced_again_meanwhile(small: Path) -> None:
    newer = SMALL + b"; newer\n"
    assert "Another program changed the file" in refused(small, progress=once(lambda: small.write_bytes(newer)))
    assert small.read_bytes() == newer and names(small.parent) == ["small.gcode"]


def test_a_file_that_another_has_taken_the_place_of(small: Path) -> None:
    def replace() -> None:
        other = small.with_name("other")
        other.write_bytes(SMALL)
        os.utime(other, ns=(small.stat().st_atime_ns, small.stat().st_mtime_ns))
        other.replace(small)

    assert "Another program changed the file" in refused(small, progress=once(replace))
    assert small.read_bytes() == SMALL and names(small.parent) == ["small.gcode"]


def test_a_file_that_is_deleted_meanwhile(small: Path) -> None:
    assert os.strerror(errno.ENOENT) in refused(small, progress=once(small.unlink))
    assert names(small.parent) == []


def test_two_at_once(small: Path) -> None:
    """One of them wins; the file is compensated once, whole."""
    both = threading.Barrier(2)
    failures: list[OSError] = []

    def work() -> None:
        try:
            compensated(small, progress=once(both.wait))
        except OSError as error:
            failures.append(error)

    threads = [threading.Thread(target=work) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(failures) <= 1
    out = small.read_bytes()
    assert original(out) == SMALL and out.count(b"; Processed by ffcomp") == 2  # in its head and its tail
    assert names(small.parent) == ["small.gcode"]


# -- names and links --


@pytest.mark.parametrize(
    "name",
    [
        "with spaces.gcode",
        "quo'te\"s.gcode",
        "new\nline.gcode",
        "-m.gcode",
        "立" * 83 + ".gcode",
        "%s{}$HOME",
        ".gcode.pp",
    ],
    ids=lambda name: name[:12],
)
def test_any_name(tmp_path: Path, name: str) -> None:
    file = tmp_path / name
    file.write_bytes(SMALL)
    compensated(file)
    assert original(file.read_bytes()) == SMALL != file.read_bytes() and names(tmp_path) == [name]


def test_links(small: Path) -> None:
    """A symbolic link is followed; a hard link's other name keeps the original."""
    other, link, dangling, loop = (small.with_name(name) for name in ("other", "link", "dangling", "loop"))
    os.link(small, other)
    link.symlink_to(small.name)
    dangling.symlink_to("nowhere")
    loop.symlink_to(loop.name)
    compensated(link)
    assert link.is_symlink() and already_processed(small.read_bytes()) and other.read_bytes() == SMALL
    assert os.strerror(errno.ENOENT) in refused(dangling)
    assert os.strerror(errno.ELOOP) in refused(loop)
    compensated(other, dangling)
    assert dangling.is_symlink() and already_processed(small.with_name("nowhere").read_bytes())


# -- the process --

LONG = SMALL + b"".join(b"G1 X%d Y%d E.1\n%b" % (k % 40, k * 7 % 40, b"M400\n" * (k % 50 == 0)) for k in range(6_000))


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL], ids=lambda number: number.name)
def test_killed_half_way(tmp_path: Path, number: signal.Signals) -> None:
    """Even when nothing can be cleared away the print is whole; what is left then is a hidden file, no print."""
    file = tmp_path / "long.gcode"
    file.write_bytes(LONG)
    command = "from ffcomp.cli.app import main; main()"
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "FFCOMP_LOG": "off"}
    arguments = ["compensate", "-m", "mp-delta-pro", "-q", "--no-predict", str(file)]
    process = subprocess.Popen([sys.executable, "-c", command, *arguments], env=environment)
    while process.poll() is None and not any(tmp_path.glob(".ffcomp-*.tmp")):  # it is written to at the end
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(1.0)
    process.send_signal(number)
    code = process.wait(60)
    assert code == (128 + signal.SIGTERM if number == signal.SIGTERM else -signal.SIGKILL)
    assert file.read_bytes() == LONG
    left = [name for name in names(tmp_path) if name != file.name]
    assert left == [] if number == signal.SIGTERM else len(left) == 1 and left[0].startswith(".ffcomp-")


def test_compiled_code_has_a_place_where_nothing_else_is_writable(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv(VARIABLE, "")  # so that it is as before afterwards: what other tests start would compile anew
    monkeypatch.delenv(VARIABLE)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(os, "access", lambda *_: False)
    ensure_cache_folder()
    folder = Path(os.environ[VARIABLE])
    assert folder.parent == tmp_path and stat.S_IMODE(folder.stat().st_mode) == 0o700
    monkeypatch.delenv(VARIABLE)
    ensure_cache_folder()
    assert Path(os.environ[VARIABLE]) == folder
    folder.chmod(0o777)  # now anybody can have put code into it
    monkeypatch.delenv(VARIABLE)
    ensure_cache_folder()
    assert Path(os.environ[VARIABLE]) != folder
