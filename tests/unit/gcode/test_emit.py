from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from gcode.emit import MoveWriter
from gcode.program import ModalState
from gcode.reader import read_program


def writer(frame: ModalState = ModalState(), e: float = 0.0) -> MoveWriter:  # noqa: B008 - frozen
    made = MoveWriter()
    made.reset(frame, (0.0, 0.0, 0.0), e)
    return made


def test_the_frame_decides_the_numbers() -> None:
    frame = ModalState(base=(1.0, 0.0, 0.0, 2.0), unit_mm=25.4, flow=0.5, feed_factor=2.0)
    assert writer(frame).move(26.4, 0.0, 25.4, 14.7, 50.8) == b"G1 X1 Z1 E1 F60\n"
    assert writer(ModalState(absolute=False, absolute_e=False)).move(1.0, 0.0, 0.0, 2.0, 1.0) == b"G1 X1 E2 F60\n"


@given(st.lists(st.floats(-1e-4, 1e-4), min_size=1, max_size=200), st.floats(0, 100))
def test_relative_filament_never_strays(steps: list[float], first: float) -> None:
    lines = writer(ModalState(absolute_e=False), first)
    true = first + np.cumsum(steps)
    written = first
    for k, e in enumerate(true.tolist()):
        line = lines.move(float(k + 1), 0.0, 0.0, e, 10.0)
        written += sum(float(word[1:]) for word in line.split() if word.startswith(b"E"))
        assert abs(written - e) < 1.0001e-5  # half a count at either end
        assert b"-0 " not in line and b"e-" not in line


coordinates = st.lists(st.floats(-300, 300), min_size=4, max_size=4)
frames = st.builds(
    ModalState,
    base=st.tuples(*[st.floats(-100, 100)] * 4),
    unit_mm=st.sampled_from([1.0, 25.4]),
    absolute=st.booleans(),
    flow=st.floats(0.5, 2),
    feed_factor=st.floats(0.5, 2),
).map(lambda f: ModalState(f.base, f.unit_mm, f.absolute, f.absolute, f.flow, f.feed_factor))


class Said:
    """The same lines, one number at a time, with Python's own formatting."""

    def __init__(self, frame: ModalState) -> None:
        self.frame = frame
        self.last: list[int] = [round(-base * per) for base, per in zip(frame.base, self.per_mm(), strict=True)]
        self.last_f = -1

    def per_mm(self) -> tuple[float, ...]:
        unit = self.frame.unit_mm
        return (10_000 / unit, 10_000 / unit, 10_000 / unit, 100_000 / (unit * self.frame.flow))

    def line(self, place: list[float], speed: float) -> bytes:
        frame, words = self.frame, ""
        counts = [round((x - base) * per) for x, base, per in zip(place, frame.base, self.per_mm(), strict=True)]
        for axis, now, was, decimals in zip("XYZE", counts, self.last, (4, 4, 4, 5), strict=True):
            absolute = frame.absolute_e if axis == "E" else frame.absolute
            if now != was:
                words += f" {axis}{self.number(now if absolute else now - was, decimals)}"
        self.last = counts
        if not words:
            return b""
        f = round(speed * (60_000 / frame.feed_factor / frame.unit_mm))
        if f != self.last_f:
            words += f" F{self.number(max(f, 1), 3)}"
            self.last_f = f
        return f"G1{words}\n".encode()

    @staticmethod
    def number(counts: int, decimals: int) -> str:
        text = f"{counts / 10**decimals:.{decimals}f}"
        short = text.rstrip("0").rstrip(".")
        return short.replace("0.", ".", 1) if short.lstrip("-").startswith("0.") else short


far = st.one_of(st.floats(-300, 300), st.floats(-1e6, 1e6), st.integers(-3000, 3000).map(lambda k: k * 1e-4))
places = st.lists(st.tuples(far, far, far, far, st.floats(0, 1000)), min_size=1, max_size=30)


@given(places, frames, st.booleans())
@example([(1e6, -1e6, 999999.9999, 99999.99999, 0.0), (0.0001, -0.0001, -0.5, 1e-5, 1e-9)], ModalState(), True)
def test_every_number_is_written_as_python_would(
    rows: list[tuple[float, float, float, float, float]], frame: ModalState, relative_e: bool
) -> None:
    frame = frame._replace(absolute_e=not relative_e)
    said, many = Said(frame), writer(frame)
    table = np.array(rows)
    stated = np.empty((len(rows), 3))
    text, ends = many.block(table[:, :3], table[:, 3], table[:, 4], stated=stated)
    assert stated[-1].tolist() == list(many.place[:3])
    expected = [said.line([x, y, z, e], speed) for x, y, z, e, speed in rows]
    assert text == b"".join(expected)
    assert ends.tolist() == np.cumsum([len(line) for line in expected]).tolist()


def test_a_number_that_is_none_is_refused() -> None:
    with pytest.raises(ValueError, match="not finite"):
        writer().move(1.0, float("nan"), 0.0, 0.0, 10.0)


@given(st.lists(coordinates, min_size=1, max_size=20))
def test_what_is_written_is_read_back(points: list[list[float]]) -> None:
    lines = writer().moves(np.array(points), np.full(len(points), 30.0))
    moves = read_program(b"".join(lines), start=(0.0, 0.0, 0.0)).moves
    if len(moves):
        assert np.abs(moves.end[-1] - points[-1]).max() <= 0.51e-4
        assert moves.speed == pytest.approx(30)
