"""Filtered B-splines on the scheduled plant: the command whose response is the wanted path.

The basis is what is played: the firmware plays our G1 segments, so the command is a spline of degree 1 with a knot at
the end of every segment. One run (from rest to rest) is solved in windows; the state is carried from each to the next.

In error coordinates q_d = q* + N γ (q*: the wanted carriage path, N: the hats of the spline), each window minimises

    ‖ e₀ − Φ γ ‖² + ρ ‖ D² γ ‖²                                 Φ = J G N: the basis filtered through the plant

e₀ is the nozzle's error with γ = 0 from the carried state; D² γ S⁻² is the acceleration asked for beyond the plan's.
Then the very segments are played through the plant (ramps, chords, J̇ q̇) and the same factorised system removes what
error is left. γ is zero at both ends of a run: rest stays rest, and hand-over is exact.

Where the path has been steady for as long as the plant remembers, γ = τ q̇* with the plant's delay τ, and nothing is
solved.

Duan, Yoon & Okwudire, A limited-preview filtered B-spline approach to tracking control, Mechatronics 56 (2018) 287-296.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.linalg.blas import dsyrk

from ffcomp.invert.kernels import basis_response
from ffcomp.invert.limits import CommandLimits, excess, limited_step
from ffcomp.invert.settings import Settings
from ffcomp.played import played, sample_segments
from ffcomp.runs import Reference
from ffcomp.schedule import interpolate, models_along, moving_state, rest_state, simulate
from models.effects.catalogue import design_machine
from models.kinematics.kernels import FastDelta
from models.machine import Machine
from models.plant import PlantTable, plant_table

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class RunResult:
    vertices: FloatArray  # (n + 1, 3) mm: the nozzle command at the knots
    state: FloatArray  # (18,): of the plant at the last knot
    response: FloatArray  # (n·substeps, 3) mm: where the nozzle will be by the design model; empty if not asked for
    windows: int
    limited: int  # windows in which a limit had to be enforced
    excess: float  # how many times its limit a carriage is asked for at the worst; up to 1 is allowed


class Inverter:
    """Inverts one machine; the tables over its bed are made once."""

    def __init__(self, machine: Machine, settings: Settings) -> None:
        machine, self.not_modelled = design_machine(machine)
        self.machine, self.settings = machine, settings
        self.delta = FastDelta(machine.kinematics)
        self.fine = _table(machine, settings, settings.substeps)
        self.coarse = _table(machine, settings, settings.rows_per_segment)
        self.effort = effort_weight(machine, settings)
        self._systems: OrderedDict[tuple[int, ...], _System] = OrderedDict()
        own, knot_s = machine.limits, settings.segment_s
        self.limits = CommandLimits(
            own.carriage_velocity_mm_per_s * knot_s, own.carriage_acceleration_mm_per_s2 * knot_s**2
        )

    def hold(self, state: FloatArray, nozzle: FloatArray, duration_s: float) -> FloatArray:
        """The state after the command has rested at (3,) mm for a while: what still rings, rings on."""
        s = self.settings
        intervals = round(duration_s / s.segment_s)
        if intervals > 2 * s.memory:
            return rest_state(self.machine, nozzle)
        if intervals <= 0:
            return state
        models = models_along(self.coarse, np.repeat(nozzle[None, :2], intervals, axis=0))
        command = np.repeat(self.delta.inverse(nozzle[None]), intervals * s.rows_per_segment + 1, axis=0)
        _, states = simulate(*models, s.rows_per_segment, state, command, np.zeros_like(command), 1)
        return states[-1]

    def frozen(self, node: tuple[int, int], window: _Window) -> _System:
        """The system with the model of one node of the grid, kept for the next window there.

        What the model moves away from the node's is left to the corrections, which see the scheduled plant.
        """
        key = (*node, window.unknowns, len(window.place))
        if key in self._systems:
            self._systems.move_to_end(key)
            return self._systems[key]
        place = np.repeat(np.array([node]) * self.settings.frozen_mm, len(window.place), axis=0)
        system = self._systems[key] = window.system(place)
        if len(self._systems) > self.settings.frozen_kept:
            self._systems.popitem(last=False)
        return system

    def run(self, reference: Reference, state: FloatArray, keep_response: bool = False) -> RunResult:
        """Solve one run window by window, from the plant's state (18,) at its first knot."""
        return _Run(self, reference, state, keep_response).solve()


def _table(machine: Machine, settings: Settings, steps: int) -> PlantTable:
    """The plant over the bed, for that many steps a segment."""
    table = plant_table(machine, settings.segment_s / steps)
    return table.frozen() if settings.one_model else table


def effort_weight(machine: Machine, settings: Settings) -> float:
    """ρ for which accuracy and effort weigh alike at the bandwidth: ρ |D²(ω)|² = mean |G(ω)|² at the centre."""
    from models.receptance import nozzle_frf

    f = settings.bandwidth_hz
    g = nozzle_frf(machine, np.zeros(2), np.array([f]))[0]
    hat = np.sinc(f * settings.segment_s) ** 2  # the hats' own spectrum
    second_difference = (2 * np.sin(np.pi * f * settings.segment_s)) ** 2
    gain2 = float(np.trace((g.conj().T @ g).real)) / 3 * hat**2
    return gain2 * settings.rows_per_segment / second_difference**2


def steady_delay(machine: Machine) -> float:
    """τ of G(s) ≈ I − τ s: how far the machine lags behind a steady motion, s, on average of its towers."""
    carriage = machine.carriage
    drive = carriage.drive
    lag = carriage.guide_damping_n_s_per_m / carriage.belt_stiffness_n_per_m
    return float(np.mean(lag)) + ((drive.d2_per_s - drive.d1_per_s) / drive.d0_per_s2 if drive else 0.0)


class _Run:
    """Working data of one run (what `Inverter` holds is constant, what is here changes)."""

    def __init__(self, inverter: Inverter, reference: Reference, state: FloatArray, keep_response: bool) -> None:
        self.inverter, self.reference, self.state, self.keep = inverter, reference, state, keep_response
        self.last = reference.knots  # the knot at which the run's command comes to rest
        self.n = self.last + inverter.settings.preview  # knots in sight
        self.gamma = np.zeros((self.n + 1, 3))
        self.vertices = np.empty((self.last + 1, 3))
        self.extrusion = np.concatenate([np.diff(reference.extrusion()), np.zeros(self.n - self.last)])

    def solve(self) -> RunResult:
        windows = limited = 0
        responses = [np.empty((0, 3))]
        at = 0
        for quiet_from, quiet_to in [*self._quiet(), (self.last, self.last)]:
            while at < quiet_from:
                window = _Window(self, at, quiet_from)
                response, self.state = window.solve()
                responses.append(response if self.keep else response[:0])
                windows, limited = windows + 1, limited + window.limited
                at = window.commit_end
            while at < quiet_to:
                response, at = self._steady(at, quiet_to)
                responses.append(response)
        worst = excess(self.inverter.delta.inverse(self.vertices), self.inverter.limits)
        return RunResult(self.vertices, self.state, np.concatenate(responses), windows, limited, worst)

    def _quiet(self) -> list[tuple[int, int]]:
        """Stretches of knots (from, to) whose past and future are steady."""
        s = self.inverter.settings
        loud = np.flatnonzero(self.reference.bends() > s.quiet_mm_per_s)
        edges = np.concatenate([[-1], loud, [self.last]])
        begins, ends = edges[:-1] + 1 + s.memory, edges[1:] - s.preview
        # nothing moves before the first and after the last bend; a stretch shorter than a window is not worth its while
        return [(int(a), int(b)) for a, b in zip(begins, ends, strict=True) if b - a >= s.commit and a > s.memory]

    def _steady(self, at: int, to: int) -> tuple[FloatArray, int]:
        """Take γ = τ q̇* from knot `at` on, no further than `to`; simulate what must be known of it."""
        s, delta = self.inverter.settings, self.inverter.delta
        end = min(to, at + 16 * s.commit)
        nozzle, velocity = self.reference.substeps(at, end)
        wanted = delta.inverse(nozzle)
        tau = steady_delay(self.inverter.machine)
        ahead = delta.inverse(nozzle + velocity * tau)[:: s.substeps]
        self.gamma[at + 1 : end + 1] = (ahead - wanted[:: s.substeps])[1:]
        self.vertices[at : end + 1] = delta.forward(wanted[:: s.substeps] + self.gamma[at : end + 1])
        first = 0 if self.keep else max(0, (end - at) - s.memory)
        begin = first * s.substeps
        if first:
            self.state = moving_state(self.inverter.machine, nozzle[begin], velocity[begin], tau)
        response, states = self.respond(
            nozzle[begin:], velocity[begin:], _between(self.vertices[at + first : end + 1], s.substeps)
        )
        self.state = states[-1]
        return (response if self.keep else response[:0]), end

    def respond(self, nozzle: FloatArray, velocity: FloatArray, command: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Nozzle (m, 3) mm after every substep and states at the knots, from the present state.

        All (m + 1, 3) at the substeps: nozzle and velocity wanted, nozzle commanded.
        """
        inverter, s = self.inverter, self.inverter.settings.substeps
        models = models_along(inverter.fine, nozzle[s // 2 :: s, :2][: (len(nozzle) - 1) // s])
        centripetal = inverter.delta.rate_term(nozzle, velocity)
        q, states = simulate(*models, s, self.state, inverter.delta.inverse(command), centripetal, 1)
        return inverter.delta.forward(q), states


@dataclass(frozen=True, slots=True)
class _System:
    """The least squares of one window, ready to be solved for any error."""

    phi: FloatArray  # (rows, 3 unknowns)
    hessian: FloatArray  # (3 unknowns, 3 unknowns) ΦᵀΦ + ρ D²ᵀD²
    factor: tuple[FloatArray, bool]  # its Cholesky factor


class _Window:
    """One least-squares problem: knots `at`+1 … of a run, kept up to `stop` at most."""

    def __init__(self, run: _Run, at: int, stop: int) -> None:
        s = run.inverter.settings
        self.run, self.at, self.limited = run, at, 0
        self.commit_end = min(at + s.commit, stop)
        if stop - self.commit_end < s.preview // 2:
            self.commit_end = stop  # a short remainder joins this window
        self.end = min(self.commit_end + s.preview, run.n)
        self.unknowns = min(self.end, run.last - 1) - at
        self.nozzle, self.velocity = run.reference.substeps(at, self.end)
        self.wanted = run.inverter.delta.inverse(self.nozzle[:: s.substeps])
        self.place = np.ascontiguousarray(self.nozzle[s.substeps // 2 :: s.substeps, :2])

    def solve(self) -> tuple[FloatArray, FloatArray]:
        """Set the run's γ for this window; returns the committed response (mm) and the state at its end."""
        run, s = self.run, self.run.inverter.settings
        response, states = run.respond(self.nozzle, self.velocity, self.as_played())
        if self.unknowns > 0:
            frozen = self._frozen_at()
            system = self.system(self.place) if frozen is None else run.inverter.frozen(frozen, self)
            for _ in range(1 + s.corrections + (frozen is not None)):
                self.improve(system, response)
                response, states = run.respond(self.nozzle, self.velocity, self.as_played())
        kept = self.commit_end - self.at
        run.vertices[self.at : self.commit_end + 1] = self.vertices()[: kept + 1]
        return response[: kept * s.substeps], states[kept]

    def _frozen_at(self) -> tuple[int, int] | None:
        """The node of the grid of frozen models that serves this whole window, if it keeps near one."""
        pitch = self.run.inverter.settings.frozen_mm
        low, high = self.place.min(axis=0), self.place.max(axis=0)
        x, y = np.round((low + high) / (2 * pitch)).astype(int).tolist()
        near = max(np.abs(low - (x * pitch, y * pitch)).max(), np.abs(high - (x * pitch, y * pitch)).max()) <= pitch
        return (x, y) if near else None

    def system(self, place: FloatArray) -> _System:
        """The window's least squares with the models at the places (n, 2) mm of its intervals."""
        inverter, s = self.run.inverter, self.run.inverter.settings
        table = inverter.coarse
        a, b0, b1, _ = models_along(table, place)
        j = interpolate(table.jacobian, table.x0_mm, table.pitch_mm, table.nodes, place)
        phi = basis_response(a, b0, b1, j, self.unknowns, s.rows_per_segment)
        hessian = dsyrk(1.0, phi.T, lower=1)  # phi is row-major: its transpose is what LAPACK calls a matrix
        hessian += inverter.effort * _second_differences(self.unknowns)
        return _System(phi, hessian, cho_factor(hessian, lower=True, check_finite=False))

    def improve(self, system: _System, response: FloatArray) -> None:
        """γ += the least-squares answer to the error that is left, within the limits."""
        run, s = self.run, self.run.inverter.settings
        stride = s.substeps // s.rows_per_segment
        error = (self.nozzle[1:] - response)[stride - 1 :: stride]
        gradient = error.ravel() @ system.phi - self.effort_gradient()
        step = cho_solve(system.factor, gradient, check_finite=False)
        unknown = slice(self.at + 1, self.at + 1 + self.unknowns)
        command, plan = self.around()
        tried = command.copy()
        tried[2:-2] += step.reshape(-1, 3)
        if excess(tried[1:-1], run.inverter.limits) > 1.0:
            self.limited = 1
            hessian = np.tril(system.hessian) + np.tril(system.hessian, -1).T
            step = limited_step(hessian, gradient, command, plan, run.inverter.limits)
        run.gamma[unknown] += step.reshape(-1, 3)

    def around(self) -> tuple[FloatArray, FloatArray]:
        """Command and plan at the unknown knots and two on either side, each (unknowns + 4, 3) mm."""
        knots = np.arange(self.at - 1, self.at + self.unknowns + 3)
        plan = self.run.inverter.delta.inverse(self.run.reference.at_knots(knots))
        return plan + self.run.gamma[np.clip(knots, 0, self.run.n)], plan

    def effort_gradient(self) -> FloatArray:
        """ρ D²ᵀ D² γ of the window's unknowns, with the knots around them as they are."""
        gamma, first = self.run.gamma, self.at + 1
        around = np.zeros((self.unknowns + 4, 3))
        low = max(first - 2, 0)
        known = gamma[low : first + self.unknowns + 2]
        around[low - first + 2 : low - first + 2 + len(known)] = known
        second = np.diff(around, 2, axis=0)
        return self.run.inverter.effort * np.diff(second, 2, axis=0).ravel()

    def command(self) -> FloatArray:
        """Carriage commands at the window's knots, (n + 1, 3) mm."""
        return self.wanted + self.run.gamma[self.at : self.end + 1]

    def vertices(self) -> FloatArray:
        return self.run.inverter.delta.forward(self.command())

    def as_played(self) -> FloatArray:
        """The command as the firmware plays the segments: straight for the nozzle, with its ramps. (m, 3) mm."""
        run, s = self.run, self.run.inverter.settings
        before = min(self.at, 4)  # committed segments, for the speed at which the window is entered
        first = self.at - before
        vertices = np.concatenate([run.vertices[first : self.at], self.vertices()])
        lasting = np.full(len(vertices) - 1, s.segment_s)
        speeds = played(vertices, run.extrusion[first : self.end], lasting, s.output)
        nozzle = sample_segments(
            vertices, speeds.cruise, speeds.junction, speeds.acceleration, speeds.duration, s.substeps
        )
        return nozzle[before * s.substeps :]


def _between(vertices: FloatArray, substeps: int) -> FloatArray:
    """Points on the straight lines between vertices: (n + 1, 3) -> (n·substeps + 1, 3)."""
    weight = (np.arange(substeps) / substeps)[None, :, None]
    inside = vertices[:-1, None] * (1 - weight) + vertices[1:, None] * weight
    return np.concatenate([inside.reshape(-1, 3), vertices[-1:]])


@lru_cache(maxsize=8)
def _second_differences(unknowns: int) -> FloatArray:
    """D²ᵀ D² for `unknowns` knots of three carriages with given knots on both sides."""
    d = np.diff(np.eye(unknowns + 4), 2, axis=0)[:, 2:-2]
    return np.asarray(np.kron(d.T @ d, np.eye(3)), dtype=np.float64)
