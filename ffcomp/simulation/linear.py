"""The linear model scheduled along the path: the nozzle's response to a command, whatever planned it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ffcomp.planner.trajectory import Trajectory
from ffcomp.shapers import Shaper, shape
from models.arrays import FloatArray
from models.machine import Machine
from models.vibration.scheduled import PITCH_MM, OnCarriages, Schedule, plant_table

STEP_S = 5e-4
SUBSTEPS = 8  # steps per model
CHUNK_STEPS = 8000
KEEP_EVERY = 2  # samples of 1 ms are enough
JUMP_MM = 1e-3  # a move that begins elsewhere: something else has moved the nozzle, and it starts from rest


class LinearPlayback:
    """The linear model of a machine, simulated with a fixed step of STEP_S."""

    def __init__(self, machine: Machine, pitch_mm: float = PITCH_MM, carriages: OnCarriages | None = None) -> None:
        """Tabulate the plant over the bed, with nodes this far apart; carriages : as for `Schedule`."""
        self._vibration = machine.vibration
        table = plant_table(machine.kinematics, machine.vibration, STEP_S, pitch_mm)
        self._schedule = Schedule(machine.kinematics, table, carriages)

    def respond(
        self, nozzle: FloatArray, velocity: FloatArray, state: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return the nozzle's response to a command, (n, 3) mm after every step, and the state at its end.

        nozzle : (n + 1, 3), commanded positions in mm, STEP_S apart; n is a multiple of SUBSTEPS
        velocity : (n + 1, 3), their velocity in mm/s
        state : (18,), at the first sample. None: at rest there
        """
        if state is None:
            state = self._vibration.steady_motion(self._schedule.carriages.of(nozzle, velocity)[0][0], np.zeros(3))
        return self._schedule.respond(nozzle, velocity, state, SUBSTEPS)


def whole_steps(seconds: float) -> int:
    """Return the number of steps, a multiple of SUBSTEPS, that last no longer than this."""
    return SUBSTEPS * int(seconds / STEP_S / SUBSTEPS)


def simulate_linear(
    playback: LinearPlayback, trajectory: Trajectory, by_axis: Sequence[Shaper] = ()
) -> tuple[FloatArray, FloatArray]:
    """Simulate the nozzle under a plan, through shapers of x and y if there are any, from its first move to its last.

    Returns times (m,) s on the plan's clock, in steps of 1 ms (except where something else has moved the nozzle), and
    the nozzle (m, 3) mm.
    """
    intervals = continuous_intervals(trajectory)
    parts = [part for begin, end in intervals for part in _interval(playback, trajectory, begin, end, by_axis)]
    return np.concatenate([t for t, _ in parts]), np.concatenate([nozzle for _, nozzle in parts])


def continuous_intervals(trajectory: Trajectory) -> list[tuple[float, float]]:
    """Return begin and end, s, of the intervals without jumps between moves.

    An interval that others have begun or ended begins or ends with a move that travels.
    """
    end_t = trajectory.start_t + trajectory.duration
    travels = np.flatnonzero(trajectory.travels)
    ends = trajectory.position(np.nextafter(end_t[travels[:-1]], -np.inf))[:, :3]
    jumps = np.abs(trajectory.origin[travels[1:], :3] - ends).max(axis=1, initial=0.0) > JUMP_MM
    firsts, lasts = [0, *travels[1:][jumps]], [*travels[:-1][jumps], len(trajectory) - 1]
    return [(float(trajectory.start_t[a]), float(end_t[b])) for a, b in zip(firsts, lasts, strict=True)]


def _interval(
    playback: LinearPlayback, trajectory: Trajectory, begin: float, end: float, by_axis: Sequence[Shaper]
) -> Iterator[tuple[FloatArray, FloatArray]]:
    state, first = None, begin
    last = np.nextafter(end, -np.inf)  # at `end` itself the next interval may have begun

    def position(t: FloatArray) -> FloatArray:
        return trajectory.position(np.clip(t, first, last))[:, :3]

    def speed(t: FloatArray) -> FloatArray:
        return trajectory.velocity(t)[:, :3] * ((first <= t) & (t < end))[:, None]

    following = int(np.searchsorted(trajectory.start_t, end))
    over = trajectory.start_t[following] if following < len(trajectory) else np.inf  # when that is
    while begin < end:
        steps = min(CHUNK_STEPS, SUBSTEPS * int(np.ceil((end - begin) / STEP_S / SUBSTEPS)))
        t = begin + STEP_S * np.arange(steps + 1, dtype=np.float64)
        nozzle, velocity = np.ascontiguousarray(shape(position, t, *by_axis)), shape(speed, t, *by_axis)
        response, state = playback.respond(nozzle, velocity, state)
        kept = t[KEEP_EVERY::KEEP_EVERY] < over
        yield t[KEEP_EVERY::KEEP_EVERY][kept], response[KEEP_EVERY - 1 :: KEEP_EVERY][kept]
        begin = float(t[-1])
