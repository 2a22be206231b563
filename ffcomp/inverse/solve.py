"""Solve one section: the command whose response, by the linear model, is the reference.

The inverse itself knows no limits. A command that exceeds one is replaced by the nearest that does not, and simulated.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ffcomp.inverse import lq_preview
from ffcomp.inverse.command_limits import peak_utilisation
from ffcomp.inverse.model import CONTEXT, InverseModel, Iterate, KnotWindow
from ffcomp.inverse.nearest import nearest_within_limits
from ffcomp.inverse.reference import Reference
from models.arrays import BoolArray, FloatArray

AT_A_TIME = 512  # knots played
MOVED_MM = 1e-6  # farther is changed
AFFECTED = 32  # knots after a change whose errors are its own


@dataclass(frozen=True, slots=True)
class LimitedWindow:
    """A part of a section with an active limit."""

    first: int  # knots of the section
    last: int
    error_mm: float  # how far the nozzle is from the path at the worst, by the design model


@dataclass(frozen=True, slots=True)
class Solution:
    """The command of one section."""

    vertices: FloatArray  # (n + 1, 3) mm: the nozzle command at the knots
    state: FloatArray  # (18,): of the plant at the last knot
    response: FloatArray  # (n·substeps, 3) mm: the nozzle's position by the design model; empty if not requested
    windows: int  # solved
    utilisation: float  # peak demand on a carriage over its limit; up to 1 is allowed
    limited: tuple[LimitedWindow, ...] = ()


def solve(
    model: InverseModel,
    reference: Reference,
    state: FloatArray,
    *,
    keep_response: bool = False,
    enforce_limits: bool = True,
) -> Solution:
    """Solve one section.

    Parameters
    ----------
    model : of the machine
    reference : of the section
    state : (18,) of the plant at the section's first knot
    keep_response : return the nozzle's response too
    enforce_limits : False leaves a command above a limit unchanged
    """
    iterate, begin, limited = Iterate(model, reference), state, tuple[LimitedWindow, ...]()
    response, state, windows = lq_preview.solve(iterate, begin, keep_response)
    utilisation = peak_utilisation(iterate.vertices, model.limits)
    if enforce_limits and utilisation > 1.0:
        moved = _limit(iterate)
        played, error, state = _play(iterate, begin)
        response = played if keep_response else response
        utilisation = peak_utilisation(iterate.vertices, model.limits)
        limited = tuple(_windows(moved, error))
    return Solution(iterate.vertices, state, response, windows, utilisation, limited)


def _limit(iterate: Iterate) -> BoolArray:
    """Take the nearest command within the limits; return which segments (n,) end at knots that it moves."""
    model, kinematics = iterate.model, iterate.model.kinematics
    path = iterate.reference.at_knots(np.arange(iterate.last + 1))
    free = kinematics.forward(kinematics.inverse(path) + iterate.gamma[: iterate.last + 1])
    iterate.vertices[:] = nearest_within_limits(free, path, model.limits, kinematics)
    iterate.gamma[: iterate.last + 1] = kinematics.inverse(iterate.vertices) - kinematics.inverse(path)
    moved = np.abs(iterate.vertices - free).max(axis=1) > MOVED_MM
    return np.asarray(moved[:-1] | moved[1:])


def _windows(moved: BoolArray, error: FloatArray) -> Iterator[LimitedWindow]:
    """Yield the parts of moved segments (n,) with the error in them; error : (n,) mm."""
    segments = np.flatnonzero(moved)
    for part in np.split(segments, np.flatnonzero(np.diff(segments) > AFFECTED) + 1):
        if len(part):
            yield LimitedWindow(int(part[0]), int(part[-1]), float(error[part[0] : part[-1] + AFFECTED].max()))


def _play(iterate: Iterate, state: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Simulate the command from a state (18,).

    Returns
    -------
    the nozzle (n·substeps, 3) mm; how far it is from the path in each segment, (n,) mm; the state (18,) at the end
    """
    s, responses, errors = iterate.model.settings, list[FloatArray](), list[FloatArray]()
    for at in range(0, iterate.last, AT_A_TIME):
        kept = min(AT_A_TIME, iterate.last - at)
        # how a segment ends depends on the few that follow
        window = KnotWindow(iterate, at, min(at + kept + CONTEXT, iterate.n))
        response, states = window.respond(state)
        error = window.error(response)[: kept * s.rows_per_segment]
        responses.append(response[: kept * s.substeps])
        errors.append(np.sqrt((error**2).sum(axis=1)).reshape(kept, -1).max(axis=1))
        state = states[kept]
    return np.concatenate(responses), np.concatenate(errors), state
