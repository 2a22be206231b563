"""Play a planned motion on the design model: where the nozzle will be, whatever wrote the plan."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from ffcomp.planner.trajectory import PlannedMotion
from models.arrays import FloatArray
from models.effects.catalogue import design_machine
from models.machine import Machine
from models.vibration.scheduled import Schedule, rest_state
from models.vibration.state_space import plant_table

STEP_S = 5e-4
SUBSTEPS = 8  # steps for which one model serves
CHUNK_STEPS = 8000
KEEP_EVERY = 2  # samples of 1 ms are enough to look at
JUMP_MM = 1e-3  # a move that begins elsewhere: something else has moved the nozzle, and it starts from rest


def simulate(
    machine: Machine, trajectory: PlannedMotion, progress: Callable[[float], None] = lambda done_s: None
) -> tuple[FloatArray, FloatArray]:
    """The nozzle under a plan, from its first move to its last.

    Returns
    -------
    t : (m,) s on the plan's clock, rising in steps of 1 ms (but for places where the nozzle was moved by others)
    nozzle : (m, 3) mm
    """
    machine, _ = design_machine(machine)
    schedule = Schedule(machine, plant_table(machine, STEP_S))
    parts = []
    for begin, end in sections(trajectory):
        for part in _section(machine, schedule, trajectory, begin, end):
            parts.append(part)
            progress(float(part[0][-1]))
    return np.concatenate([t for t, _ in parts]), np.concatenate([nozzle for _, nozzle in parts])


def sections(trajectory: PlannedMotion) -> list[tuple[float, float]]:
    """Begin and end (s) of the stretches in which every move begins where the last one ended."""
    end_t = trajectory.start_t + trajectory.duration
    just_before_end = np.nextafter(end_t, -np.inf)
    ends = trajectory.position(just_before_end)[:-1, :3]
    jumps = np.flatnonzero(np.abs(trajectory.origin[1:, :3] - ends).max(axis=1, initial=0.0) > JUMP_MM) + 1
    firsts, lasts = [0, *jumps], [*(jumps - 1), len(trajectory) - 1]
    return [(float(trajectory.start_t[a]), float(end_t[b])) for a, b in zip(firsts, lasts, strict=True)]


def _section(
    machine: Machine, schedule: Schedule, trajectory: PlannedMotion, begin: float, end: float
) -> Iterator[tuple[FloatArray, FloatArray]]:
    state = rest_state(machine, trajectory.position([begin])[0, :3])
    last = np.nextafter(end, -np.inf)  # at `end` itself the next stretch may have begun
    while begin < end:
        steps = min(CHUNK_STEPS, SUBSTEPS * int(np.ceil((end - begin) / STEP_S / SUBSTEPS)))
        t = begin + STEP_S * np.arange(steps + 1, dtype=np.float64)
        place = np.ascontiguousarray(trajectory.position(np.minimum(t, last))[:, :3])
        velocity = trajectory.velocity(t)[:, :3] * (t < end)[:, None]
        response, state = schedule.respond(place, velocity, state, SUBSTEPS)
        yield t[KEEP_EVERY::KEEP_EVERY], response[KEEP_EVERY - 1 :: KEEP_EVERY]
        begin = float(t[-1])
