"""The safety net: every section's command is checked against its plan before any of it is written.

One rule for all machines and firmwares. A section's command is unsafe where

- it begins or ends elsewhere than the plan does, or than the nozzle is;
- it is further from its path than `FARTHEST_MM`, or than `TIMES` the error that it compensates if that is more: the
  machine's compliance times the acceleration of the plan;
- it needs more than `OVER` times a carriage's limit.

An unsafe section keeps its original lines, and the first warning reports it. The checks take 3 % of the solving time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ffcomp.inverse.command_limits import peak_utilisation
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.reference import Reference
from ffcomp.metrics import contour_error
from gcode.program import Moves
from models.arrays import FloatArray

FARTHEST_MM, TIMES = 0.5, 5.0
ENDS_MM = 0.01  # of a command from the ends of its path; chords of Marlin's arcs leave gaps of 2 µm in it
OVER = 1.1  # times a carriage's limit


@dataclass(frozen=True, slots=True)
class Unsafe:
    """A section that keeps its original lines."""

    first_line: int  # of the input, from 1
    last_line: int
    why: str


def fault_of(model: InverseModel, moves: Moves, reference: Reference, vertices: FloatArray) -> str:
    """Return why a whole section's command must not be written; empty: it is safe.

    moves : of the section
    reference : what the command was solved for
    vertices : (n + 1, 3) mm, the command at the reference's knots
    """
    gap = float(np.abs(moves.start[1:, :3] - moves.end[:-1, :3]).max(initial=0.0))
    if gap > ENDS_MM:
        return f"its path jumps by {gap:.3g} mm"
    if why := path_fault(model, reference, vertices, (0, reference.knots)):
        return why
    ends = np.stack([moves.start[0, :3], moves.end[-1, :3]])
    off = float(np.abs(vertices[[0, -1]] - ends).max())
    if off > ENDS_MM:
        return f"it begins or ends {off:.3g} mm off its path"
    peak = peak_utilisation(vertices, model.limits)
    return "" if peak <= OVER else f"it needs {peak:.3g} times a carriage's limit"


def path_fault(model: InverseModel, reference: Reference, vertices: FloatArray, knots: tuple[int, int]) -> str:
    """Return why a command between two knots, both included, is too far from its path; empty: it is not.

    The parameters are those of `fault_of`.
    """
    if not np.isfinite(vertices).all():
        return "it is not finite"
    first, last = knots
    vertices = vertices[first : last + 1]
    most = max(FARTHEST_MM, TIMES * max(model.settings.compliance_s2) * reference.acceleration_mm_per_s2)
    t = reference.t0 + model.settings.segment_s * np.arange(first, last + 1, dtype=np.float64)
    due = reference.nozzle(t + model.delay_s)  # it is ahead by the delay
    if float(((vertices - due) ** 2).sum(axis=1).max()) <= most * most:
        return ""  # so near where it is due, it is no further from the path
    away = float(contour_error(*reference.path(), t, vertices).max())
    return "" if away <= most else f"it leaves its path by {away:.3g} mm, and {most:.2g} mm are allowed"


def unsafe_sentences(unsafe: tuple[Unsafe, ...]) -> list[str]:
    """Return the first warning: the motions left uncompensated because their command was unsafe."""
    if not unsafe:
        return []
    one = len(unsafe) == 1
    worst = unsafe[0]
    return [
        f"{'One motion goes' if one else f'{len(unsafe)} motions go'} out as sliced, without compensation (lines "
        f"{worst.first_line} to {unsafe[-1].last_line}): the command failed its check. In line {worst.first_line}, "
        f"{worst.why}. It prints as without ffcomp there. This is a fault of ffcomp: please report it with the file."
    ]
