"""A forecast is kept in the file, and comes back as it was; what cannot be read is no forecast."""

from __future__ import annotations

from dataclasses import replace

import pytest

from ffcomp.metrics import Track
from ffcomp.simulation.expectation import expectation_of
from ffcomp.simulation.forecast import Forecast, forecast_in, stored_forecast
from gcode.embedded import Stamp
from models.file import load_machine

MACHINE = load_machine("ender-3")
EXPECTED = expectation_of(
    MACHINE,
    uncertainty=0.2,
    assumed=True,
    printers=20,
    over_s=24.0,
    uncompensated_um=130.0 / 3.0,
    compensated_um=12.0,
    shaper_um=8.1,
    shaper_kind="ei",
    shaper_hz=(40.0, 41.0),
    shaper_written=False,
)


def made(before: float = 126.7612345678901, after: float = 2.4512345678901) -> Forecast:
    tracks = [Track(3.0, 9.0, rms, 3.0 * rms, 9.0 * rms, 0.001, 2.5, 99.5, 8200.0) for rms in (before, after)]
    return Forecast(dict(zip(("uncompensated", "compensated"), tracks, strict=True)), 99.5, expected=EXPECTED)


@pytest.mark.parametrize("kept", [made(), replace(made(), expected=None)])
def test_it_comes_back_from_the_file_as_it_was(kept: Forecast) -> None:
    assert stored_forecast(b"G1 X1\n; Processed by ffcomp v1\n" + kept.line() + b"; last", MACHINE) == kept
    assert kept.line().count(b"\n") == 1 and b"record plan" not in kept.line()  # no path of the computer


def test_a_forecast_is_of_the_machine_that_the_file_was_compensated_for() -> None:
    tail, computed = b"\n" + made().line(), made(1.0, 0.5)
    own = Stamp("1", MACHINE.name, MACHINE.sha256[:8], "marlin")
    assert forecast_in(tail, own, MACHINE, lambda: computed) == (made(), True)
    assert forecast_in(b"", own, MACHINE, lambda: computed) == (computed, False)
    assert forecast_in(tail, replace(own, sha256="0" * 8), MACHINE, lambda: computed) == (computed, False)
