"""Parameter values in, whitened residual out; fits of it, their evidence and their intervals.

Parameters are in units of their prior's standard deviation, z = (x − start)/sd, so the prior is |z|². The evidence is
Laplace's approximation, with J the derivative of the simulation by z (MacKay, Neural Computation 4, 1992):

    −2 ln Z = |r|²/φ + |z|² + ln det(I + JᵀJ/φ)

With φ, the scatter of |r|² by model error beside noise, the likelihood is tempered: a residual far above the noise
says little about numbers of the file that hardly change it. The sizes of effects are free.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ffcomp.diagnosis.noise import Whitener, whitener
from ffcomp.diagnosis.problem import Candidate, InfeasibleParameters, Parameter, Problem
from ffcomp.diagnosis.settings import SETTINGS, SearchSettings
from ffcomp.diagnosis.trace import Trace
from ffcomp.identification.uncertainty import NINETY_PERCENT, Estimate
from ffcomp.inference import fit as engine
from ffcomp.inference.covariance import clustered_covariance, overdispersion
from ffcomp.inference.problem import EstimationProblem as FittedProblem
from ffcomp.inference.problem import Observation, Unknown
from models.arrays import FloatArray, IntArray

BLOCK_HZ = 5.0  # over which the residual of a wrong shape keeps its sign
KEPT = 48  # residuals of the last values: a fit begins where the one before has ended
INFEASIBLE_SD = 1e6  # standard deviations, each entry of the residual of infeasible parameters
MOST_STEPS = 30  # of a fit
STEP = 0.01  # of a prior's standard deviation, for differences
LEAST_GAIN, SMALL_GAIN = 0.3, 1e-7  # of |r|², times φ; of what stands above the noise: a fit ends with less to gain
FORMULA_ERROR = 0.04  # of an effect's size, however loud it is: plants with other formulas than ours scatter so


# ---- the residual --------------------------------------------------------------------------------

_Key = tuple[frozenset[tuple[str, float]], tuple[int, ...] | None, bool]


@dataclass(frozen=True, eq=False)
class EstimationProblem:
    """A problem with its whitener."""

    problem: Problem
    whiten: Whitener
    measured: FloatArray  # (rows,) whitened
    coarse: bool = False  # quicker simulations
    settings: SearchSettings = SETTINGS
    trace: Trace = field(default_factory=Trace)  # shared by all derived from this one
    tolerance: float = SETTINGS.known_noise  # of the noise: a smaller discrepancy counts as none
    share: float = 1.0  # of all data
    only: tuple[int, ...] | None = None  # observations that are simulated; None: all
    cache: dict[_Key, FloatArray] = field(default_factory=dict)  # shared by all derived from this one on the same data

    def residual(self, values: Mapping[str, float]) -> FloatArray:
        """Return measured − simulated, whitened: (rows,)."""
        return next(self.residuals([values]))

    def residuals(self, many: Sequence[Mapping[str, float]]) -> Iterator[FloatArray]:
        """Evaluate several sets of values, in order; they are not to be written to."""
        keys = [(frozenset(values.items()), self.only, self.coarse) for values in many]
        cached = [self._known(key) for key in keys]
        new = self._evaluated([values for values, known in zip(many, cached, strict=True) if known is None])
        for key, known in zip(keys, cached, strict=True):
            self.cache.pop(key, None)
            for old in list(self.cache)[: 1 - KEPT]:
                del self.cache[old]
            self.cache[key] = next(new) if known is None else known
            yield self.cache[key]

    def _known(self, key: _Key) -> FloatArray | None:
        """Return a residual that is in the cache, or a part of one."""
        whole = None if self.only is None else self.cache.get((key[0], None, key[2]))
        return self.cache.get(key) if whole is None else whole[self.rows_of(self.only or ())]

    def _evaluated(self, many: Sequence[Mapping[str, float]]) -> Iterator[FloatArray]:
        infeasible = np.full(len(self.measured), INFEASIBLE_SD)
        self.trace.evaluations += len(many)
        for simulated in self.problem.simulate_many(many, self.only, coarse=self.coarse):
            if isinstance(simulated, InfeasibleParameters):
                yield infeasible
            else:
                residual = self.measured - self.whiten(simulated, self.only)
                yield residual if np.isfinite(residual @ residual) else infeasible

    @cached_property
    def motions(self) -> IntArray:
        """(rows,) number of the motion; repeats share one, and the model's error in it."""
        each = zip(self.whiten.rows, self.problem.motions, strict=True)
        return np.concatenate([np.full(part.stop - part.start, motion) for part, motion in each])

    @cached_property
    def blocks(self) -> IntArray:
        """(rows,) number of the block of 5 Hz in a motion."""
        block = (self.whiten.frequencies() // BLOCK_HZ).astype(np.int64)
        return np.asarray(self.motions * (block.max() + 1) + block)

    @cached_property
    def block_rows(self) -> float:
        """Rows in a block of 5 Hz of one observation, on average."""
        frequency, rows = self.whiten.frequencies(), self.whiten.rows
        return len(frequency) / sum(len(np.unique(frequency[part] // BLOCK_HZ)) for part in rows)

    @property
    def may_go_on(self) -> bool:
        """Whether the budget of work allows to try anything more."""
        return self.problem.work.allows()

    def limited_to(self, observations: Sequence[int]) -> EstimationProblem:
        """Return the problem with some of its observations only; their rows follow one another."""
        measured = self.measured[self.rows_of(observations)]
        share = self.share * len(measured) / len(self.measured)
        return replace(self, measured=measured, only=tuple(observations), share=share)

    def rows_of(self, observations: Sequence[int]) -> NDArray[np.int64]:
        """Return the indices of the rows of some observations."""
        parts = [self.whiten.rows[i] for i in observations]
        return np.concatenate([np.arange(part.start, part.stop) for part in parts])

    def on_part(self, problem: Problem) -> EstimationProblem:
        """Return the estimation on a part of the problem's data, by the same noise."""
        whiten = whitener(problem.observations, self.whiten.floor, self.whiten.band_hz)
        measured = whiten([o.measured for o in problem.observations])
        share = self.share * len(measured) / len(self.measured)
        return replace(self, problem=problem, whiten=whiten, measured=measured, share=share, cache={})


def estimation_problem(
    problem: Problem, whiten: Whitener, settings: SearchSettings = SETTINGS, trace: Trace | None = None
) -> EstimationProblem:
    """Whiten the measurements; the tolerance follows from how well the noise is known."""
    return EstimationProblem(
        problem,
        whiten,
        whiten([o.measured for o in problem.observations]),
        settings=settings,
        trace=trace or Trace(),
        tolerance=settings.known_noise if whiten.floor.from_repeats else settings.guessed_noise,
    )


# ---- a fit and its evidence ----------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Fit:
    """Parameters at their best values."""

    parameters: tuple[Parameter, ...]
    z: FloatArray  # (p,)
    residual: FloatArray  # (rows,)
    jacobian: FloatArray  # (rows, p), of the *simulation* by z
    block_rows: float = 1.0  # rows over which the residual of a wrong shape keeps its sign

    @property
    def values(self) -> dict[str, float]:
        """Parameter values by name."""
        return values_at(self.parameters, self.z)

    @property
    def chi_squared(self) -> float:
        """|r|²."""
        return float(self.residual @ self.residual)

    @property
    def cost(self) -> float:
        """|r|² + |z|²."""
        return self.chi_squared + float(self.z @ self.z)

    @cached_property
    def information(self) -> FloatArray:
        """(p, p) JᵀJ and the prior."""
        return np.diag(self.prior) + self.jacobian.T @ self.jacobian

    @cached_property
    def prior(self) -> FloatArray:
        """(p,) weight of each z²: φ of the file's numbers, 1 of the effects', whose sizes no file states."""
        return np.where(believed(self.parameters), self.overdispersion, 1.0)

    @property
    def evidence(self) -> float:
        """φ times −2 ln Z, without what all hypotheses share: the smaller the likelier."""
        return self.evidence_at(self.overdispersion)

    def evidence_at(self, scatter: float) -> float:
        """Return the evidence with another fit's φ, by which the two compare."""
        tempered = np.eye(len(self.z)) + self.jacobian.T @ self.jacobian / scatter
        logarithm = float(np.sum(np.log(np.maximum(np.linalg.eigvalsh(tempered), 1.0))))  # less is rounding
        weights = np.where(believed(self.parameters), scatter, 1.0)
        return self.chi_squared + float(self.z @ (weights * self.z)) + scatter * logarithm

    def ahead_of(self, other: Fit) -> float:
        """Return by how much −2 ln Z of another fit of the same data is larger, by the model error of this one."""
        scatter = self.overdispersion
        return (other.evidence_at(scatter) - self.evidence_at(scatter)) / scatter

    @property
    def discrepancy(self) -> float:
        """How far the cost stands above noise alone, as a share of it."""
        return self.cost / len(self.residual) - 1

    @property
    def overdispersion(self) -> float:
        """φ, by which model error scatters |r|² more than noise alone: see `overdispersion`."""
        return overdispersion(self.chi_squared / len(self.residual), self.block_rows)

    @cached_property
    def slope(self) -> FloatArray:
        """(p,) Jᵀr: half of what |r|² falls by with each z, at first."""
        return np.asarray(self.jacobian.T @ self.residual)

    @cached_property
    def predicted_gain(self) -> float:
        """The decrease of |r|² + φ|z|² by the best step inside the bounds, were the simulation linear."""
        gradient = self.slope - self.prior * self.z
        step = step_within(self.parameters, self.z, self.information, gradient)
        return float(2 * gradient @ step - step @ self.information @ step)

    def covariance(self, clusters: IntArray) -> FloatArray:
        """Estimate the covariance (p, p) of z, at least as wide as by leaving out each cluster, and as φ N⁻¹.

        Parameters
        ----------
        clusters : (rows,) number of each row's cluster: `EstimationProblem.blocks` or `EstimationProblem.motions`.
        """
        scatter = self.overdispersion
        by_noise = self.jacobian / np.sqrt(scatter), self.residual / np.sqrt(scatter)
        return clustered_covariance(*by_noise, clusters, self.prior / scatter)


def believed(parameters: Sequence[Parameter]) -> NDArray[np.bool_]:
    """Return which parameters, (p,), have a prior that says something: the file's numbers, by their uncertainties."""
    return np.array([not n.name.startswith("effects.") for n in parameters], dtype=bool)


def student_share(freedom: int) -> float:
    """Return by how much Student's 90 % interval of so many degrees of freedom is wider than the normal one."""
    from scipy.special import stdtrit

    return float(stdtrit(freedom, 0.95)) / NINETY_PERCENT


def solved(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solve matrix x = right, symmetric and positive definite: scaled, because its diagonal may span twenty decades."""
    scale = 1 / np.sqrt(np.diag(matrix))
    regular = matrix * np.outer(scale, scale) + engine.RIDGE * np.eye(len(scale))
    scaled = np.linalg.solve(regular, scale * right if right.ndim == 1 else scale[:, None] * right)
    return np.asarray(scale * scaled if right.ndim == 1 else scale[:, None] * scaled)


def values_at(parameters: Sequence[Parameter], z: FloatArray) -> dict[str, float]:
    """Return the parameter values by name at z, (p,)."""
    return {n.name: n.start + n.sd * float(x) for n, x in zip(parameters, z, strict=True)}


def limits_of(parameters: Sequence[Parameter]) -> tuple[FloatArray, FloatArray]:
    """Return the lowest and highest z of the parameters, (p,) each."""
    low = np.array([(n.low - n.start) / n.sd for n in parameters])
    return low, np.array([(n.high - n.start) / n.sd for n in parameters])


def clipped(parameters: Sequence[Parameter], z: FloatArray) -> FloatArray:
    """Move z (p,) inside every parameter's bounds."""
    return np.clip(z, *limits_of(parameters))


def step_within(parameters: Sequence[Parameter], z: FloatArray, normal: FloatArray, gradient: FloatArray) -> FloatArray:
    """Minimise ½ sᵀNs − gᵀs over steps s (p,) from z that stay inside the bounds."""
    low, high = limits_of(parameters)
    return engine.bounded_step(normal, gradient, low - z, high - z)


def derivatives(
    estimation: EstimationProblem,
    parameters: Sequence[Parameter],
    z: FloatArray,
    residual: FloatArray,
    which: Sequence[int],
    central: bool = False,
    sizes: FloatArray | None = None,
    rough: int = 0,
) -> FloatArray:
    """Differentiate the simulation by some of z, (rows, len(which)); by the first `rough` in coarse simulations."""
    problem, one = _Scaled(estimation, parameters, rough), np.ones(len(residual))
    return engine.derivatives(problem, z, residual, one, which, central, sizes)


def fit(
    estimation: EstimationProblem,
    parameters: Sequence[Parameter],
    start: FloatArray,
    jacobian: FloatArray | None = None,
    renew: Sequence[int] = (),
    iterations: int = MOST_STEPS,
    small_gain: float = SMALL_GAIN,
    renew_all: bool = True,
    exact: bool = False,
    rough: int = 0,
) -> Fit:
    """Minimise |r|² + φ|z|² from `start`, (p,), φ = 1 for the effects' sizes; see `derivatives` and `FitSettings`."""
    settings = engine.FitSettings(
        iterations, gain=LEAST_GAIN, share=small_gain, keep=True, exact=exact, renew=renew, renew_all=renew_all
    )
    best = engine.fit(_Scaled(estimation, parameters, rough), start, settings, jacobian=jacobian)
    return Fit(tuple(parameters), best.values, best.residual, best.jacobian, estimation.block_rows)


class _Scaled(FittedProblem):
    """Parameters in units of their priors' standard deviations; what is simulated is the whitened residual itself."""

    def __init__(self, estimation: EstimationProblem, parameters: Sequence[Parameter], rough: int) -> None:
        self.estimation, self.parameters, self.rough = estimation, parameters, rough
        self.unknowns = [
            Unknown(n.name, 0.0, 1.0, (n.low - n.start) / n.sd, (n.high - n.start) / n.sd, STEP) for n in parameters
        ]
        self.observations = [Observation(estimation.measured, np.ones(len(estimation.measured)))]
        self.expected_cost = float(len(estimation.measured))

    def simulate(self, lanes: Sequence[FloatArray]) -> Iterator[FloatArray]:
        return self.estimation.residuals([values_at(self.parameters, z) for z in lanes])

    def whitened(self, simulated: FloatArray, sd: FloatArray) -> FloatArray:
        return simulated

    def scatter(self, residual: FloatArray) -> float:
        return overdispersion(float(residual @ residual) / len(residual), self.estimation.block_rows)

    def precision(self, residual: FloatArray) -> FloatArray:
        return np.where(believed(self.parameters), self.scatter(residual), 1.0)

    def by_fidelity(self, columns: Sequence[int]) -> list[tuple[FittedProblem, Sequence[int]]]:
        rough = 0 if self.estimation.coarse else self.rough
        quick = _Scaled(replace(self.estimation, coarse=True), self.parameters, 0)
        return [(self, [i for i in columns if i >= rough]), (quick, [i for i in columns if i < rough])]


# ---- intervals -----------------------------------------------------------------------------------


def intervals_of(estimation: EstimationProblem, fitted: Fit) -> dict[str, Estimate]:
    """Put intervals about the values of a fit, as wide as all parameters together leave them."""
    sizes = ~believed(fitted.parameters) & np.array([n.start == 0.0 for n in fitted.parameters])
    sd = np.hypot(deviations(estimation, fitted), FORMULA_ERROR * np.where(sizes, fitted.z, 0.0))
    return {
        n.name: _interval(n, fitted.values[n.name], n.sd * float(s)) for n, s in zip(fitted.parameters, sd, strict=True)
    }


def deviations(estimation: EstimationProblem, fitted: Fit) -> FloatArray:
    """Estimate the standard deviations (p,) of z: by the scatter of blocks of 5 Hz and of motions, whichever is larger.

    Where an effect's shape is not ours, it is wrong all through a motion, and what fits all of them best is off for
    each. How far few motions scatter is itself known to Student's t only (Bell & McCaffrey, Survey Methodology 28,
    2002).
    """
    by_blocks, by_motions = (np.diag(fitted.covariance(x)) for x in (estimation.blocks, estimation.motions))
    if (freedom := len(np.unique(estimation.motions)) - 1) < 1:
        return np.sqrt(by_blocks)
    return np.sqrt(np.maximum(by_blocks, student_share(freedom) ** 2 * freedom / (freedom + 1) * by_motions))


def by_deviance(c: Candidate, fitted: Fit, without: Fit, intervals: Mapping[str, Estimate]) -> dict[str, Estimate]:
    """Return the intervals with those of an effect's amplitudes no wider than the fit without the effect allows.

    Where few motions scatter, or an effect is far from linear, an interval may include no effect although that explains
    far less. The root of the deviance says how many standard deviations away it is (as profile likelihoods do: Venzon &
    Moolgavkar, Applied Statistics 37, 1988).
    """
    deviance = (without.cost - fitted.cost) / fitted.overdispersion
    z = dict(zip((n.name for n in fitted.parameters), fitted.z, strict=True))
    spread = float(np.linalg.norm([z[a.name] for a in c.amplitudes])) / np.sqrt(max(deviance, 1e-12))
    return {**intervals} | {
        a.name: _interval(a, intervals[a.name].value, min(a.sd * spread, intervals[a.name].sd)) for a in c.amplitudes
    }


def _interval(n: Parameter, value: float, spread: float) -> Estimate:
    low, high = max(n.low, value - NINETY_PERCENT * spread), min(n.high, value + NINETY_PERCENT * spread)
    return Estimate(value, spread, low, high)


def superfluous(candidate: Candidate, intervals: Mapping[str, Estimate]) -> bool:
    """Tell whether the intervals of an effect include no effect at all."""
    if candidate.switch:
        return False
    return all(intervals[a.name].low <= a.start <= intervals[a.name].high for a in candidate.amplitudes)
