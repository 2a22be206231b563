"""Filtered B-splines on the scheduled plant: the command whose response is the wanted path.

The basis is what is played: the firmware plays our G1 segments, so the command is a spline of degree 1 with a knot at the
end of every segment. One run (from rest to rest) is solved in windows; the state is carried from each to the next.

In error coordinates q_d = q* + N γ (q*: the wanted carriage path, N: the hats of the spline), each window minimises

    ‖ e₀ − Φ γ ‖² + ρ ‖ D² γ ‖²                                 Φ = J G N: the basis filtered through the plant

e₀ is the nozzle's error with γ = 0 from the carried state; D² γ S⁻² is the acceleration asked for beyond the plan's.
Then the very segments are played through the plant (ramps, chords, J̇ q̇) and the same factorised system removes what
error is left. γ is zero at both ends of a run: rest stays rest, and hand-over is exact.

Duan, Yoon & Okwudire, A limited-preview filtered B-spline approach to tracking control, Mechatronics 56 (2018) 287-296.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from ffcomp.invert.kernels import basis_response
from ffcomp.invert.limits import CommandLimits, excess, limited_step
from ffcomp.played import OutputLimits, played, sample_segments
from ffcomp.schedule import interpolate, models_along, respond, rest_state, simulate
from models.kinematics.delta import forward, inverse, jacobian_rate_term
from models.machine import Machine
from models.plant import plant_table

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Settings:
    """How the inversion is discretised and how much command it may spend."""

    segment_s: float = 0.004  # S, one G1
    rows_per_segment: int = 2  # where the error is weighed
    substeps: int = 8  # of the simulation, per segment
    commit: int = 64  # segments kept of each window
    preview: int = 24  # segments looked ahead, thrown away
    bandwidth_hz: float = 100.0  # where accuracy is given up for a gentler command
    lead_s: float = 0.008  # how long before the path's start the command may begin
    tail_s: float = 0.004  # how long after the path's end the command comes to rest
    corrections: int = 1  # passes through the plant with the segments as they are played
    output: OutputLimits = field(default_factory=OutputLimits)


@dataclass(frozen=True, slots=True)
class Reference:
    """A run to be followed, sampled `substeps` times per segment: n segments and the rest after them."""

    nozzle: FloatArray  # (n·substeps + 1, 3) mm
    velocity: FloatArray  # (n·substeps + 1, 3) mm/s
    extrusion: FloatArray  # (n,) mm of filament in each segment
    rest: int  # how many of the n segments, at the end, lie after the run: the command rests there


@dataclass(frozen=True, slots=True)
class RunResult:
    vertices: FloatArray  # (n − rest + 1, 3) mm: ends of the segments, nozzle command
    state: FloatArray  # (18,): of the plant at the end of the run
    response: FloatArray  # ((n − rest)·substeps, 3) mm: where the nozzle will be, by the design model
    windows: int
    limited: int  # windows in which a limit had to be enforced
    excess: float  # how many times its limit a carriage is asked for at the worst; up to 1 is allowed


class Inverter:
    """Inverts one machine; the tables over its bed are made once."""

    def __init__(self, machine: Machine, settings: Settings) -> None:
        self.machine, self.settings = machine, settings
        self.fine = plant_table(machine, settings.segment_s / settings.substeps)
        self.coarse = plant_table(machine, settings.segment_s / settings.rows_per_segment)
        self.effort = effort_weight(machine, settings)
        own, knot_s = machine.limits, settings.segment_s
        self.limits = CommandLimits(
            own.carriage_velocity_mm_per_s * knot_s, own.carriage_acceleration_mm_per_s2 * knot_s**2
        )

    def rest_state(self, nozzle: FloatArray) -> FloatArray:
        """The state at rest with the nozzle at (3,) mm."""
        return rest_state(self.machine, nozzle)

    def hold(self, state: FloatArray, nozzle: FloatArray, duration_s: float) -> FloatArray:
        """The state after the command has rested at (3,) mm for a while: what still rings, rings on."""
        s = self.settings
        intervals = round(duration_s / s.segment_s)
        if intervals <= 0:
            return state
        models = models_along(self.coarse, np.repeat(nozzle[None, :2], intervals, axis=0))
        command = np.repeat(
            inverse(self.machine.kinematics, nozzle[None]), intervals * s.rows_per_segment + 1, axis=0
        )
        _, states = simulate(*models, s.rows_per_segment, state, command, np.zeros_like(command), 1)
        return states[-1]

    def uncompensated(self, reference: Reference) -> FloatArray:
        """Where the nozzle would go if the path itself were commanded: (n·substeps, 3) mm after every substep."""
        state = self.rest_state(reference.nozzle[0])
        return respond(self.machine, self.fine, reference.nozzle, reference.velocity, state, self.settings.substeps)[0]

    def run(self, reference: Reference, state: FloatArray) -> RunResult:
        """Solve one run window by window."""
        return _Run(self, reference, state).solve()


def effort_weight(machine: Machine, settings: Settings) -> float:
    """ρ for which accuracy and effort weigh alike at the bandwidth: ρ |D²(ω)|² = mean |G(ω)|² at the centre."""
    from models.receptance import nozzle_frf

    f = settings.bandwidth_hz
    g = nozzle_frf(machine, np.zeros(2), np.array([f]))[0]
    hat = np.sinc(f * settings.segment_s) ** 2  # the hats' own spectrum
    second_difference = (2 * np.sin(np.pi * f * settings.segment_s)) ** 2
    gain2 = float(np.trace((g.conj().T @ g).real)) / 3 * hat**2
    return gain2 * settings.rows_per_segment / second_difference**2


class _Run:
    """Working data of one run (what `Inverter` holds is constant, what is here changes)."""

    def __init__(self, inverter: Inverter, reference: Reference, state: FloatArray) -> None:
        s = inverter.settings
        geometry = inverter.machine.kinematics
        self.inverter, self.reference, self.state = inverter, reference, state
        self.n = len(reference.extrusion)
        self.last = self.n - reference.rest  # the knot at which the run's command comes to rest
        self.wanted = inverse(geometry, reference.nozzle)
        self.centripetal = jacobian_rate_term(geometry, reference.nozzle, reference.velocity)
        self.gamma = np.zeros((self.n + 1, 3))
        middle = reference.nozzle[s.substeps // 2 :: s.substeps, :2]
        self.place = np.ascontiguousarray(middle[: self.n])
        self.knots = slice(0, self.n * s.substeps + 1, s.substeps)

    def solve(self) -> RunResult:
        windows = limited = 0
        responses = []
        at = 0
        while at < self.last:
            window = _Window(self, at)
            response, self.state = window.solve()
            responses.append(response)
            windows, limited = windows + 1, limited + window.limited
            at = window.commit_end
        vertices = self.vertices(0, self.last)
        worst = excess(self.command(0, self.last), self.inverter.limits)
        return RunResult(vertices, self.state, np.concatenate(responses), windows, limited, worst)

    def command(self, first: int, last: int) -> FloatArray:
        """Carriage commands at the knots first..last, (last − first + 1, 3) mm."""
        s = self.inverter.settings.substeps
        return self.wanted[first * s : last * s + 1 : s] + self.gamma[first : last + 1]

    def vertices(self, first: int, last: int) -> FloatArray:
        """Nozzle commands at the knots first..last, (last − first + 1, 3) mm."""
        return forward(self.inverter.machine.kinematics, self.command(first, last))


@dataclass(frozen=True, slots=True)
class _System:
    """The least squares of one window, ready to be solved for any error."""

    phi: FloatArray  # (rows, 3 unknowns)
    hessian: FloatArray  # (3 unknowns, 3 unknowns) ΦᵀΦ + ρ D²ᵀD²
    factor: tuple[FloatArray, bool]  # its Cholesky factor


class _Window:
    """One least-squares problem: knots `at`+1 … of a run."""

    limited = 0

    def __init__(self, run: _Run, at: int) -> None:
        s = run.inverter.settings
        self.run, self.at = run, at
        self.end = min(at + s.commit + s.preview, run.n)
        self.commit_end = min(at + s.commit, run.last)
        if run.last - self.commit_end < s.preview // 2:
            self.commit_end = run.last  # a short remainder joins this window
            self.end = min(run.last + s.preview, run.n)
        self.unknowns = min(self.end, run.last - 1) - at
        self.place = run.place[at : self.end]

    def solve(self) -> tuple[FloatArray, FloatArray]:
        """Set the run's γ for this window; returns the committed response (mm) and the state at its end."""
        run, s = self.run, self.run.inverter.settings
        models = models_along(run.inverter.fine, self.place)
        response, states = self.simulate(models, self.straight())
        if self.unknowns > 0:
            system = self.system()
            self.improve(system, response)
            for _ in range(s.corrections):
                response, states = self.simulate(models, self.as_played())
                self.improve(system, response)
        response, states = self.simulate(models, self.as_played())
        kept = self.commit_end - self.at
        return response[: kept * s.substeps], states[kept]

    def system(self) -> _System:
        run, s = self.run, self.run.inverter.settings
        table = run.inverter.coarse
        a, b0, b1, _ = models_along(table, self.place)
        j = interpolate(table.jacobian, table.x0_mm, table.pitch_mm, table.nodes, self.place)
        phi = basis_response(a, b0, b1, j, self.unknowns, s.rows_per_segment)
        hessian = phi.T @ phi + run.inverter.effort * _second_differences(self.unknowns)
        return _System(phi, hessian, cho_factor(hessian, check_finite=False))

    def improve(self, system: _System, response: FloatArray) -> None:
        """γ += the least-squares answer to the error that is left, within the limits."""
        run, s = self.run, self.run.inverter.settings
        stride = s.substeps // s.rows_per_segment
        first = self.at * s.substeps
        target = run.reference.nozzle[first + 1 : first + 1 + len(response)]
        error = (target - response)[stride - 1 :: stride]
        gradient = system.phi.T @ error.ravel() - self.effort_gradient()
        step = cho_solve(system.factor, gradient, check_finite=False)
        unknown = slice(self.at + 1, self.at + 1 + self.unknowns)
        command, plan = self.around()
        tried = command.copy()
        tried[2:-2] += step.reshape(-1, 3)
        if excess(tried[1:-1], run.inverter.limits) > 1.0:
            self.limited = 1
            step = limited_step(system.hessian, gradient, command, plan, run.inverter.limits)
        run.gamma[unknown] += step.reshape(-1, 3)

    def around(self) -> tuple[FloatArray, FloatArray]:
        """Command and plan at the unknown knots and two on either side, each (unknowns + 4, 3) mm."""
        run, s = self.run, self.run.inverter.settings.substeps
        knots = np.clip(np.arange(self.at - 1, self.at + self.unknowns + 3), 0, run.n)
        plan = run.wanted[knots * s]
        return plan + run.gamma[knots], plan

    def effort_gradient(self) -> FloatArray:
        """ρ D²ᵀ D² γ of the window's unknowns, with the knots around them as they are."""
        gamma, first = self.run.gamma, self.at + 1
        around = np.zeros((self.unknowns + 4, 3))
        low = max(first - 2, 0)
        known = gamma[low : first + self.unknowns + 2]
        around[low - first + 2 : low - first + 2 + len(known)] = known
        second = np.diff(around, 2, axis=0)
        return self.run.inverter.effort * np.diff(second, 2, axis=0).ravel()

    def straight(self) -> FloatArray:
        """The command as straight lines of the carriages between knots, (m, 3) mm."""
        run, s = self.run, self.run.inverter.settings.substeps
        q = run.wanted[self.at * s : self.end * s + 1 : s] + run.gamma[self.at : self.end + 1]
        weight = (np.arange(s) / s)[None, :, None]
        inside = q[:-1, None] * (1 - weight) + q[1:, None] * weight
        return np.concatenate([inside.reshape(-1, 3), q[-1:]])

    def as_played(self) -> FloatArray:
        """The command as the firmware plays the segments: straight for the nozzle, with its ramps. (m, 3) mm."""
        run, s = self.run, self.run.inverter.settings
        before = min(self.at, 4)  # committed segments, for the speed at which the window is entered
        first = self.at - before
        vertices = run.vertices(first, self.end)
        speeds = played(vertices, run.reference.extrusion[first : self.end], s.segment_s, s.output)
        nozzle = sample_segments(
            vertices, speeds.cruise, speeds.junction, speeds.acceleration, speeds.duration, s.substeps
        )
        return inverse(run.inverter.machine.kinematics, nozzle[before * s.substeps :])

    def simulate(self, models: tuple[FloatArray, ...], command: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Nozzle (m, 3) mm after every substep, and the states at the knots."""
        run, s = self.run, self.run.inverter.settings.substeps
        centripetal = run.centripetal[self.at * s : self.end * s + 1]
        q, states = simulate(*models, s, run.state, command, centripetal, 1)
        return forward(run.inverter.machine.kinematics, q), states


def _second_differences(unknowns: int) -> FloatArray:
    """D²ᵀ D² for `unknowns` knots of three carriages with fixed knots on both sides."""
    d = np.diff(np.eye(unknowns + 4), 2, axis=0)[:, 2:-2]
    return np.kron(d.T @ d, np.eye(3))
