"""Runs that must be refused, as files in the hands of a user: one clear sentence, exit 5, nothing written."""

from __future__ import annotations

import io
import os
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

RUNS = Path(os.environ.get("FFCOMP_DATA", Path(__file__).parents[5] / "shared" / "data")) / "runs"
CASE = RUNS / "effector-mass"
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
    if not CASE.is_dir():
        pytest.skip(f"The runs from outside are not beside the project: no folder {CASE} (set FFCOMP_DATA).")
    path = CASE / "runs" / "infill-centre-1.csv"
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


def flat(x: NDArray[np.float64]) -> None:
    np.clip(x, -0.4 * np.abs(x).max(), 0.4 * np.abs(x).max(), out=x)


def late(x: NDArray[np.float64]) -> None:
    x[:] = np.concatenate([np.zeros(200), x[:-200]])


Spoil = Callable[[Sheet], Sheet]
SPOILT: dict[str, tuple[Spoil, tuple[str, ...]]] = {
    "no time": (lambda s: s.without("t_s"), ("turn-1.csv: Column t_s (time, seconds) is missing",)),
    "no command of B": (lambda s: s.without("cmd_B_mm"), ("Column cmd_B_mm is missing; a command needs",)),
    "no command": (lambda s: s.without(*COMMAND), ("The command is missing; a recording needs cmd_A_mm",)),
    "no sensor": (lambda s: s.without(*SENSORS), ("No sensor column is there",)),
    "twice": (lambda s: s.renamed({"acc_B_m_per_s2": "acc_A_m_per_s2"}), ("'acc_A_m_per_s2' is there 2 times",)),
    "unknown": (lambda s: s.renamed({"acc_z_m_per_s2": "temperature"}), ("'temperature' is unknown",)),
    "named mm/s²": (
        lambda s: s.renamed({"acc_A_m_per_s2": "acc_A_mm_per_s2"}),
        ("rename it and multiply its numbers by 0.001",),
    ),
    "all in mm/s²": (
        lambda s: s.changed(times(1000), *SENSORS),
        ("Column acc_A_m_per_s2 looks 1000 times too large", "mm/s²", "Column acc_y_m_per_s2", "Multiply it by 0.001"),
    ),
    "x in mm/s²": (lambda s: s.changed(times(1000), SENSORS[3]), ("acc_x_m_per_s2 looks 1000 times too large",)),
    "in g": (
        lambda s: s.changed(times(1 / 9.80665), *SENSORS),
        ("acc_A_m_per_s2 looks 9.81 times too small, as if it were in g", "Multiply it by 9.80665"),
    ),
    "command in m": (
        lambda s: s.changed(times(1e-3), *COMMAND),
        ("Column cmd_A_mm has a mean of 0.354", "as if it were in m. Multiply it by 1000.", "Column cmd_C_mm"),
    ),
    "command of B in m": (lambda s: s.changed(times(1e-3), "cmd_B_mm"), ("Column cmd_B_mm has a mean of 0.35",)),
    "command in inches": (
        lambda s: s.changed(times(1 / 25.4), *COMMAND),
        ("in cm or inches. Multiply it by",),
    ),
    "time in ms": (
        lambda s: s.changed(times(1e3), "t_s"),
        ("sample rate in column t_s is 1.6 Hz", "as if the time were in ms, not in s: multiply it by 0.001"),
    ),
    "gravity": (
        lambda s: s.changed(plus(9.81), "acc_A_m_per_s2", "acc_z_m_per_s2"),
        ("Column acc_A_m_per_s2 has a mean of 9.8", "gravity is still in it", "Column acc_z_m_per_s2"),
    ),
    "tilted": (lambda s: s.changed(plus(-3.0), "acc_y_m_per_s2"), ("of -3.0", "gravity on a tilted sensor")),
    "a jump": (
        lambda s: s.changed(plus(0.3003, 500), "t_s"),
        ("column t_s steps by 481.48 periods at row 502",),
    ),
    "a hole": (lambda s: s.changed(plus(0.5, 500), "t_s"), ("The time jumps from 0.811875 s to 1.3125 s at row 502",)),
    "back": (lambda s: s.changed(plus(-0.2, 500), "t_s"), ("time must rise", "at row 502")),
    "again": (lambda s: s.changed(plus(-1 / 1600, 500), "t_s"), ("from 0.811875 s to 0.811875 s at row 502",)),
    "clipped": (lambda s: s.changed(flat, "acc_x_m_per_s2"), ("acc_x_m_per_s2 stands at its", "it is clipped")),
    "constant": (lambda s: s.changed(fill_gaps(0.04), "acc_B_m_per_s2"), ("is 0.04 in all 3200 rows",)),
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
    "x and y": (
        lambda s: s.renamed({"acc_x_m_per_s2": "acc_y_m_per_s2", "acc_y_m_per_s2": "acc_x_m_per_s2"}),
        ("Sensor acc_x moves with the command of y",),
    ),
    "commands of A and B": (
        lambda s: s.renamed({"cmd_A_mm": "cmd_B_mm", "cmd_B_mm": "cmd_A_mm"}),
        ("Sensor acc_A moves with the command of B",),
    ),
    "late": (lambda s: s.changed(late, *SENSORS), ("The sensors fit the command best 0.12", "s late")),
    "nothing": (lambda s: s.changed(fill_gaps(np.nan), *SENSORS), ("acc_A_m_per_s2 holds no number at all",)),
    "short": (lambda s: replace(s, values=s.values[:600]), ("The recording is 0.3744 s long (600 rows)",)),
    "slow": (lambda s: replace(s, values=s.values[::4]), ("sample rate in column t_s is 400 Hz",)),
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
        ("# Name: Jörg\nt_s\n0\n".encode("latin-1"), "Byte 9 is not UTF-8"),
        (b"#time,accel_x,accel_y,accel_z\n0.1,12,3,9811\n", "It is an accelerometer's capture without a command"),
        (
            b"freq,psd_x,psd_y\n1,2,3\n",
            "The first line, 'freq,psd_x,psd_y', names no column of a recording; a recording has t_s",
        ),
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
