"""The file of motion, as the module for Klipper's host reads it."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ffcomp.steps.crossings import Knots, on_grid
from ffcomp.steps.motion import MotionSink
from tests.support.klipper_host import reader
from tests.support.step_lookahead import played


def places(n: int, seed: int = 0) -> np.ndarray[Any, np.dtype[np.float64]]:
    """A winding path of n + 1 knots with filament, (n + 1, 4) mm on the grid."""
    noise = np.random.default_rng(seed).normal(size=(n + 1, 4)) * [0.02, 0.02, 1e-3, 2e-3]
    return on_grid(np.cumsum(np.cumsum(noise, axis=0), axis=0))


def read(path: Path) -> tuple[dict[str, Any], list[Any]]:
    stream, header = reader().open_motion(path)
    with stream:
        return header, list(reader().records(stream, header))


def kinds(records: list[Any]) -> str:
    """One letter a record: Text, Wait or Motion."""
    return "".join(type(record).__name__[0] for record in records)


def write(path: Path, *parts: tuple[float, Any], events: tuple[tuple[float, bytes], ...] = ()) -> None:
    with closing(MotionSink(path, {"compensated": True})) as sink:
        for event in events:
            sink.event(*event)
        for start_t, knots in parts:
            sink.knots(Knots(start_t, 0.004, knots))
            sink.rest(start_t + 0.004 * (len(knots) - 1))
        sink.finish()


def test_knots_come_back_exactly(tmp_path: Path) -> None:
    knots = places(5000)
    write(tmp_path / "x.ffm", (0.1, knots))
    header, records = read(tmp_path / "x.ffm")
    assert kinds(records) == "M" * header["records"]
    found = np.vstack([record.places[:-1] for record in records] + [records[-1].places[-1:]])
    np.testing.assert_array_equal(found, knots)
    assert all(record.spacing == 0.004 for record in records)
    assert header["duration_s"] == pytest.approx(20.0)
    np.testing.assert_allclose(header["highest_mm"], knots[:, :3].max(axis=0))
    assert [record.rests_before for record in records] == [True] + [False] * (len(records) - 1)
    assert [record.rests_after for record in records] == [False] * (len(records) - 1) + [True]


def test_lines_stand_where_their_moment_is(tmp_path: Path) -> None:
    """To the nearest knot; comments and waits, which the motion itself has, are left out."""
    events = ((0.1, b"M106 S9\n"), (0.1, b"; said\n"), (0.1 + 0.4 * 0.004, b"M117 a"), (0.1 + 30.4 * 0.004, b"M117 b"))
    later = ((0.1 + 0.4 + 0.2, b"G4 P200\r\n"), (0.1 + 0.4 + 0.2, b"M107\n"), (0.74, b"M84\n"))
    knots = places(100)
    write(tmp_path / "x.ffm", (0.1, knots), (0.7, knots[-1:] + places(10)), events=events + later)
    _, records = read(tmp_path / "x.ffm")
    assert kinds(records) == "TTMTMMMWTMT"
    assert [record.lines for record in records if hasattr(record, "lines")] == [
        ["M106 S9"],
        ["M117 a"],
        ["M117 b"],
        ["M107"],
        ["M84"],
    ]
    assert [len(record.places) - 1 for record in records if hasattr(record, "places")] == [30, 32, 32, 6, 10]
    assert records[7].seconds == pytest.approx(0.2)


@pytest.mark.parametrize("lines_before", [0, 3])
@pytest.mark.parametrize("ahead_s", [None, 0.3, 0.69])
def test_a_host_that_makes_steps_ahead_never_stops_on_the_path(
    tmp_path: Path, lines_before: int, ahead_s: float | None
) -> None:
    """In a real Klipper 6 of 14 starts stopped in a first record of two seconds."""
    lines = tuple((0.1, b"M117 %d" % k) for k in range(lines_before))
    write(tmp_path / "x.ffm", (0.1, places(3000)), events=lines)
    assert played(tmp_path / "x.ffm", ahead_s).stops == 0


@pytest.mark.parametrize("change", [lambda data: data[:-5], lambda data: b"G1 X1\n" + data, lambda data: data[:20]])
def test_a_damaged_file_is_refused(tmp_path: Path, change: Any) -> None:
    path = tmp_path / "x.ffm"
    write(path, (0.1, places(50)))
    path.write_bytes(change(path.read_bytes()))
    with pytest.raises(Exception, match=r"damaged|no file of motion"):
        read(path)
