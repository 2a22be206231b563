"""Solve one section: the command whose response, by the linear model, is the reference.

The inverse itself knows no limits. Its command is solved again only around positions where it exceeds one: from left to
right, it is simulated up to a few knots before; there a window of the least squares of `limited_window.py` begins, with
the plant's state, and ends some knots after the command is within its limits again. The errors that follow the window
are weighed in it as well: so the command after it, found from another state, still fits.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ffcomp.inverse import lq_preview
from ffcomp.inverse.command_limits import peak_utilisation, utilisation_from_rest
from ffcomp.inverse.limited_window import ConstrainedWindow, WindowProblem
from ffcomp.inverse.model import CONTEXT, InverseModel, Iterate, KnotWindow
from ffcomp.inverse.reference import Reference
from models.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Solution:
    """The command of one section."""

    vertices: FloatArray  # (n + 1, 3) mm: the nozzle command at the knots
    state: FloatArray  # (18,): of the plant at the last knot
    response: FloatArray  # (n·substeps, 3) mm: the nozzle's position by the design model; empty if not requested
    windows: int  # solved
    utilisation: float  # peak demand on a carriage over its limit; up to 1 is allowed
    constrained: tuple[ConstrainedWindow, ...] = ()  # windows with an active limit


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

    Raises
    ------
    SolverError
        When no command within the limits is found.
    """
    iterate, begin, active = Iterate(model, reference), state, list[ConstrainedWindow]()
    response, state, windows = lq_preview.solve(iterate, begin, keep_response)
    utilisation = peak_utilisation(iterate.vertices, model.limits)
    if enforce_limits and utilisation > 1.0:
        response, state, active = _enforced(iterate, begin, keep_response)
        utilisation = peak_utilisation(iterate.vertices, model.limits)
    return Solution(iterate.vertices, state, response, windows, utilisation, tuple(active))


BEFORE, AFTER = 32, 32  # knots: farther errors affect the command by less than a ten-thousandth
LONGEST = 120  # knots of a window; the last AFTER of a longer stretch are solved again by the next one
FOLLOWING = 16  # knots after the unknown ones whose errors count
AT_A_TIME = 512  # knots played


def _enforced(
    iterate: Iterate, state: FloatArray, keep_response: bool
) -> tuple[FloatArray, FloatArray, list[ConstrainedWindow]]:
    """Solve again where the command exceeds a limit, from the plant's state (18,) at the section's first knot.

    Returns
    -------
    the nozzle's response (n·substeps, 3) mm, empty if not requested; the state (18,) at the end; the windows
    """
    begin, at, held = state, 0, list[ConstrainedWindow]()
    too_much = _too_much(iterate, 0, iterate.last)
    while len(beyond := at + np.flatnonzero(too_much[at:])):
        first = max(at, int(beyond[0]) - BEFORE)
        state = play(iterate, at, first, state)[1]
        window = _window(iterate, first, _end_of_cluster(beyond), state)
        _, state = window.solve()
        held.append(window.held())
        at, changed = window.commit_end, min(window.stretch.end, iterate.last)
        too_much[first:changed] = _too_much(iterate, first, changed)[: changed - first]
    response, state = play(iterate, 0, iterate.last, begin) if keep_response else play(iterate, at, iterate.last, state)
    return (response if keep_response else response[:0]), state, held


def _too_much(iterate: Iterate, first: int, last: int) -> BoolArray:
    """Mark the segments (last - first,) between knots that exceed a limit; the section's end belongs to the last."""
    before = max(first - 1, 0)
    shares = utilisation_from_rest(iterate.vertices[before : last + 1], iterate.model.limits)
    over = shares.max(axis=(1, 2)) > 1.0
    if last == iterate.last:
        over[-2] |= over[-1]
    return np.asarray(over[1 + first - before : 1 + last - before])


def _end_of_cluster(knots: IntArray) -> int:
    """Return the last of the knots that belong together: windows around them would overlap."""
    gaps = np.flatnonzero(np.diff(knots) > BEFORE + AFTER)
    return int(knots[gaps[0]] if len(gaps) else knots[-1])


def _window(iterate: Iterate, first: int, last_beyond: int, state: FloatArray) -> WindowProblem:
    whole = min(last_beyond + AFTER, iterate.last - 1)  # the section's last knot is given
    last = min(whole, first + LONGEST)
    commit_end = last - AFTER if last < whole else last
    if last >= iterate.last - 1:
        commit_end = iterate.last
    return WindowProblem(iterate, first, state, commit_end, last - first, min(last + FOLLOWING, iterate.n))


def play(iterate: Iterate, first: int, last: int, state: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Simulate the command between two knots: the nozzle (n·substeps, 3) mm, and the state (18,) at the latter."""
    responses, substeps = [np.empty((0, 3))], iterate.model.settings.substeps
    for at in range(first, last, AT_A_TIME):
        kept = min(AT_A_TIME, last - at)
        # how a segment ends depends on the few that follow
        response, states = KnotWindow(iterate, at, min(at + kept + CONTEXT, iterate.n)).respond(state)
        responses.append(response[: kept * substeps])
        state = states[kept]
    return np.concatenate(responses), state
