"""The firmware's choice of a shaper: against what it chose on real printers, and its test against closed forms."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import get_type_hints

import numpy as np
import pytest

from ffcomp import shapers
from ffcomp.comparison.methods import NAMES as COMPARED
from ffcomp.comparison.request import CompareRequest
from ffcomp.measurement.vibration import Resonances, read_vibrations
from ffcomp.shapers import calibration as calibrate
from models.arrays import FloatArray, constant
from models.file import load_machine
from models.kinds import delta_vibration, with_parts
from models.machine import Machine
from tests.support.data import DATA, needed

FOLDER = DATA / "vibration" / "klipper_resonances_bassco"
NAMES = [f"v24__calibration_data_{axis}_{when}.csv" for when in ("20220611_200739", "20230306_225431") for axis in "xy"]
CHOSEN = re.compile(r"(\w+)\((\d+\.\d)\)")


def real(name: str) -> tuple[Resonances, dict[str, float], FloatArray]:
    """The file; the frequency chosen for each kind, in the order of the columns; those columns (k, kinds)."""
    path = needed(FOLDER / name)
    (found,) = read_vibrations(path)
    assert isinstance(found, Resonances)
    head, *rows = path.read_text().splitlines()
    chosen = {kind: float(hz) for kind, hz in CHOSEN.findall(head)}
    return found, chosen, np.loadtxt(rows, delimiter=",")[:, -len(chosen) :]


@pytest.mark.parametrize("name", NAMES)
def test_the_frequencies_a_real_firmware_chose(name: str) -> None:
    """All five kinds; the file's powers have four digits, which may cost one step of 0.2 Hz."""
    found, chosen, _ = real(name)
    spectrum = found.frequency_hz, found.psd["xyz"]
    ours = calibrate.fits(spectrum)
    assert list(ours) == list(chosen)
    assert {kind: fit.frequency_hz for kind, fit in ours.items()} == pytest.approx(chosen, abs=0.21)


@pytest.mark.parametrize("name", NAMES)
def test_what_a_real_firmware_expected_each_shaper_to_leave(name: str) -> None:
    """The worst of three damping ratios at each frequency, which the file rounds to 0.1 Hz and three digits."""
    found, chosen, theirs = real(name)
    last = found.frequency_hz[-1] / (len(theirs) - 1)
    for j, (kind, hz) in enumerate(chosen.items()):
        shaper = shapers.SHAPERS[kind](hz, 0.1)
        left = [shapers.residual_vibration(shaper, last * np.arange(len(theirs)), zeta) for zeta in (0.075, 0.1, 0.15)]
        assert np.abs(np.max(left, axis=0) - theirs[:, j]).max() < 2e-3


# ---- the choice ----------------------------------------------------------------------------------


def one_mode(hz: float, zeta: float = 0.03) -> calibrate.Spectrum:
    f = np.arange(129) * 1.5625
    return calibrate.normalised(f, f**2 / ((1 - (f / hz) ** 2) ** 2 + (2 * zeta * f / hz) ** 2))


@pytest.mark.parametrize("kind", shapers.SHAPERS)
def test_every_kind_can_be_calibrated_and_compared(kind: str) -> None:
    """A row of the table is all that a new shaper needs."""
    only = get_type_hints(CompareRequest, include_extras=True)["only"].__metadata__[0]
    assert calibrate.fit(kind, one_mode(60.0)).frequency_hz >= shapers.SHAPERS[kind].lowest_hz
    assert {kind, f"{kind}-z", f"{kind}-calibrated"} <= set(COMPARED)
    assert re.search(rf"\b{kind}\b", only.help)


@pytest.mark.parametrize("kind", shapers.SHAPERS)
@pytest.mark.parametrize("through_the_corner", [0.0, 5.0, 150.0])
def test_smoothing_is_how_far_the_shaped_path_passes_a_corner(kind: str, through_the_corner: float) -> None:
    """Arriving along X and leaving along Y, or along X again; undamped pulses, where arriving and leaving are alike.

    Smooth kernels are always damped ones: the firmware's formula, which looks at one side, is then near enough.
    """

    def leg(t: FloatArray) -> FloatArray:
        return through_the_corner * t + 2500.0 * t**2

    def corner(t: FloatArray) -> FloatArray:
        return np.column_stack([leg(np.maximum(-t, 0.0)), leg(np.maximum(t, 0.0)), 2500.0 * t**2])

    shaper = shapers.SHAPERS[kind](40.0, 0.0)
    x, y, reversed_path = shapers.shape(corner, np.zeros(1), x=shaper, y=shaper, z=shaper)[0]
    assert calibrate.smoothing(shaper, through_the_corner) == pytest.approx(
        max(np.hypot(x, y), reversed_path), rel=0.15 if kind.startswith("smooth") else 1e-6
    )
    assert (np.hypot(x, y) > reversed_path) == (through_the_corner == 150.0)


# ---- the test ------------------------------------------------------------------------------------


def stiff() -> Machine:
    """Follows every command."""
    machine = load_machine("kossel")
    carriage = replace(delta_vibration(machine).carriage, belt_stiffness_n_per_m=1e12, drive=None)
    return with_parts(
        machine,
        carriage=carriage,
        effector=replace(delta_vibration(machine).effector, extruder_stiffness_n_per_m=constant([1e12] * 3)),
    )


def undone(spectrum: calibrate.Spectrum) -> calibrate.Spectrum:
    frequency, psd = spectrum
    return frequency, psd * (frequency + 0.1)


def test_the_spectrum_is_the_commands_times_the_frequency_response() -> None:
    """Smeared by the window, so only the whole power is compared."""
    machine, place = load_machine("kossel"), np.array([30.0, -40.0])
    frequency, command = undone(calibrate.resonance_test_psd(stiff(), place, "y"))
    _, answer = undone(calibrate.resonance_test_psd(machine, place, "y"))
    gain = np.sum(
        np.abs(machine.vibration.frequency_response(place, frequency, "nozzle", "nozzle")[:, :, 1]) ** 2, axis=1
    )
    swept = frequency > 10
    assert answer[swept].sum() == pytest.approx((gain * command)[swept].sum(), rel=0.03)
