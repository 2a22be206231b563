"""Solve one section: the command whose response, by the linear model, is the reference."""

from __future__ import annotations

from dataclasses import dataclass

from ffcomp.inverse import constrained, lq_preview, windowed_qr
from ffcomp.inverse.command_limits import peak_utilisation
from ffcomp.inverse.iterate import Iterate
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.reference import Reference
from ffcomp.inverse.windowed_qr import ConstrainedWindow
from models.arrays import FloatArray


@dataclass(frozen=True, slots=True)
class Solution:
    """The command of one section."""

    vertices: FloatArray  # (n + 1, 3) mm: the nozzle command at the knots
    state: FloatArray  # (18,): of the plant at the last knot
    response: FloatArray  # (n·substeps, 3) mm: the nozzle's position by the design model; empty if not asked for
    windows: int  # solved
    utilisation: float  # peak demand on a carriage over its limit; up to 1 is allowed
    constrained: tuple[ConstrainedWindow, ...] = ()  # windows in which a limit is active


def solve(
    model: InverseModel,
    reference: Reference,
    state: FloatArray,
    *,
    keep_response: bool = False,
    enforce_limits: bool = True,
) -> Solution:
    """Solve one section by the method of the model's settings.

    Parameters
    ----------
    model : of the machine
    reference : of the section
    state : (18,) of the plant at the section's first knot
    keep_response : return the nozzle's response too
    enforce_limits : False leaves the fast inverse's command as it is where it exceeds a limit

    Raises
    ------
    SolverError
        When no command within the limits is found.
    """
    iterate, begin, active = Iterate(model, reference), state, list[ConstrainedWindow]()
    if model.settings.inverse == "exact":
        response, state, windows, active = windowed_qr.solve(iterate, begin)
    else:
        response, state, windows = lq_preview.solve(iterate, begin, keep_response)
    utilisation = peak_utilisation(iterate.vertices, model.limits)
    if enforce_limits and utilisation > 1.0 and model.settings.inverse == "fast":
        response, state, active = constrained.enforce(iterate, begin, keep_response)
        utilisation = peak_utilisation(iterate.vertices, model.limits)
    return Solution(iterate.vertices, state, response, windows, utilisation, tuple(active))
