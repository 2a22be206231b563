"""Solve one section: the command whose response, by the linear model, is the reference. It knows no limits."""

from __future__ import annotations

from dataclasses import dataclass

from ffcomp.inverse import lq_preview
from ffcomp.inverse.command_limits import peak_utilisation
from ffcomp.inverse.model import InverseModel, Iterate
from ffcomp.inverse.reference import Reference
from models.arrays import FloatArray


@dataclass(frozen=True, slots=True)
class Solution:
    """The command of one section."""

    vertices: FloatArray  # (n + 1, 3) mm: the nozzle command at the knots
    state: FloatArray  # (18,): of the plant at the last knot
    response: FloatArray  # (n·substeps, 3) mm: the nozzle's position by the design model; empty if not requested
    windows: int  # solved
    utilisation: float  # peak demand on a carriage over its limit; up to 1 is allowed


def solve(model: InverseModel, reference: Reference, state: FloatArray, *, keep_response: bool = False) -> Solution:
    """Solve one section.

    Parameters
    ----------
    model : of the machine
    reference : of the section
    state : (18,) of the plant at the section's first knot
    keep_response : return the nozzle's response too
    """
    iterate = Iterate(model, reference)
    response, state, windows = lq_preview.solve(iterate, state, keep_response)
    return Solution(iterate.vertices, state, response, windows, peak_utilisation(iterate.vertices, model.limits))
