"""Frequency responses in files: round trips, what the variance is made of, and what cannot be used."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ffcomp.errors import MeasurementError
from ffcomp.measurement.frf import FrequencyResponse
from ffcomp.measurement.frf_files import read_frfs, write_frf

FREQUENCY = np.arange(1, 160) * 0.75


def response(noise: float = 1e-3, seed: int = 0, **changes: object) -> FrequencyResponse:
    ratio = FREQUENCY / 43.0
    value = 1 / (1 - ratio**2 + 0.2j * ratio)
    generator = np.random.default_rng(seed)
    value = value + noise / np.sqrt(2) * (generator.standard_normal(159) + 1j * generator.standard_normal(159))
    plain = FrequencyResponse("cmd_A", "pos_A", FREQUENCY, value, np.full(159, noise**2))
    return replace(plain, **changes)  # type: ignore[arg-type]


RESPONSES = [
    response(position_mm=(10.0, -20.5, 30.0), clock="logger", coherence=np.linspace(0.9, 1, 159)),
    response(input="force_x", output="acc_x", setup="effector"),
    response(setup="carriage+mass", added_mass_kg=0.125),
    response(input="cmd_x", output="pos_y", position_mm=(0.0, 0.0, 5.0)),
]


def same(read: FrequencyResponse, written: FrequencyResponse, digits: float) -> None:
    names = ("input", "output", "setup", "position_mm", "added_mass_kg", "clock")
    assert [getattr(read, name) for name in names] == [getattr(written, name) for name in names]
    np.testing.assert_allclose(read.frequency_hz, written.frequency_hz, rtol=1e-6)
    np.testing.assert_allclose(read.value, written.value, rtol=digits)
    np.testing.assert_allclose(read.variance, written.variance, rtol=digits)
    assert (read.coherence is None) == (written.coherence is None)
    if read.coherence is not None and written.coherence is not None:
        np.testing.assert_allclose(read.coherence, written.coherence, rtol=digits)


@pytest.mark.parametrize("written", RESPONSES)
def test_csv_round_trip(tmp_path: Path, written: FrequencyResponse) -> None:
    path = tmp_path / "a.whatever"
    write_frf(path, written)
    (read,) = read_frfs(path)
    same(read, written, 1e-10)
    assert read.source == "a.whatever"


def test_universal_round_trip(tmp_path: Path) -> None:
    pytest.importorskip("pyuff")
    from tests.support.universal import write_universal

    path = tmp_path / "a.csv"  # the name says nothing
    write_universal(path, RESPONSES)
    read = read_frfs(path)
    assert len(read) == len(RESPONSES)
    for one, written in zip(read, RESPONSES, strict=True):
        same(one, written, 1e-10)


def foreign_set(**changes: object) -> dict[str, object]:
    """A hammer on the effector, as another program would write it."""
    plain = {"type": 58, "func_type": 4, "rsp_node": 12, "rsp_dir": 2, "ref_node": 12, "ref_dir": -2}
    kinds = {"abscissa_spec_data_type": 18, "ordinate_spec_data_type": 12, "orddenom_spec_data_type": 13}
    numbers = {"x": FREQUENCY, "data": response().value, "binary": 0}
    return plain | kinds | numbers | changes


def test_universal_files_of_others(tmp_path: Path) -> None:
    pyuff = pytest.importorskip("pyuff")
    path = tmp_path / "hammer.uff"
    coherence = foreign_set(func_type=6, data=np.full(159, 0.99))
    sets = [
        foreign_set(ordinate_axis_units_lab="g", orddenom_axis_units_lab="N"),
        coherence,
        foreign_set(
            rsp_node=3, rsp_dir=3, ref_node=3, ref_dir=3, ordinate_spec_data_type=11, orddenom_spec_data_type=8
        ),
    ]
    pyuff.UFF(str(path)).write_sets(sets, mode="overwrite")
    hammer, belt = read_frfs(path)
    assert (hammer.input, hammer.output, belt.input, belt.output) == ("force_y", "acc_y", "cmd_C", "acc_C")
    np.testing.assert_allclose(hammer.value, -9.80665 * response().value, rtol=1e-9)  # −y hit, +y measured, in g
    np.testing.assert_allclose(belt.value, 2j * np.pi * FREQUENCY * response().value, rtol=1e-9)
    assert hammer.coherence is not None and belt.coherence is None


def csv(tmp_path: Path, extra: dict[str, np.ndarray], comments: str = "") -> Path:
    one = response(0.02, seed=5)
    table = {"frequency_hz": one.frequency_hz, "real": one.value.real, "imag": one.value.imag} | extra
    rows = "\n".join(",".join(f"{v:.9g}" for v in row) for row in np.column_stack(list(table.values())))
    path = tmp_path / "frf.csv"
    path.write_text(f"# input: cmd_A\n# output: pos_A\n{comments}{','.join(table)}\n{rows}\n", encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("# input: cmd_A", "# input: cmd_a", "The input 'cmd_a' is unknown; did you mean 'cmd_A'?"),
        ("# input: cmd_A", "# input: cmd_A\n# position_mm: 1, 2", "it must be 3 finite numbers."),
        ("# input: cmd_A", "# input: cmd_A\n# added_mass_kg: -1", "a mass that was added is not negative"),
        ("imag", "imaginary", "Column 'imaginary' is unknown; did you mean 'imag'?"),
        ("\n0.75,", "\n75,", "must rise from line to line"),
        ("\n0.75,", "\nzero,", "column frequency_hz: 'zero'"),
    ],
)
def test_files_that_cannot_be_used(tmp_path: Path, old: str, new: str, words: str) -> None:
    path = csv(tmp_path, {})
    path.write_text(path.read_text(encoding="utf-8").replace(old, new, 1), encoding="utf-8")
    with pytest.raises(MeasurementError) as caught:
        read_frfs(path)
    assert words in str(caught.value) and "frf.csv: " in str(caught.value)
