"""Real files from outside the project; tests that need them skip where they are absent."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

DATA = Path(os.environ.get("FFCOMP_DATA", Path(__file__).parents[3] / "shared" / "data"))
ROOT = DATA / "gcode"
PRINTS = (
    "ender3_ringing_tower.gcode",
    "flsun_v400_retract-tower.gcode",
    "gcodepreview_benchy_arcs.gcode",
    "gcodepreview_vase.gcode",
    "kossel_mks-pwc.gcode",
    "makreeltje_cura_slicer.gcode",
    "makreeltje_orca_slicer.gcode",
)


def real(name: str) -> bytes:
    return needed(ROOT / name).read_bytes()


def needed(path: Path) -> Path:
    """Return a file or folder of DATA, without which the test is skipped."""
    if not path.exists():
        pytest.skip(f"{path} is not there; set FFCOMP_DATA to the folder of outside data.")
    return path
