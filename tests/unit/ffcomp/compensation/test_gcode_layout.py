"""A run that is laid out and written piece by piece: the same text as at one go."""

from __future__ import annotations

from functools import cache

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from ffcomp.compensation.gcode_layout import Tile, tiles, timeline
from ffcomp.compensation.gcode_writer import GcodeRenderer
from ffcomp.compensation.plan import Context, PlannedChunk
from ffcomp.firmware.program import PlannedProgram, plan_program
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.reference import Reference
from ffcomp.inverse.settings import CUT, Settings, settings_for
from gcode.dialect import KLIPPER
from gcode.embedded import original
from gcode.reader import read_program
from models.arrays import FloatArray
from tests.support.machines import machine


@cache
def inverse_settings() -> Settings:
    return settings_for(machine())


def smoothed(path: FloatArray, knots: int = 9) -> FloatArray:
    """A command as busy as a compensated one: corners become curves. (n + 1, 3) mm"""
    padded = np.concatenate([path[:1].repeat(knots // 2, axis=0), path, path[-1:].repeat(knots // 2, axis=0)])
    inside = np.lib.stride_tricks.sliding_window_view(padded, knots, axis=0).mean(axis=-1)
    inside[[0, -1]] = path[[0, -1]]
    return np.ascontiguousarray(inside)


def written(data: bytes, length: int) -> tuple[bytes, int]:
    """The program with every run cut into pieces of so many knots (0: whole), and how many segments it took."""
    program = read_program(data, "print.gcode", flavor=KLIPPER)
    planned: PlannedProgram = plan_program(program, machine())
    model = InverseModel(machine(), inverse_settings())
    writer = GcodeRenderer(PlannedChunk.whole(planned), Context(model, KLIPPER))
    text: list[bytes] = []
    taken = 0
    for run in planned.sections:
        before = [event for event in program.events[taken:] if event.move <= run.first]
        inside = [event for event in program.events[taken:] if run.first < event.move < run.last]
        taken += len(before) + len(inside)
        for event in before:
            text += writer.event(event)
        if not run.travels:
            text += writer.extrude(run)
            continue
        wanted = Reference(planned.trajectory, run, writer.settings)
        command = smoothed(wanted.at_knots(np.arange(wanted.knots + 1)))
        for tile in tiles(wanted.knots, length) if length else [Tile(0, 0, wanted.knots, wanted.knots)]:
            vertices = command[tile.first : tile.last + 1]
            events = timeline(program, planned.trajectory, run, wanted, vertices, inside, tile)
            text += writer.tile(run.first, vertices, events)
    for event in program.events[taken:]:
        text += writer.event(event)
    return b"".join([*text, *writer.close()]), writer.segments


START = b"G28\nG90\nM83\nG1 Z0.3 F6000\nG1 X10 Y10 F9000\n"

body = st.lists(
    st.one_of(
        st.tuples(st.integers(-40, 40), st.integers(-40, 40), st.integers(1, 900)).map(
            lambda p: b"G1 X%d Y%d E.%03d F4800\n" % p
        ),
        st.tuples(st.integers(-40, 40), st.integers(-40, 40)).map(lambda p: b"G1 X%d Y%d E-.8 F6000\n" % p),
        st.tuples(st.integers(-40, 40), st.integers(-40, 40)).map(lambda p: b"G1 X%d Y%d F6000\n" % p),
        st.sampled_from(
            [
                b"; a comment\n",
                b"M106 S128\n",
                b"M204 S3000\n",
                b"M220 S80\n",
                b"M221 S95\n",
                b"G92 E0\n",
                b"M82\nG92 E0\n",
                b"M83\n",
                b"G91\nG1 X1 Y-1 E.1\nG90\n",
                b"G4 P80\n",
                b"G1 F5000\n",
            ]
        ),
    ),
    min_size=1,
    max_size=40,
)


def spiral(turns: int, every: int) -> list[bytes]:
    """A vase: chords of a rising circle, a comment after every so many."""
    t = np.arange(0.0, 2 * np.pi * turns, 0.05)
    chords = [b"G1 X%.3f Y%.3f Z%.3f E.03\n" % (20 * np.cos(a), 20 * np.sin(a), 0.3 + a / 30) for a in t.tolist()]
    return [chord + b";AT:%d\n" % k if k % every == 0 else chord for k, chord in enumerate(chords)]


# wipes whose junctions lean on each other for more than a second
WIPES = [
    b"G1 X-21 Y22 E.035 F4800\nG1 X21 Y-38 E-.8 F6000\nG1 X11 Y0 E-.8 F6000\nM82\nG92 E0\n",
    b"G1 X-15 Y3 E-.8 F6000\nG1 X0 Y-16 E.001 F4800\nG1 X1 Y16 E.041 F4800\nG1 X35 Y-31 E-.8 F6000\n",
    b"G1 X-4 Y0 E-.8 F6000\nG1 X0 Y0 E-.8 F6000\nG1 X0 Y0 E-.8 F6000\nG1 X-13 Y1 E.002 F4800\n",
    b"G1 X-17 Y0 E.001 F4800\n; a comment\nG1 X0 Y-4 E-.8 F6000\nG1 X0 Y0 E.001 F4800\n",
]


@settings(max_examples=25, deadline=None)
@given(body)
@example(spiral(5, 1))
@example(spiral(5, 17))
@example([b"G1 X%d Y0 E1 F9000\n" % x for x in (30, -30, 31, -31)])  # long straight moves: joined up to every cut
@example(WIPES)
def test_pieces_say_what_the_whole_says(lines: list[bytes]) -> None:
    data = START + b"".join(lines) + b"G1 X0 Y0\n"
    whole = written(data, 0)
    for length in (CUT, 3 * CUT):
        assert written(data, length) == whole
    assert original(whole[0]) == data
