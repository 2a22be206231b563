"""One file to be compensated: read, checked, written, reported. What the command line and integrations call."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ffcomp import __version__
from ffcomp.invert.inverter import Inverter
from ffcomp.invert.settings import Settings
from ffcomp.pipeline import Summary, compensate, plan_program, settings_for
from ffcomp.predict import Prediction
from ffcomp.writer import OURS
from gcode.container import replace_atomically
from gcode.dialects import FLAVORS, detect_flavor, shaper_off
from gcode.errors import UnsupportedGcode
from gcode.metadata import Stamp, find_stamp, stamp_line
from gcode.reader import read_program
from models.machine import Machine

STAMP_REACH = 1 << 20  # bytes at either end in which a stamp is looked for


def already_processed(data: bytes) -> Stamp | None:
    """The stamp of an earlier run, if there is one."""
    return find_stamp(data[:STAMP_REACH], data[-STAMP_REACH:])


class Job:
    """A G-code file and the machine it is for."""

    def __init__(
        self,
        data: bytes,
        path: str,
        machine: Machine,
        *,
        offset: tuple[float, float] = (0.0, 0.0),
        flavor: str = "",
        predict: bool = True,
        settings: Settings | None = None,
        shaper_off: bool = False,
        inverter: Inverter | None = None,
    ) -> None:
        self.started = time.perf_counter()
        self.path, self.machine, self.offset = path, machine, offset
        self.program = read_program(data, path, offset_mm=offset, flavor=flavor or None)
        self.flavor = flavor or detect_flavor(self.program.lines)
        if self.flavor not in FLAVORS:
            raise UnsupportedGcode(f"The flavor {flavor!r} is none of {', '.join(sorted(FLAVORS))}.", path=path)
        self.planned = plan_program(self.program, machine, offset)
        self.print_time_s = self.planned.trajectory.end_t
        self.inverter = inverter or Inverter(machine, settings or settings_for(machine))
        self.shaper_off = shaper_off
        self.summary = Summary(warnings=_not_modelled(self.inverter))
        if predict:
            self.summary.prediction = Prediction(self.inverter, self.print_time_s)
        self.compute_time_s = 0.0

    def write(self, target: Path | None, progress: Callable[[float], None] = lambda done_s: None) -> None:
        """Compensate into `target` (None: nowhere), which is replaced whole at the end or not at all."""
        lines = self.lines(progress)
        if target is None:
            for _ in lines:
                pass
        else:
            replace_atomically(target, lines)
        self.compute_time_s = time.perf_counter() - self.started

    def lines(self, progress: Callable[[float], None] = lambda done_s: None) -> Iterator[bytes]:
        """The compensated file, stamped in head and tail."""
        stamp = stamp_line(__version__, self.machine.name, self.machine.sha256, self.flavor)
        body = compensate(self.planned, self.machine, self.inverter, self.flavor, self.summary, progress, self.offset)
        if self.shaper_off:
            body = _with_shaper_off(body, self.flavor)
        return _stamped(body, stamp, offset_line(self.offset))

    def result(self) -> dict[str, Any]:
        """The JSON object of `compensate`."""
        summary = self.summary
        tracks = summary.prediction.tracks() if summary.prediction else {}
        return {
            "schema": "ffcomp-compensate/1",
            "input": self.path,
            "machine": {"name": self.machine.name, "sha256": self.machine.sha256},
            "flavor": self.flavor,
            "print_time_s": summary.print_time_s,
            "original_print_time_s": summary.original_print_time_s,
            "compute_time_s": self.compute_time_s,
            "moves": summary.moves,
            "segments": summary.segments,
            "windows": summary.windows,
            "limited_windows": summary.limited_windows,
            "warnings": [*self.program.warnings, *summary.warnings],
            "predicted": {name: asdict(track) for name, track in tracks.items()},
            "predicted_over_s": summary.prediction.covered_s if summary.prediction else 0.0,
        }


def _not_modelled(inverter: Inverter) -> list[str]:
    """A sentence, if the machine file lists effects that the command does not allow for."""
    names = ", ".join(inverter.not_modelled)
    return [f"The machine file lists effects that are not compensated: {names}."] if names else []


def _with_shaper_off(lines: Iterator[bytes], flavor: str) -> Iterator[bytes]:
    """The firmware's own shaper is switched off where our first block opens."""
    waiting = True
    for line in lines:
        if waiting and line.rstrip().endswith(OURS):
            waiting = False
            ending = b"\r\n" if line.endswith(b"\r\n") else b"\n"
            yield from (off.rstrip(b"\n") + OURS + ending for off in shaper_off(flavor))
        yield line


def offset_line(offset: tuple[float, float]) -> bytes:
    """Says what was added to every position, so that the original can be laid over the result; empty for nothing."""
    return b"; ffcomp offset_mm=%.6g,%.6g\n" % offset if any(offset) else b""


def find_offset(head: bytes) -> tuple[float, float]:
    """The offset that `offset_line` wrote; zero if it wrote none."""
    found = re.search(rb"^; ffcomp offset_mm=([-+.\de]+),([-+.\de]+)", head, re.MULTILINE)
    return (float(found[1]), float(found[2])) if found else (0.0, 0.0)


def _stamped(lines: Iterator[bytes], stamp: bytes, offset: bytes) -> Iterator[bytes]:
    """The stamp after the first line (slicers are known by it) and at the end, before a last line without newline."""
    first = next(lines, b"")
    yield first if first.endswith(b"\n") else first + b"\n"
    ending = b"\r\n" if first.endswith(b"\r\n") else b"\n"
    stamp = stamp.rstrip(b"\n") + ending
    yield stamp
    if offset:
        yield offset.rstrip(b"\n") + ending
    last = b""
    for line in lines:
        yield last
        last = line
    complete = last.endswith(b"\n")
    yield last if complete else stamp
    yield stamp if complete else last
