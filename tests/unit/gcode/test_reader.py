from __future__ import annotations

import math
import re
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from gcode.errors import GcodeError
from gcode.program import EventKind, Program
from gcode.reader import read_program
from tests.support.data import PRINTS, real

HOME = (0.0, 0.0, 0.0)


def read(*lines: str, **options) -> Program:
    return read_program("\n".join(lines).encode(), start=options.pop("start", HOME), **options)


def kinds(program: Program) -> list[EventKind]:
    return [event.kind for event in program.events]


def ends(program: Program) -> list[list[float]]:
    return program.moves.end.round(9).tolist()


def check_whole(program: Program, data: bytes) -> None:
    """Every byte is kept, and every line is moves or one event, in order."""
    assert b"".join(program.lines) == data
    of_events = [event.line for event in program.events]
    assert of_events == sorted(of_events)
    assert sorted({*program.moves.line.tolist(), *of_events}) == list(range(len(program.lines)))
    assert len(set(program.moves.line.tolist())) + len(of_events) == len(program.lines)
    before = np.searchsorted(program.moves.line, of_events)
    assert before.tolist() == [event.move for event in program.events]
    assert np.isfinite(program.moves.end).all() and np.isfinite(program.moves.start).all()


# -- real files --


@pytest.mark.parametrize("name", PRINTS)
def test_real_prints_are_kept_whole(name: str) -> None:
    data = real(name)
    program = read_program(data, name)
    check_whole(program, data)
    moves = program.moves
    assert len(moves) > 1000
    assert (moves.speed > 0).all()
    jumps = np.flatnonzero((moves.start[1:] != moves.end[:-1]).any(axis=1)) + 1
    stops = {event.move for event in program.events if event.kind in (EventKind.RAW_MOVE, EventKind.STOP)}
    assert stops.issuperset(jumps.tolist())


def positions_by_regex(data: bytes) -> list[tuple[float, float, float]]:
    """Absolute XYZ after each G0/G1 that names one of them, by a reading of its own."""
    place: dict[str, float] = {}
    places = []
    for line in data.decode("latin-1").splitlines():
        if not re.match(r"G[01]\s", line):
            continue
        words = re.findall(r"([XYZ])(-?\d*\.?\d+)", line.split(";")[0])
        place.update((letter, float(number)) for letter, number in words)
        if words and len(place) == 3:
            places.append((place["X"], place["Y"], place["Z"]))
    return places


@pytest.mark.parametrize("name", ["gcodepreview_vase.gcode", "makreeltje_cura_slicer.gcode"])
def test_positions_agree_with_a_simple_reading(name: str) -> None:
    data = real(name)
    moves = read_program(data).moves
    travelled = moves.end[np.any(moves.end[:, :3] != moves.start[:, :3], axis=1), :3]
    simple = np.array(positions_by_regex(data))
    simple = simple[1:][np.any(np.diff(simple, axis=0) != 0, axis=1)]
    assert len(travelled) <= len(simple) <= len(travelled) + 10  # less those around homing and in END_PRINT
    at = len(simple) - len(travelled)
    assert min(np.abs(simple[k : k + len(travelled)] - travelled).max() for k in range(at + 1)) < 1e-9


# -- modes --


@given(st.floats(0.2, 3), st.floats(0.2, 3), st.booleans(), st.booleans(), st.lists(st.integers(-50, 50)))
@settings(max_examples=50)
def test_a_frame_turns_places_back_into_the_numbers_of_the_file(
    flow: float, feed: float, inches: bool, renamed: bool, xs: list[int]
) -> None:
    head = [f"M221 S{flow * 100:.4f}", f"M220 S{feed * 100:.4f}", "G20" if inches else "G21", "G92 X3 E2" * renamed]
    moves = [f"G1 X{x} E{x + 7} F{abs(x) + 1}" for x in xs]
    program = read(*head, *moves)
    for line, end, speed, number in zip(
        program.moves.line, program.moves.end, program.moves.speed, program.moves.frame, strict=True
    ):
        frame, x = program.frames[number], xs[line - 4]
        assert (end[0] - frame.base[0]) / frame.unit_mm == pytest.approx(x, abs=1e-9)
        assert (end[3] - frame.base[3]) / frame.flow / frame.unit_mm == pytest.approx(x + 7, abs=1e-9)
        assert 60 * speed / frame.feed_factor / frame.unit_mm == pytest.approx(abs(x) + 1)


# -- arcs --


def test_gcode_offset_is_added_once() -> None:
    program = read("G1 Z1 F600", "SET_GCODE_OFFSET Z=0.2", "G1 Z2", "SET_GCODE_OFFSET Z_ADJUST=0.1", "G1 Z3")
    assert program.moves.end[:, 2].tolist() == pytest.approx([1, 2.2, 3.3])


def test_a_helix_shares_height_and_filament_evenly() -> None:
    program = read("G1 X5 F600", "G3 X5 Y0 Z2 E4 I-5 J0")
    chords = program.moves.end[program.moves.line == 1]
    n = len(chords)
    assert chords[:, 2] == pytest.approx(np.arange(1, n + 1) * 2 / n)
    assert chords[:, 3] == pytest.approx(np.arange(1, n + 1) * 4 / n)
    assert np.hypot(*chords[:, :2].T) == pytest.approx(5)
    assert chords[-1].tolist() == [5, 0, 2, 4]


# -- limits --


def test_accel_to_decel_is_for_older_klippers_alone() -> None:
    """Klipper's default is half of the acceleration, which slicers write, too; 30 of 3000 would be a ratio of 0.99."""
    usual = read("SET_VELOCITY_LIMIT ACCEL=3000 ACCEL_TO_DECEL=1500", "G1 X1 F60", flavor="klipper")
    assert np.isnan(usual.moves.minimum_cruise_ratio).all() and usual.warnings == []
    gentle = read("SET_VELOCITY_LIMIT ACCEL=3000 ACCEL_TO_DECEL=30", "G1 X1 F60", flavor="klipper")
    assert np.isnan(gentle.moves.minimum_cruise_ratio).all() and "ratio of 0.99" in gentle.warnings[0]
    with pytest.raises(GcodeError, match="MINIMUM_CRUISE_RATIO=1; Klipper stops"):
        read("SET_VELOCITY_LIMIT MINIMUM_CRUISE_RATIO=1", flavor="klipper")


# -- properties --

numbers = st.decimals(-200, 200, places=3).map(str)
moves_text = st.builds(
    lambda code, words: code + "".join(f" {letter}{number}" for letter, number in words.items()),
    st.sampled_from(["G0", "G1", "g1"]),
    st.dictionaries(st.sampled_from("XYZE"), numbers),
)
other_text = st.sampled_from(
    ["", "; caf\xe9 \x00", "M106 S255", "G91", "G90", "M82", "M83", "G92 E0", "G92 X0 Y5", "G28", "G1 F1200"]
)
rare_text = st.sampled_from(
    """T0|M220 S90|M221 S95|G20|G21|G4 P1|SAVE_GCODE_STATE|PAUSE|SET_GCODE_OFFSET X=1|M204 S500|M106.5|M0107|M862.1 P0.4
    G92 E-1.5|G92 E1 X2|G1X1Y2E.5|G0\tX+1|G1 E5. ; out""".replace("\n    ", "|").split("|")
)
TAILS = ["", " Z1.5", " E.25", " E-1 Z-.5 F900", " ; round", " K1", " I1"]  # the last two are no plain arcs
program_text = st.lists(st.tuples(moves_text | other_text | rare_text, st.sampled_from(["\n", "\r\n"])), max_size=40)


@given(program_text, st.booleans())
def test_random_programs_are_kept_whole(lines: list[tuple[str, str]], known: bool) -> None:
    data = "".join(text + ending for text, ending in lines).encode("latin-1")
    check_whole(read_program(data, start=HOME if known else None), data)


circles_text = st.builds("{} I{} J{}{}".format, st.sampled_from(["G2", "G3"]), numbers, numbers, st.sampled_from(TAILS))


@given(st.lists(st.tuples(moves_text | other_text | rare_text | circles_text, st.sampled_from(["\n", "\r\n"]))))
def test_the_fast_and_the_general_way_agree(lines: list[tuple[str, str]]) -> None:
    agree([text for text, _ in lines], [ending for _, ending in lines])


@settings(deadline=None)
@given(
    st.tuples(numbers, numbers),
    st.floats(1e-3, 300),
    st.floats(0, 7),
    st.floats(-0.3, 0.3),
    st.sampled_from(["G2 X{x} Y{y} I{i} J{j}", "G3 Y{y}\tX{x} I{i} J{j}", "G2X{x}Y{y}J{j}I{i}", "G3 X{x} I{i} J{j}"]),
    st.sampled_from(TAILS),
)
def test_arcs_agree_too_and_are_refused_alike(
    start: tuple[str, str], radius: float, angle: float, off: float, arc: str, tail: str
) -> None:
    """The end lies on the circle, nearly on it, or too far from it."""
    i, j = radius * math.cos(angle), radius * math.sin(angle)
    x, y = float(start[0]) + i + radius + off, float(start[1]) + j
    said = arc.format(x=round(x, 4), y=round(y, 4), i=f"{i:.4f}", j=f"{j:.4f}")
    agree([f"G1 X{start[0]} Y{start[1]} F600", said + tail, "G1 X0 Y0"], ["\n"] * 3)


def agree(lines: list[str], endings: list[str]) -> None:
    """A round comment sends a line the general way."""
    slowed = [text + "(slowly)" * text.startswith(("G", "M")) for text in lines]
    fast, general = ("".join(map(str.__add__, texts, endings)).encode("latin-1") for texts in (lines, slowed))
    try:
        other = read_program(general, start=HOME)
    except GcodeError as error:
        with pytest.raises(GcodeError, match=re.escape(str(error))):
            read_program(fast, start=HOME)
        return
    one = read_program(fast, start=HOME)
    np.testing.assert_array_equal(one.moves.line, other.moves.line)
    np.testing.assert_array_equal(one.moves.end, other.moves.end)
    np.testing.assert_array_equal(one.moves.start, other.moves.start)
    np.testing.assert_array_equal(one.moves.speed, other.moves.speed)
    assert one.events == other.events
    assert one.frames == other.frames or any(math.isnan(b) for f in one.frames for b in f.base)


@given(st.from_regex(rb"[-+]?(\d{0,6}\.\d{1,12}|\d{1,6}\.?)", fullmatch=True))
@example(b"936138.6031371453")  # 16 digits: its quotient of integers is another double
def test_a_number_is_the_double_nearest_to_its_decimal(text: bytes) -> None:
    moves = read_program(b"G1 Y1 X" + text + b" F60\n", start=HOME).moves
    assert moves.end[0, 0] == float(text)


# -- places that are not known --


def test_a_macro_that_comes_back_keeps_the_place_and_others_do_not() -> None:
    for name in ("TIMELAPSE_TAKE_FRAME", "my_photo", "MY_PHOTO"):
        program = read("G1 X1 Y2 Z3 F600", name, "G1 X5", returns=["My_Photo"])
        assert ends(program)[1:] == [[5, 2, 3, 0]]
        assert program.events[0].returns
    assert kinds(read("G1 X1 Y2 Z3 F600", "MY_PHOTO", "G1 X5")) == [EventKind.STOP, EventKind.RAW_MOVE]


def test_where_only_z_is_not_known_it_is_taken_to_be_the_last() -> None:
    program = read(
        "G1 X1 Y2 Z3 F600", "MY_MACRO", "G1 X4 Y4", "G1 X5 E1", "G91", "G1 Z2", "G90", "G1 Y6", "G1 Z9 Y7", "G1 X7"
    )  # fmt: skip
    assert ends(program)[1:] == [[5, 4, 3, 1], [5, 4, 5, 1], [5, 6, 5, 1], [7, 7, 9, 1]]
    raw = [event.raw for event in program.events if event.kind is EventKind.RAW_MOVE]
    assert [(move.start[:3], move.end[:3]) for move in raw if move] == [((1, 2, 3), (4, 4, 3)), ((5, 6, 5), (5, 7, 9))]
    assert [program.frames[frame].z_known for frame in program.moves.frame] == [True, False, False, False, True]


# -- a signal --

INTERRUPTED = """
import signal
from gcode import reader
def end(number, frame): raise SystemExit(7)
def follow(*given, follow=reader.follow):
    signal.setitimer(signal.ITIMER_REAL, 0.005)
    return follow(*given)
reader.read_program(b"G1 X1 F9", start=(0, 0, 0))
signal.signal(signal.SIGALRM, end)
reader.follow = follow
reader.read_program(b"G1 X1 F9\\nG1 X2\\n" * 500_000, start=(0, 0, 0))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="has no alarm")
def test_a_signal_while_compiled_code_reads_ends_the_process_and_does_not_crash_it() -> None:
    assert subprocess.run([sys.executable, "-c", INTERRUPTED], check=False).returncode == 7
