"""What a step archive says besides its steps."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from models.arrays import FloatArray


def read_events(path: str | Path) -> tuple[FloatArray, list[bytes]]:
    """When each G-code line is to run, (n,) s, and the lines."""
    with np.load(path, allow_pickle=False) as archive:
        return archive["events_tick"] / float(archive["clock_hz"]), archive["events_line"].tolist()
