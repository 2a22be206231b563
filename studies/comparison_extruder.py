"""How far the extruder is ahead of the nozzle along the path, in step with a shaper or not."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ffcomp.comparison import methods as every
from ffcomp.comparison.baselines import LinearPrinter, Shaping, shaped
from ffcomp.comparison.evaluation import Execution
from ffcomp.comparison.sampling import PrintSlice
from ffcomp.inverse.settings import settings_for
from ffcomp.metrics import rms
from ffcomp.shapers import Shaper
from ffcomp.simulation.command import Motion
from ffcomp.simulation.playback import simulate_nozzles
from models.arrays import FloatArray
from models.machine import Machine

STEP_S = 5e-4
WINDOW_S = 0.04  # extruding all the time so long before and after: no retraction is near
SLOW_MM_PER_S = 1.0


def extruder_rows(machine: Machine, slices: Sequence[PrintSlice], few: Sequence[PrintSlice]) -> dict[str, float]:
    """Return `ahead_um` without compensation, with MZV at its best (out of step, in step) and with ffcomp."""
    mzv = Shaping("mzv")
    by_axis = mzv.shapers(LinearPrinter(machine, few).best(mzv).settings)
    ours = every.inversion(machine, settings_for(machine), every.COMPENSATED)
    none, shaping, inverse = (
        [_executed(each, motion(each), machine) for each in slices]
        for motion in (
            lambda each: each.motion,
            lambda each: shaped(each.motion, *by_axis),
            lambda each: ours.motion(each)[0],
        )
    )
    return {
        "none_um": ahead_um(none, None),
        "shaper_um": ahead_um(shaping, None),
        "in_step_um": ahead_um(shaping, by_axis[0]),
        "compensated_um": ahead_um(inverse, None),
    }


def _executed(each: PrintSlice, motion: Motion, machine: Machine) -> Execution:
    t, (nozzle,) = simulate_nozzles([machine], motion, each.machine)
    return Execution(each, motion, t, nozzle)


def ahead_um(executions: Sequence[Execution], shaper: Shaper | None) -> float:
    """Return the rms of the path length by which plastic is ahead of the nozzle, µm, without a constant delay.

    Parameters
    ----------
    executions : sequence of Execution
    shaper : Shaper, optional
        Through which the extruder's plan passes too; None: it keeps to the plan.
    """
    ahead, speed = (np.concatenate(each) for each in zip(*(_of(each, shaper) for each in executions), strict=True))
    delay = float(ahead @ speed) / float(speed @ speed)  # what pressure advance, or its absence, is
    return rms(ahead - delay * speed) * 1e3


def _of(execution: Execution, shaper: Shaper | None) -> tuple[FloatArray, FloatArray]:
    """Return by how much the extruder is ahead, mm, and the speed, mm/s, where the print extrudes."""
    own = execution.print_slice
    t = execution.motion.clock.plan_time(execution.t[execution.counted])
    length, velocity = _length(execution), own.trajectory.velocity(t)[:, :3]
    speed = np.linalg.norm(velocity, axis=1)
    extrudes = own.extrudes
    steady = [extrudes[own.trajectory.move_at(t + shift)] for shift in np.linspace(-WINDOW_S, WINDOW_S, 17)]
    kept = np.all(steady, axis=0) & (speed > SLOW_MM_PER_S)
    along = velocity[kept] / speed[kept, None]
    behind = np.sum(
        (own.trajectory.position(t[kept])[:, :3] - execution.nozzle[execution.counted][kept]) * along, axis=1
    )
    if shaper is None:
        return behind, speed[kept]
    shaped = sum(
        a * np.interp(t[kept] - delay, *length) for a, delay in zip(shaper.amplitude, shaper.time, strict=True)
    )
    return behind + shaped - np.interp(t[kept], *length), speed[kept]


def _length(execution: Execution) -> tuple[FloatArray, FloatArray]:
    """Return times, s, and the length of the planned path until then, mm."""
    motion = execution.print_slice.motion
    t = np.arange(motion.begin_t - 0.1, motion.end_t + 0.1, STEP_S)
    steps = np.linalg.norm(np.diff(motion.position(t), axis=0), axis=1)
    return t, np.concatenate([[0.0], np.cumsum(steps)])
