"""The diagnosis of a force-driven axis: force in, position out; the EMPS benchmark is one.

    M q̈ = F − F_v q̇ − F_0 − (missing effects)

EMPS: A. Janot, M. Gautier and M. Brunot, "Data Set and Reference Models of EMPS", Nonlinear System Identification
Benchmarks, 2019. Unlike the printer it has no command and no spring: the measured force drives it, and a missing
effect adds up in its position without bound. So the simulation begins anew every tenth of a second, with the measured
position and speed (multiple shooting; Bock 1981): its error is the effect of a missing force in that time. An axis has
one position only; windows of time, of some seconds each, are held out instead. Recordings are taken to follow one
reference motion, as the benchmark's two do: a window is left out of all of them at once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numba import njit

from ffcomp.diagnose.problem import Candidate, InfeasibleParameters, Observation, Parameter, Problem
from ffcomp.errors import MeasurementError
from models.arrays import FloatArray

SMOOTH_M_PER_S = 1e-4  # below this speed dry friction turns over smoothly
SUBSTEPS = 4
# NOTE: of 0.05 to 1 s the length with the narrowest intervals on EMPS, and with the values nearest to the published:
# shorter shots suffer from the speed they begin with, longer ones from every newton by which the force is wrong.
SHOT_S = 0.1
WINDOW_SHOTS = 40  # in a window of time
SPEED_SPAN_S = 0.02  # the speed a shot begins with is the slope over so much of the measured position

MASS, VISCOUS, OFFSET = "axis.mass_kg", "axis.viscous_n_s_per_m", "axis.offset_n"


@dataclass(frozen=True, eq=False)
class ForceDriven:
    """One recording of an axis."""

    name: str
    time_s: FloatArray  # (n,)
    force_n: FloatArray  # (n,)
    position_mm: FloatArray  # (n,)

    @property
    def rate_hz(self) -> float:
        """Mean sample rate."""
        return (len(self.time_s) - 1) / float(self.time_s[-1] - self.time_s[0])


def read_emps(path: str | Path) -> ForceDriven:
    """Read one of the benchmark's MATLAB files: motor voltage times gain is force, `qm` the measured position.

    NOTE: the file with pulses holds them once more as `pulses_N`. They are in `vir` already, and in volts: `vir` jumps
    by 5 V where they do, and regressing gain · vir on mass, frictions, offset and `pulses_N` gives the last a factor
    of -0.03 to -0.07. Added as a force they would be half the time a force that did not act.
    """
    from scipy.io import loadmat

    data = loadmat(path)
    missing = [key for key in ("t", "vir", "qm", "gtau") if key not in data]
    if missing:
        raise MeasurementError(str(path), [f"The variable {missing[0]!r} is missing; an EMPS file has it."])
    t, voltage, q = (np.asarray(data[key], dtype=float).ravel() for key in ("t", "vir", "qm"))
    return ForceDriven(Path(path).stem, t, float(data["gtau"].ravel()[0]) * voltage, q * 1e3)


class AxisProblem(Problem):
    """Recordings of one axis, with rough guesses of mass and viscous friction: their priors are wide."""

    band_hz = (0.02, 50.0)

    def __init__(self, recordings: Sequence[ForceDriven], mass_kg: float, viscous_n_s_per_m: float) -> None:
        with_speed = [(recording, _speed(recording)) for recording in recordings]
        self.windows = [
            (_cut(recording, part), speed[part]) for recording, speed in with_speed for part in _parts(recording)
        ]
        self.observations = [_observation(recording, speed) for recording, speed in self.windows]
        self.parameters = (
            Parameter(MASS, mass_kg, 0.5 * mass_kg, 0.05 * mass_kg),
            Parameter(VISCOUS, viscous_n_s_per_m, viscous_n_s_per_m, 0.0),
            Parameter(OFFSET, 0.0, 10.0),
        )
        self.candidates = CANDIDATES

    def simulate(
        self, values: Mapping[str, float], only: Sequence[int] | None = None, *, coarse: bool = False
    ) -> list[FloatArray]:
        """Simulate windows of time; `coarse` makes no difference, for it is quick anyway."""
        del coarse
        given = {**{n.name: n.start for n in self.parameters}, **values}
        chosen = range(len(self.windows)) if only is None else only
        return [self._one(i, given) for i in chosen]

    def _one(self, i: int, v: Mapping[str, float]) -> FloatArray:
        recording, speed = self.windows[i]
        parameters = np.array([v.get(name, neutral) for name, neutral in _PARAMETERS])
        shot = round(SHOT_S * recording.rate_hz)
        q = _simulated_shots(
            recording.force_n,
            1 / recording.rate_hz,
            SUBSTEPS,
            shot,
            recording.position_mm / 1e3,
            speed / 1e3,
            parameters,
        )
        if not np.all(np.isfinite(q)):
            raise InfeasibleParameters("Such forces drive the axis to infinity within one shot.")
        return (q * 1e3)[:, None]


def _speed(recording: ForceDriven) -> FloatArray:
    """Return the speed, (n,) mm/s."""
    from scipy.signal import savgol_filter

    span = 2 * round(SPEED_SPAN_S * recording.rate_hz / 2) + 1
    return np.asarray(savgol_filter(recording.position_mm, span, 2, deriv=1, delta=1 / recording.rate_hz))


def _parts(recording: ForceDriven) -> list[slice]:
    """Split into whole windows; the rest at the end makes the last one longer."""
    rows = WINDOW_SHOTS * round(SHOT_S * recording.rate_hz)
    starts = range(0, max(len(recording.time_s) - rows, 0) + 1, rows)
    return [slice(a, a + rows) for a in starts[:-1]] + [slice(starts[-1], None)]


def _cut(recording: ForceDriven, part: slice) -> ForceDriven:
    return ForceDriven(recording.name, recording.time_s[part], recording.force_n[part], recording.position_mm[part])


def _observation(recording: ForceDriven, speed: FloatArray) -> Observation:
    name = f"{recording.name} from {recording.time_s[0]:g} s"
    position = (float(recording.time_s[0]),)
    return Observation(
        name, name, position, recording.rate_hz, ("pos_q",), recording.position_mm[:, None], speed[:, None]
    )


FRICTION = "effects.coulomb_friction.force_n"
_STRIBECK = tuple(f"effects.stribeck_friction.{p}" for p in ("force_n", "extra_force_n", "velocity_mm_per_s"))
_SPRING = "effects.spring.stiffness_n_per_m"
_DRAG = "effects.quadratic_drag.force_n_s2_per_m2"
_COGGING = tuple(f"effects.cogging_force.{p}" for p in ("sine_n", "cosine_n", "pitch_mm"))
_ASYMMETRY = "effects.one_sided_damping.added_n_s_per_m"
_PARAMETERS = (
    (MASS, 1.0),
    (VISCOUS, 0.0),
    (OFFSET, 0.0),
    (FRICTION, 0.0),
    *zip(_STRIBECK, (0.0, 0.0, 10.0), strict=True),
    (_SPRING, 0.0),
    (_DRAG, 0.0),
    *zip(_COGGING, (0.0, 0.0, 20.0), strict=True),
    (_ASYMMETRY, 0.0),
)

CANDIDATES = (
    Candidate("coulomb_friction", (Parameter(FRICTION, 0.0, 20.0, 0.0, 500.0),), {FRICTION: 2.0}),
    Candidate(
        "stribeck_friction",
        (Parameter(_STRIBECK[0], 0.0, 20.0, 0.0, 500.0), Parameter(_STRIBECK[1], 0.0, 10.0, 0.0, 500.0)),
        {_STRIBECK[0]: 2.0, _STRIBECK[1]: 2.0},
        (Parameter(_STRIBECK[2], 10.0, 10.0, 0.5, 200.0),),
    ),
    Candidate("spring", (Parameter(_SPRING, 0.0, 100.0),), {_SPRING: 5.0}),
    Candidate("quadratic_drag", (Parameter(_DRAG, 0.0, 500.0),), {_DRAG: 20.0}),
    Candidate(
        "cogging_force",
        (Parameter(_COGGING[0], 0.0, 5.0), Parameter(_COGGING[1], 0.0, 5.0)),
        {_COGGING[0]: 0.5, _COGGING[1]: 0.5},
        (Parameter(_COGGING[2], 20.0, 5.0, 1.0, 200.0),),
        tuple({_COGGING[2]: pitch} for pitch in (5.0, 10.0, 20.0, 40.0)),
    ),
    # of one direction dry friction is no candidate: with the offset free it is the same as of both
    Candidate("one_sided_damping", (Parameter(_ASYMMETRY, 0.0, 100.0),), {_ASYMMETRY: 10.0}),
)


@njit(cache=True, nogil=True)
def _acceleration(q: float, v: float, force: float, p: FloatArray) -> float:
    side = np.tanh(v / SMOOTH_M_PER_S)
    dry = p[3] + p[4] + p[5] * np.exp(-((1e3 * v / p[6]) ** 2))
    held = p[1] * v + p[2] + dry * side + p[12] * max(v, 0.0)
    held += p[7] * q + p[8] * v * abs(v)
    phase = 2 * np.pi * 1e3 * q / p[11]
    held += p[9] * np.sin(phase) + p[10] * np.cos(phase)
    return float((force - held) / p[0])


@njit(cache=True, nogil=True)
def _simulated_shots(
    force: FloatArray,
    dt: float,
    substeps: int,
    shot: int,
    position: FloatArray,
    speed: FloatArray,
    p: FloatArray,
) -> FloatArray:
    """Integrate by midpoint steps, the force linear between samples, begun anew every `shot` samples: (n,) m."""
    out = np.empty(len(force))
    h = dt / substeps
    q, v = position[0], speed[0]
    for i in range(len(force)):
        if i % shot == 0:
            q, v = position[i], speed[i]
        out[i] = q
        if i == len(force) - 1:
            break
        for k in range(substeps):
            f = force[i] + (k + 0.5) / substeps * (force[i + 1] - force[i])
            middle = v + h / 2 * _acceleration(q, v, f, p)
            v_next = v + h * _acceleration(q + h / 2 * v, middle, f, p)
            if v * v_next < 0.0 and abs(f - p[2]) < p[3] + p[4] + p[5]:
                v_next = 0.0  # dry friction holds what it has stopped
            q += h * (v + v_next) / 2
            v = v_next
    return out
