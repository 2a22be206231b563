"""What a print is predicted to look like: evaluated once, kept in the file, and read by whoever states it.

`compensate` evaluates the segments that it writes (`ffcomp/compensation/prediction.py`) and keeps the result in a
comment at the end of the file. `show`, the page and the picture read it there. A file without that comment is evaluated
from its own moves (`ffcomp/simulation/preview.py`).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import ClassVar

from ffcomp.metrics import Track
from ffcomp.numerics.digits import um
from ffcomp.numerics.serialise import json_line, keys
from ffcomp.simulation.expectation import Expectation, expectation_of
from gcode.embedded import FORECAST, Stamp, find_forecast_text
from models.machine import Machine

WAYS = "uncompensated", "compensated"


@dataclass(frozen=True, slots=True)
class Forecast:
    """The errors that are predicted for a print."""

    json_keys: ClassVar = keys("expected", "verdict", predicted="tracks", predicted_over_s="over_s")

    # by WAYS; empty: none, or the print is as sliced
    tracks: Mapping[str, Track] = field(default_factory=dict)
    over_s: float = 0.0  # print time that it covers
    failed: str = ""  # why there is none, in a sentence
    expected: Expectation | None = None  # the same on printers that the machine file's `[uncertainty]` allows

    @property
    def exact(self) -> str:
        """The improvement on a printer exactly as its machine file says; empty: not predicted."""
        if not self.tracks:
            return ""
        before, after = (self.tracks[way] for way in WAYS)
        ratio = before.contour_rms_um / max(after.contour_rms_um, 0.01)  # the last digit that is shown
        change = f"{ratio:.0f} times less"
        if ratio < 1.0:
            change = f"{1.0 / ratio:.1f} times more: see that -m names the machine it was compensated for"
        return (
            f"contour error {um(before.contour_rms_um)} → {um(after.contour_rms_um)} µm rms ({change}), 99 % within "
            f"{um(before.contour_p99_um)} → {um(after.contour_p99_um)} µm"
        )

    @property
    def verdict(self) -> str:
        """The same as a sentence."""
        return f"If the machine file is exact: {self.exact}" if self.tracks else ""

    def as_sliced(self, machine: Machine) -> Forecast:
        """Return that of the print as sliced, through the best shaper."""
        assert self.expected is not None
        return replace(
            self, tracks={}, expected=expectation_of(machine, **self.expected.numbers() | {"shaper_written": True})
        )

    def line(self) -> bytes:
        """Return the comment that keeps it in a file; empty: there is nothing to keep."""
        if not self.over_s:
            return b""
        kept = {"over_s": self.over_s, **self.tracks}
        if self.expected is not None:
            kept["expected"] = self.expected.numbers()
        return FORECAST + json_line(kept).encode() + b"\n"


NO_FORECAST = Forecast()


def forecast_in(tail: bytes, stamp: Stamp, machine: Machine, compute: Callable[[], Forecast]) -> tuple[Forecast, bool]:
    """Return the forecast of a compensated file, and whether the file keeps it; otherwise it is computed.

    tail : the file's end;  machine : what the print is looked at for, perhaps another than it was compensated for
    """
    kept = stored_forecast(tail, machine) if machine.sha256.startswith(stamp.sha256) else None
    return (compute(), False) if kept is None else (kept, True)


def stored_forecast(tail: bytes, machine: Machine) -> Forecast | None:
    """Read the forecast that a compensated file keeps at its end; None: it keeps none that can be read.

    machine : that the file was compensated for
    """
    text = find_forecast_text(tail)
    try:
        kept = json.loads(text)
        expected = kept.get("expected")
        return Forecast(
            {way: Track(**kept[way]) for way in WAYS if way in kept},
            float(kept["over_s"]),
            expected=None if expected is None else expectation_of(machine, **expected),
        )
    except (ValueError, KeyError, TypeError, AttributeError):  # of another version, or no JSON at all
        return None


def failure(error: Exception) -> str:
    """Say that a prediction has failed, and why."""
    why = f"{type(error).__name__}: {error}".rstrip(".")
    return f"The errors of this print could not be predicted ({why}). The print itself is complete; please report this."
