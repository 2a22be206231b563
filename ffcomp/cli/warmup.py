"""`ffcomp warmup`: compile the numerical code once, after installing, with progress.

The virtual printer's kernels take half of the time. A second process compiles them in parallel.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from ffcomp.cli.command import verb
from ffcomp.cli.common import collect_rarely, say
from ffcomp.cli.progress import Event

PRINT = """\
G28
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
PRINTERS = "from ffcomp.cli.warmup import compile_printers; compile_printers()"


@verb
def warmup() -> None:
    """Compile the numerical code once, so that the first print need not wait.

    Run it after installing or updating. If everything is compiled already, it takes a few seconds.

    Example: ffcomp warmup
    """
    from models.compiled import ahead

    if ahead():
        print("Nothing to compile: this ffcomp came compiled.")
        return
    with _printers_beside() as printers:
        begin = time.perf_counter()
        steps = list(_steps(printers))
        say("Compiling once; later runs reuse the result.")
        for number, (name, step) in enumerate(steps, 1):
            since = time.perf_counter()
            Event(f"compiling once: {name}", (number - 1) / len(steps)).write()
            step()
            say(f"[{number}/{len(steps)}] {name}: {time.perf_counter() - since:.1f} s")
        print(f"Ready after {time.perf_counter() - begin:.0f} s.")


def compile_printers() -> None:
    """Compile the kernels of the virtual printers: let each rest for some rows."""
    import numpy as np

    from models.file import load_machine
    from models.printer.printer import simulate_printer

    collect_rarely()
    for name in MACHINES.values():
        machine = load_machine(name)
        rest = np.repeat(machine.kinematics.inverse(np.array([[0.0, 0.0, 20.0]])), 40, axis=0)
        simulate_printer(machine, rest, 1e-3)


@contextmanager
def _printers_beside() -> Iterator[subprocess.Popen[bytes]]:
    """Compile the printers in a process of its own; should it fail, the steps that need them compile them here."""
    process = subprocess.Popen([sys.executable, "-c", PRINTERS], stderr=subprocess.DEVNULL, start_new_session=True)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def _steps(printers: subprocess.Popen[bytes]) -> Iterator[tuple[str, Callable[[], object]]]:
    """Yield what compiles, each with its name."""
    for kind, machine in MACHINES.items():
        yield f"compensate, {kind}", partial(_run, "", machine)
        yield f"compensate --robust on, {kind}", partial(_run, "", machine, robust="on", predict=False)
    yield "compensate, Marlin", partial(_run, "", MACHINES["straight axes"], flavor="marlin", predict=False)
    yield "estimate", partial(_run, "estimate", MACHINES["a delta"], predict=False)
    yield "virtual printers", printers.wait
    for kind, machine in MACHINES.items():
        yield f"simulate, {kind}", partial(_run, "simulate", machine, predict=False)


def _run(verb: str, machine: str, **options: Any) -> None:
    """Compensate the print, and do the verb with it."""
    from tempfile import TemporaryDirectory

    import ffcomp

    with TemporaryDirectory(prefix="ffcomp-") as folder:
        file = Path(folder, SUBJECT)
        file.write_text(PRINT, encoding="ascii")
        ffcomp.compensate(file, machine, file, **options)
        if verb:
            getattr(ffcomp, verb)(file, machine)
