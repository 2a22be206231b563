"""Where the time goes: every stage of a job, and how far its kernels are from what the processor can do."""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = "1"  # one core: said before numpy and scipy start their threads
os.environ["OPENBLAS_NUM_THREADS"] = "1"

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

import numpy as np
from numba import njit
from numpy.typing import NDArray

from benchmarks.performance_ways import MACHINE, PRINTS, ROOT
from ffcomp.compensation.file import compensate_file
from ffcomp.compensation.job import Options
from ffcomp.compensation.statistics import Statistics
from ffcomp.inverse import time_scaling
from ffcomp.inverse.riccati import AXES, augmented
from ffcomp.inverse.solve import Solution, solve
from models.file import load_machine
from models.vibration.delta import STATES
from models.vibration.recursion import recursion
from models.vibration.scheduled import SAME_MM

FloatArray = NDArray[np.float64]

ONCE = "bandwidth, plant over the bed"

# stage → where the names are looked up that belong to it; what is called inside of them counts to its own stage
STAGES = {
    "read": ("ffcomp.compensation.job.split_chunks", "ffcomp.compensation.job.read_as_planned"),
    "plan": ("ffcomp.compensation.plan.plan_program",),
    ONCE: ("ffcomp.compensation.job.settings_for", "ffcomp.compensation.job.InverseModel"),
    "invert: gains": ("ffcomp.inverse.riccati.PreviewGains.at", "ffcomp.inverse.riccati.PreviewGains.end"),
    "invert: sweeps": ("ffcomp.inverse.lq_preview.sweep_back", "ffcomp.inverse.lq_preview.sweep_forward"),
    "invert: simulation": ("models.vibration.scheduled.simulate",),
    "invert: as the firmware plays it": ("ffcomp.inverse.model.sample_even_segments",),
    "invert: wanted path": (
        "ffcomp.inverse.reference.Reference.substeps",
        "ffcomp.inverse.reference.Reference.extrusion",
    ),
    "invert: kinematics": (
        "models.kinematics.delta_kernels.FastDelta.inverse",
        "models.kinematics.delta_kernels.FastDelta.forward",
        "models.kinematics.delta_kernels.FastDelta.rate_term",
    ),
    "invert: all between": (
        "ffcomp.compensation.solve.solve_feasible",
        "ffcomp.compensation.solve.solve",
        "ffcomp.inverse.time_scaling.solve",
        "ffcomp.inverse.model.InverseModel.state_after_rest",
    ),
    "write": (
        "ffcomp.compensation.gcode_writer.timeline",
        "ffcomp.compensation.gcode_writer.tiles",
        "ffcomp.compensation.gcode_writer.Writer.section",
        "ffcomp.compensation.gcode_writer.Writer.event",
        "ffcomp.compensation.gcode_writer.Writer.extrude",
        "ffcomp.compensation.gcode_writer.Writer.close",
    ),
}
REST = "all else"
KERNELS = {
    "sweep_back": "ffcomp.inverse.lq_preview.sweep_back",
    "sweep_forward": "ffcomp.inverse.lq_preview.sweep_forward",
    "simulate": "models.vibration.scheduled.simulate",
}
PRECISION = {"sweep_back": "single", "sweep_forward": "single", "simulate": "double"}
KEPT_CALLS = 40
AUGMENTED = augmented(STATES)  # of a delta
BEHIND_DRIVES = STATES - 6  # states that depend on place
COLUMNS = BEHIND_DRIVES + 6 + 3 * AXES  # of the model's matrix: those states, the drives, u(t), u(t + h), J̇ q̇


# ---- stages --------------------------------------------------------------------------------------


@dataclass
class Stopwatch:
    """CPU time by stage; a stage that another one calls stops the other's watch."""

    clock: Callable[[], float] = time.process_time
    seconds: dict[str, float] = field(default_factory=dict)
    _open: list[str] = field(default_factory=lambda: [REST])

    def __post_init__(self) -> None:
        self._since = self.clock()

    def switch(self) -> None:
        """Book what has passed to the stage that runs."""
        now = self.clock()
        stage = self._open[-1]
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self._since
        self._since = now

    @contextmanager
    def running(self, stage: str) -> Iterator[None]:
        self.switch()
        self._open.append(stage)
        try:
            yield
        finally:
            self.switch()
            self._open.pop()

    def timed(self, stage: str, work: Callable[..., Any]) -> Callable[..., Any]:
        """The same function, or generator, with its time booked."""

        def call(*inputs: Any, **named: Any) -> Any:
            with self.running(stage):
                answer = work(*inputs, **named)
            return self._pieces(stage, answer) if hasattr(answer, "__next__") else answer

        return call

    def _pieces(self, stage: str, answer: Iterator[Any]) -> Iterator[Any]:
        while True:
            with self.running(stage):
                try:
                    piece = next(answer)
                except StopIteration:
                    return
            yield piece


def named(path: str) -> tuple[Any, str]:
    """The object that a dotted path's last name is looked up in, and that name."""
    import importlib

    parts = path.split(".")
    for split in range(len(parts) - 1, 0, -1):
        try:
            owner = importlib.import_module(".".join(parts[:split]))
        except ModuleNotFoundError:
            continue
        for name in parts[split:-1]:
            owner = getattr(owner, name)
        return owner, parts[-1]
    raise ModuleNotFoundError(path)


def stages_of(name: str, rounds: int) -> dict[str, Any]:
    """CPU time of each stage of a job, s: of the round that took the least, and what the same job takes unwatched."""
    found = []
    for _ in range(rounds):
        watch = Stopwatch()
        with ExitStack() as stack:
            for stage, paths in STAGES.items():
                for path in paths:
                    owner, last = named(path)
                    stack.enter_context(patch.object(owner, last, watch.timed(stage, getattr(owner, last))))
            done = compensated(name)
            watch.switch()
        found.append(watch.seconds)
    alone = []
    for _ in range(rounds):
        began = time.process_time()
        compensated(name)
        alone.append(time.process_time() - began)
    best = min(found, key=lambda each: sum(each.values()))
    print_s, segments = done.original_print_time_s, done.segments
    return {"seconds": best, "unwatched_s": min(alone), "print_s": print_s, "segments": segments}


def compensated(name: str) -> Statistics:
    path = ROOT / "sample_prints" / f"{name}.gcode"
    with TemporaryDirectory() as folder:
        target = Path(folder, "out.gcode")
        done = compensate_file(path, path.name, load_machine(MACHINE), Options(predict=False), target)
        return done.result.statistics


# ---- kernels -------------------------------------------------------------------------------------


def recorded(name: str) -> tuple[dict[str, list[tuple[Any, ...]]], int]:
    """What the kernels are called with in a job, and how many knots its commands have."""
    calls: dict[str, list[tuple[Any, ...]]] = {kernel: [] for kernel in KERNELS}

    def watched(kernel: str, work: Callable[..., Any]) -> Callable[..., Any]:
        def call(*inputs: Any) -> Any:
            calls[kernel].append(tuple(np.copy(x) if isinstance(x, np.ndarray) else x for x in inputs))
            return work(*inputs)

        return call

    kept = []

    def counted(*inputs: Any, **named: Any) -> Solution:
        answer = solve(*inputs, **named)
        kept.append(len(answer.vertices) - 1)
        return answer

    with ExitStack() as stack:
        for kernel, path in KERNELS.items():
            owner, last = named(path)
            stack.enter_context(patch.object(owner, last, watched(kernel, getattr(owner, last))))
        stack.enter_context(patch.object(time_scaling, "solve", counted))
        part_of(name)
    return calls, sum(kept)


def part_of(name: str) -> None:
    """The beginning of a print, compensated."""
    path = ROOT / "sample_prints" / f"{name}.gcode"
    lines = path.read_bytes().splitlines(keepends=True)
    part = b"".join(lines[: len(lines) // 4])
    compensate_file(part, path.name, load_machine(MACHINE), Options(predict=False), None)


def knots_of(kernel: str, inputs: tuple[Any, ...]) -> int:
    """How many intervals a call goes through."""
    return len(inputs[2]) if kernel != "simulate" else len(inputs[5])


def operations(kernel: str, inputs: tuple[Any, ...]) -> float:
    """Floating-point operations of a call, by the bounds of its loops."""
    knots = knots_of(kernel, inputs)
    if kernel != "simulate":
        return float(knots * per_knot()[kernel])
    substeps = inputs[6]
    return float(knots * substeps * per_knot()["simulate, a step"] + lookups(inputs[5]) * per_knot()["a model"])


def per_knot() -> dict[str, int]:
    """A multiplication and an addition for each entry of a matrix; a model is four matrices with four weights."""
    drive = AXES * (8 + 6)  # two states of a drive: four products each, three sums
    return {
        "sweep_back": 2 * (AUGMENTED + 9) * (AUGMENTED + AXES),  # what is filled up to a vector's length does not count
        "sweep_forward": 2 * (AUGMENTED + AXES) * AUGMENTED,
        "simulate, a step": 2 * BEHIND_DRIVES * COLUMNS + drive + 2 * AXES,
        "a model": (4 + 3) * BEHIND_DRIVES * COLUMNS,
    }


def lookups(place: FloatArray) -> int:
    """How often `simulate` interpolates a model anew along places (n, 2) mm."""
    found, at = 0, np.full(2, np.inf)
    for here in place:
        if not np.all(np.abs(here - at) < SAME_MM):
            at, found = here, found + 1
    return found


def kernel_speeds(name: str, rounds: int) -> dict[str, Any]:
    """Every kernel by itself with what it is called with in a print: knots, operations and CPU time of these calls."""
    calls, kept = recorded(name)
    found = {}
    for kernel, path in KERNELS.items():
        owner, last = named(path)
        work, chosen = getattr(owner, last), calls[kernel][:: max(1, len(calls[kernel]) // KEPT_CALLS)]
        cpu_s = min(_timed(work, chosen) for _ in range(rounds))
        knots = sum(knots_of(kernel, inputs) for inputs in chosen)
        count = sum(operations(kernel, inputs) for inputs in chosen)
        found[kernel] = {
            "passes": sum(knots_of(kernel, inputs) for inputs in calls[kernel]) / kept,
            "ns_per_knot": 1e9 * cpu_s / knots,
            "operations_per_knot": count / knots,
            "gflops": count / cpu_s / 1e9,
            "precision": PRECISION[kernel],
        }
    return found


def _timed(work: Callable[..., Any], calls: list[tuple[Any, ...]]) -> float:
    began = time.process_time()
    for inputs in calls:
        work(*inputs)
    return time.process_time() - began


# ---- what the processor can do -------------------------------------------------------------------


@njit(cache=True)
def _chain(steps: int, x: float, a: float, b: float) -> float:
    for _ in range(steps):
        x = x * a + b
    return x


_step = recursion(rows=AUGMENTED, of_state=AUGMENTED, of_input=1)


@njit(cache=True)
def _recursion(gain: NDArray[Any], z: NDArray[Any], steps: int) -> None:
    """z ← Gᵀ (z, 1) with one matrix that stays in the nearest cache: the best that our kernels could do."""
    given = np.ones((1, 1), z.dtype)
    for _ in range(steps):
        _step(gain, 0, z, given, 0)


def _recursed(gain: NDArray[Any], steps: int) -> None:
    _recursion(gain, np.ones(AUGMENTED, gain.dtype), steps)


def peaks(rounds: int) -> dict[str, float]:
    """GFLOP/s of this core: a product of large matrices; a large matrix times a vector, from the second cache and from
    memory; and a recursion of small products like our kernels, always with the same matrix."""
    rng = np.random.default_rng(1)
    large, near, far = rng.normal(size=(768, 768)), rng.normal(size=(256, 256)), rng.normal(size=(6000, 6000))
    gain, steps = 0.1 * rng.normal(size=(1, AUGMENTED + 1, AUGMENTED)), 100_000
    works: dict[str, tuple[Callable[[], object], float]] = {
        "gemv near": (lambda: [near @ near[0] for _ in range(200)], 200 * 2.0 * 256**2),
        "gemv far": (lambda: far @ far[0], 2.0 * 6000**2),
        "chain": (lambda: _chain(10 * steps, 1.0, 0.999, 1e-3), 20.0 * steps),
    }
    for name, kind in (("double", np.float64), ("single", np.float32)):
        whole, small = large.astype(kind), gain.astype(kind)
        count = 2.0 * (AUGMENTED + 1) * AUGMENTED
        works[f"gemm {name}"] = (partial(np.matmul, whole, whole), 2.0 * 768**3)
        works[f"recursion {name}"] = (partial(_recursed, small, steps), steps * count)
    found = {}
    for name, (work, count) in works.items():
        work()
        found[name] = count / min(_once(work) for _ in range(rounds)) / 1e9
    return found


def _once(work: Callable[[], object]) -> float:
    began = time.process_time()
    work()
    return time.process_time() - began


def where(rounds: int) -> dict[str, Any]:
    """All of it."""
    compensated(PRINTS[0])  # loads the compiled code
    return {
        "stages": {name: stages_of(name, rounds) for name in PRINTS},
        "kernels": {name: kernel_speeds(name, 3 * rounds) for name in PRINTS},
        "counts": per_knot(),
        "peaks": peaks(5 * rounds),
    }
