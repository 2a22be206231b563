"""Doubt what a capture says: gravity that is no gravity, a rest that is none, a chip that cannot exist."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ffcomp.measurement.capture import ClockKind
from ffcomp.measurement.sensors import G
from ffcomp.record.axes import NEARLY_G, turn_of
from ffcomp.record.result import Joined
from models.arrays import FloatArray

WITHOUT_G = 0.2  # of g: less at rest, and gravity was taken out
REST_UNTIL_S = -0.1  # on the experiment's clock
RESTLESS, SHAKES_M_PER_S2 = 0.1, 0.5  # at rest: of the motion's root mean square; more than a chip's noise


def wrong_gravity(gravity: FloatArray, clock: ClockKind) -> str:
    """Say what is wrong with gravity (3,) m/s² as a capture measures it at rest; "" if nothing is.

    Apps may take gravity out; firmwares leave it in.
    """
    size = float(np.linalg.norm(gravity))
    if abs(size / G - 1.0) <= NEARLY_G or (clock == "free" and size < WITHOUT_G * G):
        return ""
    return (
        f"At rest it measures {size:.3g} m/s², and gravity is {G:.2f}: its numbers are {size / G:.2g} times as "
        "large as they should be. The range, the scale or the unit of the chip is misread, or gravity was taken out. "
        "Check the chip's type and range in the firmware's configuration, and record it again."
    )


def unlike(joined: Joined, least: float) -> str:
    """Say that a capture does not fit its motion, and what may be the reason."""
    doubt = f"correlation {joined.clock.correlation:.2f}, and {least:g} is needed"
    start = f"It does not fit the motion of {joined.experiment} below 20 Hz: {doubt}."
    rest, motion = _loudness(joined)
    if rest > max(RESTLESS * motion, SHAKES_M_PER_S2):
        return (
            f"{start} It shakes by {rest:.2g} m/s² at rest already, {rest / motion:.0%} of what it does in motion: "
            "something else shakes the printer or its table, or the sensor is loose. Stop that, and record it again."
        )
    return (
        f"{start} It is of another motion (another plan, a speed factor, lower limits of the firmware, lost steps, a "
        "bump), of another machine, or of a sensor that is loose or not on the nozzle holder; or its axes are others "
        "than --axes-map says. Check these, and record it again."
    )


def _loudness(joined: Joined) -> tuple[float, float]:
    """Return the root mean squares at rest before the motion and from then on, m/s²."""
    rows = np.column_stack([joined.recording.acceleration[f"acc_{axis}"] for axis in "xyz"])
    resting = joined.begin_s + joined.recording.time_s < REST_UNTIL_S
    sizes = [float(np.sqrt(np.nanmean(part**2))) if len(part) else 0.0 for part in (rows[resting], rows[~resting])]
    return sizes[0], max(sizes[1], 1e-12)


def left_handed(joined: Sequence[Joined]) -> list[str]:
    """Say for each mounting that was found whether no chip can be mounted so."""
    found = []
    for axes in dict.fromkeys(each.axes_map for each in joined):
        turn = turn_of(axes)
        if turn is not None and np.linalg.det(turn) < 0:
            found.append(
                f"The accelerometer's axes are {axes}, as in a mirror, and no chip's are: either axes_map in the "
                "firmware's configuration is wrong, or the printer moves x or y the wrong way. Command a single move "
                "to the right, and look."
            )
    return found
