"""`ffcomp warmup`: compile the numerical code once, after installing, with progress."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

PRINT = """\
G28
G90
M83
SET_VELOCITY_LIMIT VELOCITY=300 ACCEL=5000 SQUARE_CORNER_VELOCITY=5
G1 X50 Y50 Z20 F6000
G1 X60 Y50 E.3 F6000
G1 X60 Y60 E.3
G1 E-2 F1800
G1 X40 Y60 F9000
G1 E2 F1800
G3 X50 Y50 I10 J0 E.5 F6000
G1 X52 Y40 E.3
M106 S128
G1 X60 Y41 E.3
"""
MACHINES = {"a delta": "kossel", "straight axes": "voron-300"}
SUBJECT = "warmup.gcode"


def warmup() -> None:
    """Compile the numerical code once, so that the first print need not wait.

    Run it after installing or updating. What has been compiled before takes a few seconds.

    Example: ffcomp warmup
    """
    import time

    from ffcomp.cli.common import exit_codes, say
    from ffcomp.cli.compiled import VERBS, note_compiled

    with exit_codes():
        begin = time.perf_counter()
        steps = list(_steps())
        say("Compiling once; what is compiled is kept.")
        for number, (name, step) in enumerate(steps, 1):
            since = time.perf_counter()
            step()
            say(f"[{number}/{len(steps)}] {name}: {time.perf_counter() - since:.1f} s")
        for verb in VERBS:
            note_compiled(verb)
        print(f"Ready after {time.perf_counter() - begin:.0f} s.")


def _steps() -> Iterator[tuple[str, Callable[[], None]]]:
    """Yield what compiles, each with its name."""
    for kind, machine in MACHINES.items():
        yield f"compensate, {kind}", partial(_in_a_folder, _compensate, machine)
        yield f"simulate, {kind}", partial(_in_a_folder, _simulate, machine)
    yield "estimate", partial(_in_a_folder, _estimate, MACHINES["a delta"])


def _in_a_folder(do: Callable[[Path, str], None], machine: str) -> None:
    from tempfile import TemporaryDirectory

    with TemporaryDirectory(prefix="ffcomp-") as folder:
        file = Path(folder, SUBJECT)
        file.write_text(PRINT, encoding="ascii")
        do(file, machine)


def _compensate(file: Path, machine: str) -> None:
    from ffcomp.api import compensate

    compensate(file, machine, file.with_suffix(".out"))


def _simulate(file: Path, machine: str) -> None:
    from ffcomp.api import compensate, simulate

    compensate(file, machine, file, predict=False)
    simulate(file, machine)


def _estimate(file: Path, machine: str) -> None:
    from ffcomp.api import estimate

    estimate(file, machine)
