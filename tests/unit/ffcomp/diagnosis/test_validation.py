"""Runs that must be refused, as files in the hands of a user: one clear sentence, exit 5, nothing written."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from ffcomp.cli.app import app
from ffcomp.measurement.sensors import misplaced
from tests.support.cli import CliRunner
from tests.support.data import DATA, needed

CASE = DATA / "runs" / "effector-mass"
ROWS = slice(800, 4000)
SENSORS = [f"acc_{axis}_m_per_s2" for axis in "ABCxyz"]
COMMAND = [f"cmd_{axis}_mm" for axis in "ABC"]


@dataclass(frozen=True)
class Sheet:
    """A run to be spoilt."""

    columns: tuple[str, ...]
    values: NDArray[np.float64]  # (n, columns)

    def changed(self, change: Callable[[NDArray[np.float64]], object], *names: str) -> Sheet:
        """With `change` done in place to each of these columns."""
        values = self.values.copy()
        for name in names:
            change(values[:, self.columns.index(name)])
        return replace(self, values=values)

    def without(self, *names: str) -> Sheet:
        keep = [i for i, name in enumerate(self.columns) if name not in names]
        return Sheet(tuple(self.columns[i] for i in keep), self.values[:, keep])

    def renamed(self, names: dict[str, str]) -> Sheet:
        return replace(self, columns=tuple(names.get(name, name) for name in self.columns))

    def text(self) -> str:
        lines = io.StringIO()
        np.savetxt(lines, self.values, fmt="%.10g", delimiter=",")
        return ",".join(self.columns) + "\n" + lines.getvalue().replace("nan", "")


@pytest.fixture(scope="module")
def sheet() -> Sheet:
    path = needed(CASE) / "runs" / "infill-centre-1.csv"
    columns = tuple(path.read_text(encoding="utf-8").split("\n", 1)[0].split(","))
    return Sheet(columns, np.loadtxt(path, delimiter=",", skiprows=1)[ROWS])


@pytest.fixture
def refusal(tmp_path: Path, sheet: Sheet) -> Callable[..., str]:
    """Calls `diagnose` on a bad run and a good repeat (`gap` reads as it does); what it says, once it has refused."""
    good, bad, written = tmp_path / "turn-2.csv", tmp_path / "turn-1.csv", tmp_path / "better.toml"
    good.write_text(sheet.text(), encoding="utf-8")

    def call(content: Sheet | bytes, *, machine: str = str(CASE / "machine.toml"), repeat: bool = True) -> str:
        bad.write_bytes(content if isinstance(content, bytes) else content.text().encode())
        files = [str(bad), str(good)] if repeat else [str(bad)]
        answer = CliRunner().invoke(app, ["diagnose", *files, "-m", machine, "-o", str(written), "--quiet"])
        assert answer.exit_code == 5, answer.output
        assert answer.stdout == "" and sorted(p.name for p in tmp_path.iterdir()) == ["turn-1.csv", "turn-2.csv"]
        assert answer.stderr.startswith("ffcomp: ") and answer.stderr.rstrip().endswith((".", "?"))
        return answer.stderr

    return call


def times(factor: float) -> Callable[[NDArray[np.float64]], object]:
    return lambda x: np.multiply(x, factor, out=x)


def plus(offset: float, first: int = 0) -> Callable[[NDArray[np.float64]], object]:
    return lambda x: np.add(x[first:], offset, out=x[first:])


def fill_gaps(value: float, rows: slice = slice(None)) -> Callable[[NDArray[np.float64]], object]:
    return lambda x: x.__setitem__(rows, value)


def noise(x: NDArray[np.float64]) -> None:
    x[:] = 0.05 * np.random.default_rng(0).standard_normal(len(x))


def late(x: NDArray[np.float64]) -> None:
    x[:] = np.concatenate([np.zeros(200), x[:-200]])


Spoil = Callable[[Sheet], Sheet]
SPOILT: dict[str, tuple[Spoil, tuple[str, ...]]] = {
    "no sensor": (lambda s: s.without(*SENSORS), ("No sensor column is there",)),
    "all in mm/s²": (
        lambda s: s.changed(times(1000), *SENSORS),
        ("Column acc_A_m_per_s2 looks 1000 times too large", "mm/s²", "Column acc_y_m_per_s2", "Multiply it by 0.001"),
    ),
    "in g": (
        lambda s: s.changed(times(1 / 9.80665), *SENSORS),
        ("acc_A_m_per_s2 looks 9.81 times too small, as if it were in g", "Multiply it by 9.80665"),
    ),
    "command in m": (
        lambda s: s.changed(times(1e-3), *COMMAND),
        ("Column cmd_A_mm has a mean of 0.354", "as if it were in m. Multiply it by 1000.", "Column cmd_C_mm"),
    ),
    "time in ms": (
        lambda s: s.changed(times(1e3), "t_s"),
        ("sample rate in column t_s is 1.6 Hz", "as if the time were in ms, not in s: multiply it by 0.001"),
    ),
    "gravity": (
        lambda s: s.changed(plus(9.81), "acc_A_m_per_s2", "acc_z_m_per_s2"),
        ("Column acc_A_m_per_s2 has a mean of 9.8", "gravity is still in it", "Column acc_z_m_per_s2"),
    ),
    "stopped": (
        lambda s: s.changed(fill_gaps(0.3, slice(2000, None)), "acc_B_m_per_s2"),
        ("Sensor acc_B stands at 0.3 for 0.75 s, from 1.25 s after the beginning on, while it is commanded to move",),
    ),
    "dead": (lambda s: s.changed(noise, "acc_x_m_per_s2"), ("Sensor acc_x measures 0.", "it is dead, not fastened")),
    "turned round": (
        lambda s: s.changed(times(-1), "acc_A_m_per_s2", "acc_x_m_per_s2"),
        ("Sensor acc_A moves against its command (correlation -0.9", "Sensor acc_x moves against"),
    ),
    "A and B": (
        lambda s: s.renamed({"acc_A_m_per_s2": "acc_B_m_per_s2", "acc_B_m_per_s2": "acc_A_m_per_s2"}),
        ("Sensor acc_A moves with the command of B (correlation 0.9", "acc_B moves with the command of A", "swapped"),
    ),
    "late": (lambda s: s.changed(late, *SENSORS), ("The sensors fit the command best 0.12", "s late")),
    "other sensors": (
        lambda s: s.without("acc_x_m_per_s2", "acc_y_m_per_s2"),
        ("turn-2.csv: By its name it repeats turn-1.csv, but only one of the two has acc_x, acc_y",),
    ),
    "other command": (
        lambda s: s.changed(plus(0.2), *COMMAND),
        ("turn-2.csv: By its name it repeats turn-1.csv, but", "the commands are 0.2 mm apart"),
    ),
}


@pytest.mark.parametrize("mistake", SPOILT)
def test_a_spoilt_run_is_refused_in_words(refusal: Callable[..., str], sheet: Sheet, mistake: str) -> None:
    spoil, words = SPOILT[mistake]
    said = refusal(spoil(sheet))
    for part in words:
        assert part in said, said


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "turn-1.csv: The file is empty."),
        (b"t_s,cmd_A_mm,cmd_B_mm,cmd_C_mm,acc_A_m_per_s2\n", "There are no rows after the header line."),
        (bytes(range(256)) * 50, "Byte 128 is not UTF-8: the file is not a text file. Save it as CSV"),
        (b"#time,accel_x,accel_y,accel_z\n0.1,12,3,9811\n", "It is an accelerometer's capture without a command"),
        (b"t_s;cmd_A_mm;cmd_B_mm\n0;1;2\n", "separates its columns by semicolons"),
    ],
)
def test_a_file_that_is_no_run_is_refused(refusal: Callable[..., str], content: bytes, words: str) -> None:
    assert words in refusal(content)


def test_runs_of_another_machine_are_refused(refusal: Callable[..., str], sheet: Sheet, tmp_path: Path) -> None:
    said = refusal(sheet, machine="mp-delta-pro")
    assert "Sensor acc_x moves against the command of y" in said  # its towers stand at other angles
    assert "or the order of the towers in the machine file is another." in said
    larger = tmp_path.parent / f"{tmp_path.name}-larger.toml"
    text = (CASE / "machine.toml").read_text(encoding="utf-8")
    larger.write_text(text.replace("arm_length_mm = 311", "arm_length_mm = 511"), encoding="utf-8")
    assert "Was the recording made on another machine than example effector-mass" in refusal(sheet, machine=str(larger))


def test_diagnose_needs_a_repeat_and_says_why_there_is_none(tmp_path: Path, sheet: Sheet) -> None:
    files = [tmp_path / "turn-1.csv", tmp_path / "turn-2.csv"]
    for path, rows in zip(files, (3000, 2990), strict=True):
        path.write_text(replace(sheet, values=sheet.values[:rows]).text(), encoding="utf-8")
    called = ["diagnose", *map(str, files), "-m", str(CASE / "machine.toml"), "--quiet"]
    answer = CliRunner().invoke(app, called)
    assert answer.exit_code == 5 and "None of the 2 recordings repeats another" in answer.stderr
    assert "differ in length (rows): turn-1.csv 3000, turn-2.csv 2990" in answer.stderr


RATE_HZ = 1600.0
MOVES = {f"acc_{axis}": x for axis, x in zip("ABC", np.random.default_rng(1).standard_normal((3, 3200)), strict=True)}


@settings(max_examples=25, deadline=None)
@given(
    gains=st.lists(st.floats(0.2, 3.0), min_size=3, max_size=3),
    delay=st.integers(0, 8),
    loud=st.floats(0.0, 0.05),
    offset=st.floats(-1.0, 1.0),
)
def test_gain_delay_noise_and_offset_are_no_misplacement(
    gains: list[float], delay: int, loud: float, offset: float
) -> None:
    """Whatever a machine's effects do to a sensor that is where it should be, the diagnosis gets to see it."""
    hiss = loud * np.random.default_rng(2).standard_normal((3, 3200))
    felt = {
        name: g * np.roll(x, delay) + h + offset for (name, x), g, h in zip(MOVES.items(), gains, hiss, strict=True)
    }
    assert misplaced(felt, MOVES, RATE_HZ) == []
