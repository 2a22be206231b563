"""Files of accelerometers on printers: every dialect, the names' labels, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ffcomp.errors import MeasurementError
from ffcomp.measurement.sensors import G
from ffcomp.measurement.vibration import Resonances, read_captures, read_vibrations

LINES = np.arange(30) * 1.6
PSD = 1e3 * np.exp(-(((LINES - 25) / 8) ** 2)) + 1
SHAPERS = "zv(46.4),mzv(47.6)"


def spectra(path: Path, header: str, *, holes: int = 0, per_hz: bool = False, shapers: int = 0) -> Path:
    rows = [
        [f"{f:.1f}", *[f"{p:.3e}"] * 3, f"{3 * p:.3e}", *["75.0"] * per_hz, *[""] * holes, *["0.500"] * shapers]
        for f, p in zip(LINES, PSD, strict=True)
    ]
    path.write_text(header + "\n" + "\n".join(",".join(row) for row in rows) + "\n", encoding="utf-8")
    return path


FOUR = "freq,psd_x,psd_y,psd_z,psd_xyz"


@pytest.mark.parametrize(
    ("header", "extra", "normalised"),
    [
        (FOUR, {}, False),
        (f"{FOUR},shapers:,{SHAPERS}", {"holes": 1, "shapers": 2}, True),
        (f"{FOUR},{SHAPERS}", {"shapers": 2}, True),
        (f"{FOUR},accel_per_hz", {"per_hz": True}, False),
        (f"{FOUR},accel_per_hz,{SHAPERS}", {"per_hz": True, "shapers": 2}, True),
    ],
)
def test_the_dialects_of_spectra(tmp_path: Path, header: str, extra: dict[str, int], normalised: bool) -> None:
    path = spectra(tmp_path / "mine__calibration_data_y_10.000_-20.500_5.000_late.csv", header, **extra)  # type: ignore[arg-type]
    (found,) = read_vibrations(path)
    assert isinstance(found, Resonances)
    assert (found.normalised, found.axis, found.position_mm) == (normalised, "y", (10.0, -20.5, 5.0))
    assert list(found.psd) == ["x", "y", "z", "xyz"]
    np.testing.assert_allclose(found.psd["xyz"], 3 * PSD, rtol=1e-3)
    frequency, power = found.power("x")
    undone = PSD[-len(power) :] * ((frequency + 0.1) if normalised else 1.0)
    np.testing.assert_allclose(power, undone, rtol=1e-3)


def capture_text(scale: float = 1000.0, rate: float = 3200.0, count: int = 3200, clip: float = np.inf) -> str:
    generator = np.random.default_rng(0)
    values = np.clip(generator.standard_normal((count, 3)) * 3 + [0, 0, G], -clip, clip) * scale
    rows = "\n".join(f"{1000 + k / rate:.6f},{x:.6f},{y:.6f},{z:.6f}" for k, (x, y, z) in enumerate(values))
    return f"#time,accel_x,accel_y,accel_z\n{rows}\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            capture_text(scale=1.0),
            "The acceleration is 0.0112 m/s² rms; a sensor on Earth measures",
        ),
        (capture_text(scale=1e6), "The acceleration is 1.12e+04 m/s² rms"),
        (capture_text(clip=6.0), "Column acc_z stands at its highest value 6 in "),
        (capture_text(count=1000), "must last at least 0.5 s"),
        ("#time,accel_x,accel_y,accel_z\n", "There are no rows"),
    ],
)
def test_captures_that_cannot_be_used(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "raw_data_x_a.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(MeasurementError) as caught:
        read_captures(path)
    assert words in str(caught.value)


def test_real_spectra(data: Path) -> None:
    paths = sorted((data / "vibration" / "klipper_resonances_bassco").glob("*.csv"))
    assert len(paths) == 15
    for path in paths:
        (found,) = read_vibrations(path)
        assert isinstance(found, Resonances)
        assert found.normalised == ("calibration" in path.name) and found.axis == path.name.split("_20")[0][-1]
        np.testing.assert_allclose(found.psd["x"] + found.psd["y"] + found.psd["z"], found.psd["xyz"], rtol=2e-3)
