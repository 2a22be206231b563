"""The next experiment: the safe move, and its position, that separates competing hypotheses best per second.

Every move of a small library is G-code within the machine's limits, planned as the firmware plans it, and simulated on
the virtual printer once for each hypothesis. Two hypotheses are separated by the whitened difference d of the simulated
sensor signals: |d| standard deviations of the noise. Noise adds up as the square root of time, so moves of different
length are compared by |d|/√s. Both hypotheses are taken as they were fitted: the next fit may retune part of the
difference away, so the values are upper bounds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ffcomp.diagnosis.diagnosis import Diagnosis
from ffcomp.diagnosis.noise import whitener
from ffcomp.diagnosis.printer_problem import PrinterProblem
from ffcomp.diagnosis.problem import InfeasibleParameters
from ffcomp.diagnosis.score_test import Screened, confounded_with, separated_by
from ffcomp.diagnosis.settings import SETTINGS
from ffcomp.measurement.recording import Recording
from ffcomp.planner.program import plan_program
from gcode.reader import read_program
from models.arrays import FloatArray
from models.effects.catalogue import CATALOGUE
from models.machine import Machine

LOW_MM = 30.0  # height
BEFORE_S, AFTER_S = 0.12, 0.3  # of rest in the recording: the printer rings for 0.2 s

Point = tuple[float, float, float]
Lines = Iterator[str]


@dataclass(frozen=True)
class Proposal:
    """One move that is worth making next."""

    kind: str  # in plain words
    position_mm: Point
    seconds: float
    competing: tuple[str, ...]  # the effects it separates from the best hypothesis; or shows, where there is none
    sigmas_per_second: float  # standard deviations of the noise after one second; they grow as √seconds
    text: str  # one sentence for the user
    gcode: str  # executes it once


@dataclass(frozen=True)
class Move:
    """One kind of motion, from rest to rest around a position."""

    kind: str
    acceleration: float  # mm/s²; the machine's own, where that is less
    lines: Callable[[Point], Lines]  # G-code, the nozzle resting at the position before and after


@dataclass(frozen=True, eq=False)
class _Question:
    """Two printers to be separated, as values of their parameters."""

    competing: tuple[str, ...]
    one: Mapping[str, float]
    other: Mapping[str, float]
    words: str  # the task of the move: tell a from b
    sentence: str  # how to tell them apart, if no move does


@dataclass(frozen=True, eq=False)
class _Trial:
    """A move at a position, and how well it answers a question."""

    move: Move
    position: Point
    seconds: float
    rate: float  # |d|/√s


def propose(problem: PrinterProblem, diagnosis: Diagnosis, count: int = 3) -> list[Proposal]:
    """Propose moves: for each competing hypothesis the best one, then the best other kinds for the nearest of them.

    With verdict `unknown` the two nearest hypotheses compete. With `none` the moves are those that would show the
    effects that these recordings could not show.
    """
    proposals: list[Proposal] = []
    spare: list[Proposal] = []
    for question in _questions(problem, diagnosis)[:count]:
        best, *others = _ranked(problem, diagnosis, question)
        proposals.append(_proposal(problem.machine, question, best))
        spare += [_proposal(problem.machine, question, other) for other in others if _tells(other)]
    return [*proposals, *spare][:count]


# ---- questions ----------------------------------------------------------------------------------


def _questions(problem: PrinterProblem, diagnosis: Diagnosis) -> list[_Question]:
    if diagnosis.best is None:
        unseen = sorted((s for s in diagnosis.screened if not s.visible), key=lambda s: -s.strength)
        return [_shown(diagnosis, s) for s in unseen[:3]]
    best = diagnosis.best
    others = [h for h in (*diagnosis.competing, *diagnosis.tried) if h.names != best.names]
    nearest = list({h.names: h for h in reversed(others)}.items())[::-1]
    questions = [_separation(diagnosis, names, h.fit.values) for names, h in nearest]
    confounded = {name for name, _ in confounded_with(best.names, diagnosis.screened)}
    known = {name for names, _ in nearest for name in names}
    questions += [
        _separation(diagnosis, (s.candidate.name,), linear_estimate(diagnosis, s))
        for s in _named(diagnosis, confounded - known)
    ]
    return questions[: 3 if diagnosis.named is not None else 2]


def _named(diagnosis: Diagnosis, names: set[str]) -> list[Screened]:
    return [s for s in diagnosis.screened if s.candidate.name in names]


def _separation(diagnosis: Diagnosis, other: tuple[str, ...], values: Mapping[str, float]) -> _Question:
    assert diagnosis.best is not None
    ours = diagnosis.best.names
    words = _difference([n for n in ours if n not in other], [n for n in other if n not in ours])
    return _Question(other, diagnosis.best.fit.values, values, words, separated_by(ours, other))


def _difference(ours: Sequence[str], theirs: Sequence[str]) -> str:
    """Name the effects that two hypotheses do not share, as a task."""
    a, b = " and ".join(ours), " and ".join(theirs)
    return f"tell {a} from {b}" if a and b else f"show whether {a or b} acts as well"


def _shown(diagnosis: Diagnosis, screened: Screened) -> _Question:
    """Ask for an effect of a usual size against none."""
    name = screened.candidate.name
    usual = {a.name: a.start + a.sd for a in screened.candidate.amplitudes}
    values = {**diagnosis.base.values, **screened.shape, **usual}
    in_data = CATALOGUE[name].in_data if name in CATALOGUE else ""
    return _Question((name,), diagnosis.base.values, values, f"would show {name} of a usual size", in_data)


def linear_estimate(diagnosis: Diagnosis, screened: Screened) -> dict[str, float]:
    """Estimate a confounded effect that was not fitted: as large as its signature says."""
    amplitudes = screened.candidate.amplitudes
    sizes = [
        float(np.clip(a.start + a.sd * x, a.low, a.high)) for a, x in zip(amplitudes, screened.estimate, strict=True)
    ]
    return {**diagnosis.base.values, **screened.shape, **dict(zip((a.name for a in amplitudes), sizes, strict=True))}


# ---- answers -------------------------------------------------------------------------------------


def _ranked(problem: PrinterProblem, diagnosis: Diagnosis, question: _Question) -> list[_Trial]:
    """Rank the best position of the best kind of move, then the other kinds at the centre, best first."""
    machine = problem.machine
    centre, *around = positions(machine)
    kinds = _trials(problem, diagnosis, question, [(move, centre) for move in library(machine)])
    best = max(kinds, key=lambda p: p.rate)
    tried = _trials(problem, diagnosis, question, [(best.move, position) for position in around])
    top = max([best, *tried], key=lambda p: p.rate)
    x, y, _ = top.position
    high = _trials(problem, diagnosis, question, [(best.move, (x, y, 0.5 * machine.kinematics.height_mm))])
    top = max([top, *high], key=lambda p: p.rate)
    return [top, *sorted((p for p in kinds if p.move is not best.move), key=lambda p: -p.rate)]


def _tells(trial: _Trial) -> bool:
    return trial.rate * np.sqrt(trial.seconds) > SETTINGS.visible_sd


def _trials(
    problem: PrinterProblem, diagnosis: Diagnosis, question: _Question, tries: Sequence[tuple[Move, Point]]
) -> list[_Trial]:
    """Simulate each move at its position on both printers."""
    observations = problem.observations
    signals, rate_hz = observations[0].signals, observations[0].rate_hz
    recordings = [_blank_recording(problem.machine, move, position, signals, rate_hz) for move, position in tries]
    virtual = PrinterProblem(problem.machine, recordings, ())
    whiten = whitener(virtual.observations, diagnosis.noise, virtual.band_hz)
    try:
        one, other = (virtual.simulate(values, coarse=True) for values in (question.one, question.other))
        apart = whiten([a - b for a, b in zip(one, other, strict=True)])
    except InfeasibleParameters:  # a printer that leaves the arms' reach there: nothing is learnt from it
        apart = np.zeros(whiten.rows[-1].stop)
    seconds = [float(recording.time_s[-1]) for recording in recordings]
    sizes = [float(np.linalg.norm(apart[rows])) for rows in whiten.rows]
    return [
        _Trial(move, position, s, size / float(np.sqrt(s)))
        for (move, position), s, size in zip(tries, seconds, sizes, strict=True)
    ]


def _blank_recording(
    machine: Machine, move: Move, position: Point, signals: Sequence[str], rate_hz: float
) -> Recording:
    """Make the move a recording that holds nothing yet."""
    text = _text(machine, move, position)
    trajectory = plan_program(read_program(text.encode(), move.kind), machine).trajectory
    begin = float(trajectory.start_t[0])
    return blank_recording(
        machine,
        move.kind,
        lambda t: np.ascontiguousarray(trajectory.position(t + begin)[:, :3]),
        trajectory.end_t - begin,
        signals,
        rate_hz,
    )


def blank_recording(
    machine: Machine,
    name: str,
    nozzle: Callable[[FloatArray], FloatArray],
    seconds: float,
    signals: Sequence[str],
    rate_hz: float,
) -> Recording:
    """Return the recording of a motion, nothing measured yet.

    Parameters
    ----------
    nozzle : (n,) s since the beginning -> (n, 3) mm, the commanded nozzle
    """
    t = np.arange(0.0, seconds + BEFORE_S + AFTER_S, 1 / rate_hz)
    blank: dict[str, dict[str, FloatArray]] = {"acc": {}, "pos": {}}
    for signal in signals:
        blank[signal[:3]][signal] = np.zeros(len(t))
    gaps = np.zeros(len(t), dtype=bool)
    carriages = machine.kinematics.inverse(nozzle(t - BEFORE_S))
    return Recording(name, t, carriages, "carriage", blank["acc"], blank["pos"], gaps, {})


def _proposal(machine: Machine, question: _Question, trial: _Trial) -> Proposal:
    x, y, z = trial.position
    sigmas = trial.rate * np.sqrt(trial.seconds)
    where = f"{trial.move.kind} at ({x:.0f}, {y:.0f}, {z:.0f}) mm"
    if _tells(trial):
        size = f"{sigmas:.0f}" if sigmas < 100 else "more than 100"
        text = f"{where}: {trial.seconds:.1f} s of them {question.words} with {size} standard deviations."
    else:
        text = (
            f"None of the safe moves would {question.words.removeprefix('would ')}: the best, {where.lower()}, "
            f"has less than {max(sigmas, 1.0):.1f} standard deviations. {question.sentence}".rstrip()
        )
    return Proposal(
        trial.move.kind,
        trial.position,
        trial.seconds,
        question.competing,
        trial.rate,
        text[0].upper() + text[1:],
        _text(machine, trial.move, trial.position),
    )


# ---- the moves -----------------------------------------------------------------------------------


def positions(machine: Machine) -> list[Point]:
    """Return the centre, then six positions around it; low."""
    around = machine.kinematics.around(0.6, margin_mm=12.0)
    return [(*machine.kinematics.centre_mm, LOW_MM), *((round(x, 1), round(y, 1), LOW_MM) for x, y in around.tolist())]


def library(machine: Machine) -> list[Move]:
    """Return moves that a printer makes anyway, none faster than its limits."""
    limit = machine.limits.acceleration_mm_per_s2
    return [
        Move("slow moves to and fro (8 mm/s)", min(600.0, limit), lambda p: _to_and_fro(p, 3.0, 8.0, 2)),
        Move("hard single moves, each rung out", min(8000.0, limit), lambda p: _singles(p, 9.0, 150.0)),
        Move("infill at 50 mm/s", min(3000.0, limit), lambda p: _zigzag(p, 50.0, 6)),
        Move("infill at 110 mm/s", min(5000.0, limit), lambda p: _zigzag(p, 110.0, 10)),
        Move("circles up and down", min(5000.0, limit), lambda p: _circles(p, 8.0, 80.0)),
        Move("ever shorter strokes", min(5000.0, limit), lambda p: _strokes(p, 100.0)),
    ]


def _text(machine: Machine, move: Move, position: Point) -> str:
    """Write the G-code of a move, with the travel to its position."""
    x, y, z = position
    travel = min(50.0, machine.limits.velocity_mm_per_s)
    return "\n".join(
        [
            f"; ffcomp: {move.kind} at ({x:.0f}, {y:.0f}, {z:.0f}) mm. Home first; no filament is used.",
            "; Record it twice: repeats tell the noise.",
            "G21",
            "G90",
            f"M204 S{move.acceleration:.0f}",
            _to(position, travel),
            "G4 P1000",
            *move.lines(position),
            "G4 P500",
            "",
        ]
    )


def _to(point: Sequence[float], speed: float) -> str:
    x, y, z = point
    return f"G1 X{x:.3f} Y{y:.3f} Z{z:.3f} F{60 * speed:.0f}"


def _beside(position: Point, *offset: float) -> Point:
    x, y, z = (float(a + b) for a, b in zip(position, offset, strict=True))
    return x, y, z


def _to_and_fro(position: Point, reach: float, speed: float, times: int) -> Lines:
    for _ in range(times):
        for offset in ((reach, 0.0, 0.0), (0.0, reach, 0.0)):
            yield _to(_beside(position, *offset), speed)
            yield _to(position, speed)


def _singles(position: Point, reach: float, speed: float) -> Lines:
    for offset in ((reach, 0.0, 0.0), (0.0, reach, 0.0), (-reach, -reach, 0.0), (0.0, 0.0, reach / 3)):
        yield _to(_beside(position, *offset), speed)
        yield "G4 P150"  # ms, until the nozzle rests
        yield _to(position, speed)
        yield "G4 P150"


def _zigzag(position: Point, speed: float, lines: int) -> Lines:
    """Draw lines of 16 mm, 0.8 mm apart, at 45 degrees."""
    half, beside = 5.66, 0.57
    for i in range(lines):
        side = half * (-1) ** i
        yield _to(_beside(position, side + beside * i, side - beside * i, 0.0), speed)
        yield _to(_beside(position, side + beside * (i + 1), side - beside * (i + 1), 0.0), speed)
    yield _to(position, speed)


def _circles(position: Point, radius: float, speed: float) -> Lines:
    """Draw one turn up, one turn down."""
    turn = np.linspace(0.0, 2 * np.pi, round(2 * np.pi * radius) + 1)[1:]
    for rise in (turn, turn[::-1]):
        for angle, height in zip(turn, rise, strict=True):
            offset = (radius * np.sin(angle), radius * (1 - np.cos(angle)), height)
            yield _to(_beside(position, *offset), speed)
    yield _to(position, speed)


def _strokes(position: Point, speed: float) -> Lines:
    """Shorten strokes from 6 mm to 0.15 mm, along x, then along y: the shorter, the higher the excited frequency."""
    for axis in np.eye(3)[:2]:
        for length in np.geomspace(6.0, 0.15, 24):
            yield _to(_beside(position, *(length * axis)), speed)
            yield _to(position, speed)
