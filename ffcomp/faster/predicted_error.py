"""Predict the contour error of a motion at a quantile over the printers that the machine file allows.

The response of a printer that is a little off is that of the machine file's printer and, nearly, a sum of changes, one
for each independent direction of its parameters' errors. A few of them are computed: the directions
that change the printer's response most, by one standard deviation each. The ensemble sums them with a fixed sample
of deviates. What counts is a printer's whole print, its 99th percentile over time; and of that, over printers, the
quantile that the user's safety states.

There are two levels of fidelity. `Ensemble.errors` needs the solved command. `forecast` needs the plan alone: the error
of the path as the robust inverse sees it, D r − r with D of the middle of a span (`ffcomp/inverse/sensitivity.py`), one
transform forwards and one backwards for each direction, a twentieth of the cost of a solution.
"""

from __future__ import annotations

import weakref
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.reference import Reference
from ffcomp.inverse.sensitivity import MARGIN, Sensitivity, machines_off, perturbed_machines
from ffcomp.metrics import contour_error
from ffcomp.planner.trajectory import Trajectory
from models.arrays import ComplexArray, FloatArray, IntArray
from models.compiled import fast_kernel, kernel
from models.machine import Machine
from models.vibration.scheduled import Schedule, plant_table

ShortArray = NDArray[np.float32]

SAMPLES = 127
EXCEEDANCE = 0.01  # share of the time that a printer's error may be above the bound
BIN_WIDTH, BINS = 0.02, 400  # times the bound: what errors are counted in
LEAST_COUNTED = 0.3  # times the bound: smaller errors are not resolved
FARTHEST_SD = 3.0  # standard deviations, in all directions together


def error_at_quantile(nominal: FloatArray, changes: ShortArray, scale: FloatArray, quantile_sd: float) -> FloatArray:
    """Return the error at the quantile at each moment by itself, (m,) times the bound.

    Parameters
    ----------
    nominal : (m,) mm, of the machine file's printer
    changes : (k, m, 3) mm, across the path, for one standard deviation in each direction
    scale : (m,) 1/mm, what errors are multiplied by: one over the bound
    """
    return np.asarray(_error_at_quantile(np.ascontiguousarray(nominal), changes, scale, quantile_sd))


def histogram(nominal: FloatArray, changes: ShortArray, scale: FloatArray) -> IntArray:
    """Count moments by the printer and its error, (drawn, BINS); arguments as `error_at_quantile`."""
    return np.asarray(_histogram(np.ascontiguousarray(nominal), changes, scale, deviates_in(len(changes))))


def ensemble_percentile(counts: Sequence[IntArray], still: float, safety: float) -> float:
    """Return the 99th percentile of the error over time at the printers' quantile, times the bound.

    still : moments besides, without an error
    """
    total = np.sum(counts, axis=0)
    may = EXCEEDANCE * (float(total[0].sum()) + still)
    above = np.cumsum(total[:, ::-1], axis=1)[:, ::-1]  # moments in this bin or above it
    at = np.maximum((above > may).sum(axis=1) - 1, 0)
    rows = np.arange(len(total))
    beyond = above[rows, at] - total[rows, at]
    share = np.clip((may - beyond) / np.maximum(total[rows, at], 1), 0.0, 1.0)
    return float(np.quantile(BIN_WIDTH * (at + 1.0 - share), 1.0 - safety))


@cache
def deviates_in(directions: int) -> ShortArray:
    """Return how far printers are off in each direction, (n, directions) standard deviations; one, if there is none.

    They lie evenly: a Kronecker sequence of the generalised golden ratio.
    """
    from scipy.special import ndtri

    if not directions:
        return np.zeros((1, 0), dtype=np.float32)
    ratio = 2.0
    for _ in range(30):
        ratio = (1.0 + ratio) ** (1.0 / (directions + 1))
    steps = ratio ** -np.arange(1.0, directions + 1.0)
    even = (0.5 + np.arange(1.0, SAMPLES + 1.0)[:, None] * steps) % 1.0
    return np.asarray(ndtri(even), dtype=np.float32)


@kernel
def _error_at_quantile(nominal: FloatArray, changes: ShortArray, scale: FloatArray, quantile_sd: float) -> FloatArray:
    error = np.empty(len(nominal))
    for i in range(len(nominal)):
        total = 0.0
        for a in range(changes.shape[0]):
            for c in range(3):
                total += changes[a, i, c] * changes[a, i, c]
        error[i] = scale[i] * np.sqrt(nominal[i] * nominal[i] + quantile_sd * quantile_sd * total)
    return error


@fast_kernel
def _histogram(nominal: FloatArray, changes: ShortArray, scale: FloatArray, deviates: ShortArray) -> IntArray:
    directions, m, n = changes.shape[0], changes.shape[1], len(deviates)
    counts = np.zeros((n, BINS), np.int64)
    low = 0
    x, y, z = np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.float32)
    for i in range(m):
        square, total = nominal[i] * nominal[i], 0.0
        for a in range(directions):
            for c in range(3):
                total += changes[a, i, c] * changes[a, i, c]
        if scale[i] * np.sqrt(square + FARTHEST_SD * FARTHEST_SD * total) < LEAST_COUNTED:
            low += 1
            continue
        x[:], y[:], z[:] = np.float32(0.0), np.float32(0.0), np.float32(0.0)
        for a in range(directions):
            ex, ey, ez = changes[a, i, 0], changes[a, i, 1], changes[a, i, 2]
            for j in range(n):
                x[j] += deviates[j, a] * ex
                y[j] += deviates[j, a] * ey
                z[j] += deviates[j, a] * ez
        times = scale[i] / BIN_WIDTH
        for j in range(n):
            value = times * np.sqrt(square + x[j] * x[j] + y[j] * y[j] + z[j] * z[j])
            counts[j, min(int(value), BINS - 1)] += 1
    counts[:, 0] += low
    return counts


TAIL_S = 0.05  # how long after its end a section is looked at
STANDSTILL_MM = 2e-3  # from row to row: below, a motion has no direction, and all of an error counts


def forecast_error(
    sensitivity: Sensitivity, plan: Trajectory, begin_t: float, end_t: float
) -> tuple[FloatArray, FloatArray, ShortArray]:
    """Forecast the error of a section whose path is inverted unchanged.

    Returns
    -------
    the moments (m,) s; across the path, the file's printer's error (m,) mm, and its changes (k, m, 3) mm in the
    directions of the parameters
    """
    row_s = sensitivity.row_s
    n = int(np.ceil((end_t - begin_t + TAIL_S) / row_s))
    t = begin_t + row_s * np.arange(-MARGIN, n + MARGIN, dtype=np.float64)
    nozzle, velocity = plan.motion_within(t, begin_t, end_t)
    error = sensitivity.tracking_error(nozzle)
    nominal, changes = _normal_error(error, velocity[MARGIN : MARGIN + n], STANDSTILL_MM / row_s)
    return t[MARGIN : MARGIN + n], nominal, changes


@kernel
def _normal_error(error: ShortArray, velocity: FloatArray, standing: float) -> tuple[FloatArray, ShortArray]:
    """Take what lies along the motion out of errors (1 + k, m, 3): the first one's size, and the others."""
    k, m = error.shape[0] - 1, error.shape[1]
    nominal, changes = np.empty(m), np.empty((k, m, 3), np.float32)
    for i in range(m):
        v = velocity[i]
        speed = np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
        share = 1.0 / (speed * speed) if speed > standing else 0.0
        for a in range(k + 1):
            e = error[a, i]
            tangential = share * (e[0] * v[0] + e[1] * v[1] + e[2] * v[2])
            x, y, z = e[0] - tangential * v[0], e[1] - tangential * v[1], e[2] - tangential * v[2]
            if a:
                changes[a - 1, i, 0], changes[a - 1, i, 1], changes[a - 1, i, 2] = x, y, z
            else:
                nominal[i] = np.sqrt(x * x + y * y + z * z)
    return nominal, changes


DIRECTIONS = 4  # of the parameters that change a printer's response most: 98 % of the variance on a delta
TABLE_PITCH_MM = 30.0  # of their tables over the bed: coarser than the machine's, since only differences count
SENSITIVITY_PLACES_MM = ((0.0, 0.0), (40.0, 0.0), (0.0, 40.0))  # where the directions are found
LOWEST_HZ, FREQUENCIES = 2.0, 60  # of the frequencies there
SUBSTEP_STRIDE = 2  # substeps: often enough for what rings
STANDSTILL_MM_PER_S = 1.0  # below, a motion has no direction, and all of an error counts

_ensembles: weakref.WeakKeyDictionary[InverseModel, Ensemble] = weakref.WeakKeyDictionary()


def ensemble_of(model: InverseModel, safety: float) -> Ensemble:
    """Return the printers of a machine, the same ones as long as its model lives."""
    known = _ensembles.get(model)
    if known is None or known.safety != safety:
        known = _ensembles[model] = Ensemble(weakref.proxy(model), safety)
    return known


@dataclass(frozen=True, eq=False)
class Ensemble:
    """The machine file's printer, and some that are off by what its `[uncertainty]` says."""

    model: InverseModel
    safety: float

    @cached_property
    def nominal(self) -> Schedule:
        """The plant of the machine file's printer on the same coarse table, so that only differences count."""
        return self._plant(self.model.machine)

    @cached_property
    def perturbed(self) -> list[tuple[Machine, Schedule]]:
        """The printers that are off, with their plants; none if the machine file is certain of everything."""
        machine, (_, *each) = self.model.machine, perturbed_machines(self.model.machine)
        if not each:
            return []
        directions = _principal(machine, each, self.model.settings.inverse_hz)
        return [(printer, self._plant(printer)) for printer in machines_off(machine, directions)]

    def _plant(self, machine: Machine) -> Schedule:
        step_s = self.model.settings.segment_s / self.model.settings.substeps
        return Schedule(machine.kinematics, plant_table(machine.kinematics, machine.vibration, step_s, TABLE_PITCH_MM))

    @cached_property
    def quantile_sd(self) -> float:
        """How many standard deviations the wanted quantile is away."""
        from scipy.stats import norm  # 0.3 s to import

        return float(norm.ppf(1.0 - 0.5 * self.safety))

    @property
    def step_s(self) -> float:
        """Time between two moments, s."""
        return SUBSTEP_STRIDE * self.model.settings.segment_s / self.model.settings.substeps

    def errors(self, reference: Reference, vertices: FloatArray) -> tuple[FloatArray, ShortArray]:
        """Return contour errors at the moments of a command (n + 1, 3) mm at the section's knots, from rest.

        The file's printer's (m,) mm, and changes (k, m, 3) mm.
        """
        model, at = self.model, slice(SUBSTEP_STRIDE - 1, None, SUBSTEP_STRIDE)
        played = model.executed(reference, vertices)
        response, _ = model.respond(reference, played, model.machine.equilibrium(reference.at_knots(np.array([0]))[0]))
        nominal = contour_error(*reference.path(), self.times(reference), response[at])
        changes = [change[at] for change in self._changes(reference, played)]
        if not changes:
            return nominal, np.empty((0, len(nominal), 3), np.float32)
        return nominal, np.array(changes, dtype=np.float32)

    def times(self, reference: Reference) -> FloatArray:
        """Return when the errors of `errors` are, (m,) s on the plan's clock."""
        count = reference.knots * self.model.settings.substeps // SUBSTEP_STRIDE
        return np.asarray(reference.t0 + self.step_s * (1.0 + np.arange(count)))

    def _changes(self, reference: Reference, played: FloatArray) -> Iterator[FloatArray]:
        """Yield what changes across the path, (m, 3) mm after every substep of a command, in each direction."""
        if not self.perturbed:
            return
        model, s = self.model, self.model.settings
        nozzle, velocity = reference.substeps(reference.knots)
        place = model.places(nozzle)
        centripetal = model.kinematics.rate_term(nozzle, np.ascontiguousarray(velocity))
        command = model.kinematics.inverse(played)

        def respond(machine: Machine, plant: Schedule) -> FloatArray:
            q = plant.play(place, centripetal, command, machine.equilibrium(nozzle[0]), s.substeps)[0]
            return model.kinematics.forward(q)

        speed = np.sqrt((velocity[1:] ** 2).sum(axis=1, keepdims=True))
        moving = np.maximum(speed, STANDSTILL_MM_PER_S)
        tangential = np.where(speed > STANDSTILL_MM_PER_S, velocity[1:] / moving, 0.0)
        nominal = respond(model.machine, self.nominal)
        for machine, plant in self.perturbed:
            change = respond(machine, plant) - nominal
            yield change - (change * tangential).sum(axis=1, keepdims=True) * tangential


def _principal(machine: Machine, each: list[Machine], bandwidth_hz: float) -> FloatArray:
    """Return the directions of deviates (k, columns), of length one, that change the answer most.

    each : the machine with one deviate at one standard deviation
    """
    f = np.linspace(LOWEST_HZ, bandwidth_hz, FREQUENCIES)
    changes = []
    for place in np.array(SENSITIVITY_PLACES_MM):
        known = machine.vibration.frequency_response(place, f, "nozzle", "nozzle")
        responses = (other.vibration.frequency_response(place, f, "nozzle", "nozzle") for other in each)
        changes.append([(respond @ np.linalg.inv(known)).ravel() for respond in responses])
    change: ComplexArray = np.concatenate(changes, axis=1) - np.tile(
        np.eye(3).ravel(), FREQUENCIES * len(SENSITIVITY_PLACES_MM)
    )
    _, vectors = np.linalg.eigh((change @ np.conj(change.T)).real)
    return np.asarray(vectors[:, ::-1].T[:DIRECTIONS])
