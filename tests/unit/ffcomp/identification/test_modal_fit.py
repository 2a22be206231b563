"""The modes of straight axes from captures, spectra, responses and runs: truth by the modes' sum, and real printers."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from ffcomp.cli.app import app
from ffcomp.errors import MeasurementError
from ffcomp.identification.axes import identify_axes
from ffcomp.identification.axis_spectra import Response, Spectrum, closed_form
from ffcomp.identification.modal_fit import AxisFit, fit_axis
from ffcomp.identification.resonance_tests import BeltTest, spectrum_of
from ffcomp.measurement.frf_files import write_frf
from ffcomp.measurement.vibration import Resonances, read_vibrations
from ffcomp.shapers.calibration import fits, normalised, resonance_test
from models.arrays import constant
from models.file import LIBRARY, load_machine
from models.kinematics.cartesian import CARTESIAN, CartesianKinematics
from models.machine import Machine, MotionLimits
from models.vibration.modal import Axis, ModalAxes
from tests.support.cli import CliRunner, Result
from tests.support.data import DATA, needed

FloatArray = NDArray[np.float64]

VORON = LIBRARY / "voron-300.toml"
F = np.arange(5.0, 150.1, 0.5)
ONE = np.array([[43.0, 0.07, 1.0]])  # frequency Hz, damping ratio, share
TWO = np.array([[52.0, 0.06, 0.8], [84.0, 0.05, 0.2]])


def call(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(each) for each in arguments])


def answer_of(*arguments: object) -> Any:
    result = call(*arguments, "--json")
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


def response(modes: FloatArray, *, noise: float, seed: int, output: str = "acc_x", **other: Any) -> Response:
    """With white noise of this share of the largest value."""
    s = 2j * np.pi * F
    value = closed_form(modes, F) * (s**2 if output.startswith("acc") else 1.0)
    rng = np.random.default_rng(seed)
    sd = noise * np.abs(value).max()
    value = value + sd / np.sqrt(2) * (rng.normal(size=len(F)) + 1j * rng.normal(size=len(F)))
    return Response(f"cmd_{output[-1]}", output, F, value, np.full(len(F), sd**2), source="made", **other)


def resonance_capture(folder: Path, name: str, modes: FloatArray, noise: float, seed: int) -> Path:
    """What a firmware's resonance test of an axis writes, 800 samples a second, m/s² of noise in each sample."""
    axis = "xyz".index(name[0])
    axes = [Axis()] * 3
    axes[axis] = Axis(*modes.T.tolist())
    box = CartesianKinematics(constant([[0, 200]] * 3), CARTESIAN)
    machine = Machine("truth", box, ModalAxes.of(axes), MotionLimits(200.0, 3000.0))
    felt = 1e-3 * resonance_test(machine, np.zeros(2), "x" if axis == 0 else "y")
    felt = felt + np.random.default_rng(seed).normal(0, noise, felt.shape) + np.array([0.0, 0.0, 9.81])
    path = folder / f"raw_data_{name}.csv"
    rows = np.column_stack([100.0 + np.arange(len(felt)) / 800, 1e3 * felt])
    np.savetxt(path, rows, fmt="%.5f", delimiter=",", header="#time,accel_x,accel_y,accel_z", comments="")
    return path


def near(found: AxisFit, modes: FloatArray) -> None:
    """0.5 % of frequency, 10 % of damping, 0.05 of share."""
    assert len(found.modes) == len(modes), found.verdict
    for mode, (frequency, damping, share) in zip(found.modes, modes, strict=True):
        assert mode.frequency_hz.value == pytest.approx(frequency, rel=0.005)
        assert mode.damping_ratio.value == pytest.approx(damping, rel=0.1)
        assert mode.share.value == pytest.approx(share, abs=0.05)


# ---- what was true is found ----------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_modes_of_a_response(seed: int) -> None:
    rng = np.random.default_rng(100 + seed)
    first = rng.uniform(25, 60)
    share = rng.uniform(0.6, 0.9)
    modes = np.array([[first, rng.uniform(0.03, 0.12), share], [first * rng.uniform(1.4, 2.2), 0.05, 1 - share]])
    near(fit_axis("x", [response(modes, noise=0.02, seed=seed)]), modes)
    alone = np.array([[first, modes[0, 1], 1.0]])
    near(fit_axis("x", [response(alone, noise=0.02, seed=seed, output="pos_x")]), alone)


def test_a_second_mode_is_not_invented() -> None:
    for seed in range(3):
        noisy = [response(ONE, noise=0.1, seed=20 * seed + k) for k in range(2)]
        found = fit_axis("x", noisy)
        assert len(found.modes) == 1 and "chance" in found.verdict


def test_two_modes_nearer_than_they_are_wide_are_one() -> None:
    """Two modes 0.1 Hz apart were written into a machine file: what differs from one mode is an error of the model."""
    twins = np.array([[40.0, 0.03, 0.7], [40.1, 0.06, 0.3]])
    found = fit_axis("x", [response(twins, noise=1e-3, seed=1)])
    assert len(found.modes) == 1 and "cannot be separated" in found.verdict
    assert found.modes[0].frequency_hz.value == pytest.approx(40.0, rel=0.005)


def test_intervals_hold_the_truth() -> None:
    """90 % of 10 are 9; 6 or fewer come by chance once in 80."""
    held = np.zeros(2)
    for seed in range(10):
        (mode,) = fit_axis("x", [response(ONE, noise=0.05, seed=seed)]).modes
        held += [e.low < true < e.high for e, true in ((mode.frequency_hz, 43.0), (mode.damping_ratio, 0.07))]
    assert held.min() >= 7


# ---- from files to a machine file ----------------------------------------------------------------


def test_from_resonance_tests_to_a_machine_file(tmp_path: Path) -> None:
    """An ADXL345's noise, 0.15 m/s² at 3200 samples a second, and ten times as much."""
    files = [resonance_capture(tmp_path, "x_20260101_000000", TWO, 0.08, 1)]
    files.append(resonance_capture(tmp_path, "y_20260101_000000", ONE, 0.8, 2))
    out, figure = tmp_path / "mine.toml", tmp_path / "fit.png"
    answer = answer_of("identify", "fit", *files, "-m", VORON, "-o", out, "--figure", figure, "--quiet")
    found = load_machine(out)
    table = {name: answer["axes"][name]["modes"] for name in "xy"}
    for name, modes in (("x", TWO), ("y", ONE)):
        assert [m["frequency_hz"]["value"] for m in table[name]] == pytest.approx(modes[:, 0], rel=0.005)
        assert [m["damping_ratio"]["value"] for m in table[name]] == pytest.approx(modes[:, 1], rel=0.1)
        assert [m["share"]["value"] for m in table[name]] == pytest.approx(modes[:, 2], abs=0.05)
    assert tomllib.loads(out.read_text(encoding="utf-8"))["axes"]["x"]["share"] == pytest.approx([0.8, 0.2], abs=0.05)
    assert figure.stat().st_size > 20_000
    assert "identified" in found.provenance["axes.x.frequency_hz"] and "Two modes" in found.provenance["axes.x"]
    parameters = found.vibration.parameters()
    spread = dict(zip(parameters.names, parameters.relative_sd(found.uncertainty).tolist(), strict=True))
    assert 0.0 < spread["axes.y.stiffness[0]"] < 0.02  # twice that of the frequency
    again = answer_of("identify", "fit", files[1], "-m", out, "--quiet")
    assert "Nothing was measured along x" in again["advice"][-1]


def test_from_responses_to_a_machine_file(tmp_path: Path) -> None:
    """And from a straight machine's file with two modes back to one."""
    start = tmp_path / "start.toml"
    start.write_text(
        VORON.read_text(encoding="utf-8").replace(
            "[52.0]\ndamping_ratio = [0.07]", "[52.0, 80.0]\ndamping_ratio = [0.07, 0.1]\nshare = [0.9, 0.1]"
        ),
        encoding="utf-8",
    )
    assert not load_machine(start).vibration.position_dependent
    write_frf(tmp_path / "x.csv", response(ONE, noise=1e-4, seed=1))
    out = tmp_path / "out.toml"
    assert call("identify", "fit", tmp_path / "x.csv", "-m", start, "-o", out, "-q").exit_code == 0
    assert "share = [1.0]" in out.read_text(encoding="utf-8")
    drawn = call("frf", "-m", out, "--measured", tmp_path / "x.csv", "--figure", tmp_path / "bode.png", "--json")
    assert drawn.exit_code == 0 and "100 % accurate in magnitude" in json.loads(drawn.stdout)["verdict"]


def test_a_test_along_a_diagonal_is_of_the_belt_that_it_moves(tmp_path: Path) -> None:
    path = resonance_capture(tmp_path, "x_20260101_000000", ONE, 0.1, 1)
    path = path.rename(tmp_path / "belt.csv")  # whose name states no axis
    test = spectrum_of(path, "axis=1.000,-1.000", (5.0, 150.0))
    assert isinstance(test, BeltTest)
    np.testing.assert_allclose(test.direction, [np.sqrt(0.5), -np.sqrt(0.5)])
    assert "the excited axis is not stated" in str(spectrum_of(path, None, (5.0, 150.0)))
    for axis in ("1,one", "0,0", "1,1,1", "1"):
        assert f"{axis!r} is no axis" in str(spectrum_of(path, axis, (5.0, 150.0)))


# ---- what cannot be used is said -----------------------------------------------------------------


def test_noise_alone_is_no_machine() -> None:
    flat = response(np.array([[900.0, 1.0, 1.0]]), noise=0.02, seed=1)
    with pytest.raises(MeasurementError, match="No resonance of x stands out between 5 and 150 Hz"):
        identify_axes([], [flat])


# ---- real printers -------------------------------------------------------------------------------

REAL = DATA / "vibration" / "klipper_resonances_bassco"
SINGLE = (  # spectra with one clear peak
    "switchwire__resonances_y_20211024_200336.csv",
    "v24__resonances_y_20230306_224919.csv",
    "v24__calibration_data_y_20230306_225431.csv",
    "ender3__resonances_y_20210630_230110.csv",
)


@pytest.mark.parametrize("name", SINGLE)
def test_real_printers_ring_where_the_firmware_shapes(name: str) -> None:
    """Within 6 % of the frequency that a firmware's calibration gives its narrowest shaper."""
    found = spectrum_of(needed(REAL / name), None, (2.0, 400.0))
    assert isinstance(found, Spectrum)
    fit = fit_axis("y", [found])
    (file,) = read_vibrations(REAL / name)
    assert isinstance(file, Resonances)
    spectrum = (file.frequency_hz, file.psd["xyz"]) if file.normalised else normalised(*file.power("xyz"))
    shaper = fits(spectrum)["zv"]
    assert len(fit.modes) == 1
    assert fit.modes[0].frequency_hz.value == pytest.approx(shaper.frequency_hz, rel=0.06)
    assert 0.03 < fit.modes[0].damping_ratio.value < 0.2
