"""How fast commands become text: the writer alone, stage by stage, in µs per segment.

    python -m benchmarks.writer_speed [--json] [--rounds N] [PRINT ...]

The command is the planned path with its corners smoothed, which takes about as many segments as a compensated one; runs
are written in pieces of the usual length. Every round goes through the whole print; each stage's best of N (5) counts.

    lines      where the original's lines go out, and the filament at every knot (`marks.timeline`)
    join       which points are worth a segment (`segment_merging.merge`)
    speeds     F of each segment, so that it lasts as long as it should (`played.played`)
    text       the `G1` lines (`MoveWriter.block`)
    in Python  the same lines, one number at a time
    write      join, speeds, text, what lies between them, and the original's lines (`Writer.run`)
"""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = "1"  # one core: said before numpy starts its threads
os.environ["OPENBLAS_NUM_THREADS"] = "1"

import argparse
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ffcomp.compensation.gcode_layout import Timeline, tiles, timeline
from ffcomp.compensation.gcode_writer import Writer
from ffcomp.firmware.program import PlannedProgram, plan_program
from ffcomp.firmware.table import FIRMWARES
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.reference import Reference
from ffcomp.inverse.settings import CUT, settings_for
from ffcomp.planner.segment_merging import merge
from ffcomp.planner.segment_timing import segment_speeds
from ffcomp.planner.trajectory import Section
from gcode.dialects import detect_flavor
from gcode.emit import MoveWriter
from gcode.program import Event, ModalState
from gcode.reader import read_program
from models.file import load_machine
from tests.unit.ffcomp.compensation.test_gcode_layout import smoothed
from tests.unit.gcode.test_emit import Said

ROOT = Path(__file__).parents[1]
PRINTS = [ROOT / "sample_prints" / f"{name}.gcode" for name in ("ringing_tower", "lobed_vase", "far_star")]
STAGES = ("lines", "join", "speeds", "text", "in Python", "write")

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Row:
    """One print."""

    segments: int
    lines: int  # of the original, inside runs
    us_per_segment: dict[str, float]  # by stage


class Round:
    """The whole print once, with the time each stage takes."""

    def __init__(self, planned: PlannedProgram, model: InverseModel) -> None:
        self.planned, self.settings = planned, model.settings
        firmware = FIRMWARES[detect_flavor(planned.program.lines)]
        self.writer = Writer(planned.program, model.settings, firmware.segments(model))
        self.lines = 0
        self.seconds = dict.fromkeys(STAGES, 0.0)

    def timed(self, stage: str, work: Callable[..., Any], *inputs: Any) -> Any:
        began = time.perf_counter()
        answer = work(*inputs)
        self.seconds[stage] += time.perf_counter() - began
        return answer

    def go(self) -> Round:
        for run, inside in _runs(self.planned):
            wanted = Reference(self.planned.trajectory, run, self.settings)
            command = smoothed(wanted.at_knots(np.arange(wanted.knots + 1)))
            for piece in tiles(wanted.knots):
                vertices = command[piece.first : piece.last + 1]
                place = (self.planned.program, self.planned.trajectory, run, wanted, vertices, inside, piece)
                line_up = self.timed("lines", timeline, *place)
                self.lines += len(line_up.line)
                self.timed("write", lambda *inputs: list(self.writer.section(*inputs)), run.first, vertices, line_up)
                self.stages(vertices, line_up)
        return self

    def stages(self, vertices: FloatArray, line_up: Timeline) -> None:
        """The parts of `Writer.run` by themselves, on the same piece."""
        s, at = self.settings, line_up.at
        knots = np.arange(line_up.tile.first, line_up.tile.last + 1)
        points = np.stack([np.interp(at, knots, axis) for axis in vertices.T], axis=1).round(4)
        kept = self.timed("join", merge, at, points, line_up.e, line_up.cut, s.merging, CUT)
        points, e, lasting = points[kept], line_up.e[kept], np.diff(at[kept]) * s.segment_s
        speeds = self.timed("speeds", segment_speeds, points, np.diff(e), lasting, s.output).cruise
        block = self.timed("text", MoveWriter().block, points[1:], e[1:], speeds)[0]
        rows = list(zip(np.column_stack([points, e])[1:].tolist(), speeds.tolist(), strict=True))
        said = Said(ModalState())
        assert block == b"".join(self.timed("in Python", lambda: [said.line(*row) for row in rows]))


def _runs(planned: PlannedProgram) -> Iterator[tuple[Section, list[Event]]]:
    """Every run in which the nozzle moves, and the events inside it."""
    events = planned.program.events
    for run in planned.sections:
        if run.travels:
            yield run, [event for event in events if run.first < event.move < run.last]


def measure(path: Path, rounds: int) -> Row:
    machine = load_machine("mp-delta-pro")
    planned = plan_program(read_program(path.read_bytes(), path.name), machine)
    model = InverseModel(machine, settings_for(machine))
    done = [Round(planned, model).go() for _ in range(rounds)]
    segments = done[0].writer.segments
    best = {stage: 1e6 * min(each.seconds[stage] for each in done) / segments for stage in STAGES}
    return Row(segments, done[0].lines, best)


def as_table(rows: dict[str, Row]) -> str:
    lines = [f"| print | segments | original lines | {' | '.join(STAGES)} |", "|---" * (3 + len(STAGES)) + "|"]
    for name, row in rows.items():
        numbers = " | ".join(f"{row.us_per_segment[stage]:.2f}" for stage in STAGES)
        lines.append(f"| {name} | {row.segments} | {row.lines} | {numbers} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description="Microseconds of writing per segment, by stage.")
    parser.add_argument("prints", nargs="*", type=Path, default=PRINTS)
    parser.add_argument("--json", action="store_true", help="one JSON object instead of a table")
    parser.add_argument("--rounds", type=int, default=5, help="of each print; the best one counts")
    options = parser.parse_args()
    rows = {path.stem: measure(path, options.rounds) for path in options.prints}
    found = {"schema": "ffcomp-writer-speed/1", "prints": {name: asdict(row) for name, row in rows.items()}}
    print(json.dumps(found) if options.json else as_table(rows))


if __name__ == "__main__":
    main()
