"""The methods that only the page of performance compares: zero-phase-error tracking, and one dense least squares."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ffcomp.comparison.methods import TunedMethod
from ffcomp.comparison.sampling import PrintSlice
from ffcomp.firmware.program import PlannedProgram
from ffcomp.inverse.limited_window import WindowProblem
from ffcomp.inverse.model import InverseModel, Iterate
from ffcomp.inverse.reference import Reference
from ffcomp.planner.trajectory import Section
from ffcomp.simulation.command import Motion
from models.effects.catalogue import design_machine
from models.machine import Machine
from models.vibration.delta import STATES, Q
from models.vibration.state_space import discretise

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

ZERO_PHASE = "zero-phase"
SAMPLE_S = 0.004  # as long as our segments
PITCH_MM = 10.0  # of the grid of places that have a filter
REACH = 40  # samples to either side
LINES = 512  # of the filter's response, round the whole unit circle


class ZeroPhase:
    """Zero-phase-error tracking of the carriages, scheduled over the bed in blocks.

    The plant of a place, sampled with the command linear between samples, is G(z): three by three, with 18 zeros, six
    of them outside the unit circle: three near 14, of the drive's own right half-plane zero, and three near -3.5, of
    the sampling. Tomizuka's filter leaves these out of the inverse and takes off their phase instead. With
    β = Π (z - z_i)/(1 - z_i) over the unstable zeros (one of each kind for a single axis),

        F(z) = G(z)⁻¹ β(z) β(z⁻¹),      so that the answer to F r is |β|² r: no phase error, gain 1 at rest

    Three coupled towers have three zeros of either kind, within a few percent of each other: |β|² is the geometric mean
    over the towers. F is worked out on the unit circle, where what is left of the difference between the three is
    inverted from both sides, and cut off REACH samples before and after.

    Tomizuka, Zero phase error tracking algorithm for digital control, J. Dyn. Sys. Meas. Control 109 (1987) 65-68.
    """

    def __init__(self, machine: Machine) -> None:
        self.machine = design_machine(machine)[0]
        self.delta = self.machine.kinematics.compiled()
        self._filters: dict[tuple[int, int], FloatArray] = {}

    def filter_at(self, node: tuple[int, int]) -> FloatArray:
        """(3·taps, 3): what the carriages' path about a sample is multiplied with, less the path itself."""
        if node not in self._filters:
            self._filters[node] = taps(self.machine, PITCH_MM * np.array(node, dtype=np.float64))
        return self._filters[node]

    def command(self, nozzle: FloatArray) -> FloatArray:
        """The nozzle command for the wanted nozzle, (n, 3) mm at samples SAMPLE_S apart; rest before and after."""
        q = self.delta.inverse(nozzle)
        around = np.concatenate([np.repeat(q[:1], REACH, axis=0), q, np.repeat(q[-1:], REACH, axis=0)])
        window = np.lib.stride_tricks.sliding_window_view(around, 2 * REACH + 1, axis=0)  # (n, 3, taps)
        nodes, which = np.unique(np.rint(nozzle[:, :2] / PITCH_MM).astype(np.int64), axis=0, return_inverse=True)
        added = np.empty_like(q)
        for i, (x, y) in enumerate(nodes):
            mine = np.flatnonzero(which == i)
            centred = (window[mine] - q[mine, :, None]).reshape(len(mine), -1)
            added[mine] = centred @ self.filter_at((int(x), int(y)))
        return self.delta.forward(q + added)


def taps(machine: Machine, xy: FloatArray) -> FloatArray:
    """The filter of one place: (3·(2 REACH + 1), 3), rows by input and sample, columns by tower."""
    z = np.exp(2j * np.pi * np.arange(LINES) / LINES)
    a, b, c, d = sampled(machine, xy)
    g = c @ np.linalg.solve(z[:, None, None] * np.eye(STATES) - a, b) + d
    f = np.linalg.inv(g) * left_over(unstable_zeros(a, b, c, d), z)[:, None, None]
    impulse = np.fft.ifft(f, axis=0).real  # of r(k - j), j from 0 on, the future at the end
    kept = impulse[np.arange(REACH, -REACH - 1, -1)]  # (taps, 3 out, 3 in), oldest sample of the window first
    kept[REACH] += np.eye(3) - kept.sum(axis=0)  # what was cut off: rest stays rest
    return np.ascontiguousarray(kept.transpose(2, 0, 1).reshape(-1, 3))


def sampled(machine: Machine, xy: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """A, B, C, D of the carriages at a place (2,) mm: ξ = x - B₁ u takes the command's next sample out of x⁺."""
    p = discretise(machine.vibration.state_space(xy[None]), SAMPLE_S)
    a, b0, b1 = p.a[0], p.b0[0], p.b1[0]
    c = np.eye(STATES)[Q]
    return a, a @ b1 + b0, c, c @ b1


def unstable_zeros(a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray) -> ComplexArray:
    """Transmission zeros outside the unit circle: where the system matrix [A - zI, B; C, D] loses rank."""
    zeros = np.linalg.eigvals(a - b @ np.linalg.solve(d, c))  # D is regular: there is a zero for every state
    return zeros[np.abs(zeros) > 1.0]


def left_over(zeros: ComplexArray, z: ComplexArray) -> FloatArray:
    """|β|² on the unit circle, a geometric mean over the three towers."""
    each = np.abs((z[:, None] - zeros) / (1.0 - zeros)) ** 2
    return each.prod(axis=1) ** (1 / 3)


def zero_phase(machine: Machine) -> TunedMethod:
    """As a way of driving the printer: its samples are joined by straight lines, as the firmware does."""
    filters = ZeroPhase(machine)
    tuning = f"The plant of every {PITCH_MM:g} mm of the bed, sampled every {1e3 * SAMPLE_S:g} ms."

    def motion(stretch: PrintSlice) -> tuple[Motion, None]:
        plan = stretch.motion
        t = knots(stretch)
        command = filters.command(plan.position(t))

        def position(at: FloatArray) -> FloatArray:
            return np.stack([np.interp(at, t, axis) for axis in command.T], axis=1)

        return Motion(position, plan.begin_t, plan.end_t, plan.clock), None

    return TunedMethod(ZERO_PHASE, "zero-phase-error tracking, scheduled", "inversion", tuning, motion)


def knots(stretch: PrintSlice) -> FloatArray:
    """Times SAMPLE_S apart over a stretch, its end included."""
    plan = stretch.motion
    last = int(np.ceil((plan.end_t - plan.begin_t) / SAMPLE_S))
    return plan.begin_t + SAMPLE_S * np.arange(last + 1, dtype=np.float64)


# ---- one dense least squares ---------------------------------------------------------------------


def whole_run(planned: PlannedProgram, run: Section, inverter: InverseModel) -> WindowProblem:
    """One window over a whole run from rest, all of its knots unknown."""
    playing = Iterate(inverter, Reference(planned.trajectory, run, inverter.settings))
    state = inverter.machine.equilibrium(planned.trajectory.origin[run.first, :3])
    return WindowProblem(playing, 0, state, playing.last, playing.last - 1, playing.n)


def dense(window: WindowProblem) -> FloatArray:
    """The nozzle command at the knots by one cvxpy problem, and once more for every correction. (n + 1, 3) mm"""
    import cvxpy as cp

    iterate, stretch = window.iterate, window.stretch
    phi = window.phi()
    second = np.diff(np.eye(window.unknowns + 4), 2, axis=0)[:, 2:-2]  # with knots at zero on both sides
    bend = np.sqrt(iterate.model.control_weight) * np.kron(second, np.eye(3))
    for _ in range(1 + iterate.model.settings.corrections):
        response, _ = stretch.respond(window.state)
        now = iterate.gamma[1 : window.unknowns + 1]
        change = cp.Variable(now.size)
        left = stretch.error(response).ravel() - phi @ change
        cost = cp.sum_squares(left) + cp.sum_squares(bend @ (now.ravel() + change))
        problem = cp.Problem(cp.Minimize(cost))
        problem.solve(solver=cp.CLARABEL)
        if problem.status != cp.OPTIMAL or change.value is None:
            raise RuntimeError(f"The dense problem of {now.size} unknowns ended as {problem.status}.")
        now += change.value.reshape(-1, 3)
    return stretch.vertices()[: iterate.last + 1]
