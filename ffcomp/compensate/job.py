"""One file to be compensated: read, checked, written, reported. What the command line and integrations call."""

from __future__ import annotations

import pickle
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from functools import partial
from itertools import chain, islice
from math import ceil, inf
from os.path import realpath
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from ffcomp.compensate import chunks as cutting
from ffcomp.compensate.chunks import Chapter, chapters
from ffcomp.compensate.gcode_output.print_time import with_times_retold
from ffcomp.compensate.prediction import LONGEST_S, Prediction
from ffcomp.compensate.program import Summary, compensate
from ffcomp.compensate.solve import solutions
from ffcomp.compensate.step_output import Stepping
from ffcomp.errors import NothingToDo
from ffcomp.inverse.extent import WHOLE
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.settings import Settings, settings_for
from ffcomp.inverse.time_scaling import TimeScaling, scale_around_cut
from ffcomp.planner.limits import lines_of
from ffcomp.planner.machine_limits import planner_limits
from ffcomp.planner.path_position import PathPosition
from ffcomp.planner.program import PlannedProgram, firmware_plan, plan_program, plan_section
from ffcomp.planner.trajectory import Trajectory
from ffcomp.steps.sink import Board, MotorTotal, StepSink
from ffcomp.version import __version__
from gcode.atomic_write import replace_atomically
from gcode.container import Source, blocks_of, ends_of
from gcode.dialects import FLAVORS, flavor_by_ends, shaper_off
from gcode.embedded import OURS, joined, original_blocks
from gcode.errors import UnsupportedGcode
from gcode.layers import LayerLookup
from gcode.metadata import Timed
from gcode.program import Moves, Program
from gcode.reader import read_parts
from gcode.stamp import offset_line, stamp_line
from models.arrays import FloatArray
from models.machine import Machine

S_CURVE_LONGEST_S = 900.0  # of motion without a rest that is planned with S-curves

TOLD = 12  # places that were slowed down, of which each has its sentence

Progress = Callable[[float], None]  # called with the share that is done, 0 to 1
_Done = tuple[Iterator[bytes], int, Summary]  # a chapter's lines, its size in bytes, what was done


@dataclass(frozen=True, slots=True)
class Recipe:
    """All that is the same for every chapter of a file."""

    machine: Machine
    settings: Settings
    flavor: str
    offset: tuple[float, float]
    share: float  # of the print that is simulated for the prediction

    def begun(
        self, chapter: Chapter, inverter: InverseModel, summary: Summary
    ) -> tuple[PlannedProgram, FloatArray | None, Prediction | None]:
        """A chapter planned, the plant's state (18,) as it begins, and what collects the prediction."""
        machine, settings, offset = self.machine, self.settings, self.offset
        prediction = Prediction(inverter, self.share) if self._is_simulated(chapter) else None
        smooth = settings.s_curve and chapter.ends == WHOLE
        planned = plan_program(chapter.program, machine, offset, smooth)
        state = None
        if chapter.before is not None:
            past = plan_program(chapter.before, machine, offset, settings.s_curve)
            for known in solutions(past, machine, inverter, None, lambda wanted: False):
                state = known.result.state
        summary.warnings += chapter.program.warnings
        summary.slowed += chapter.eased
        summary.original_print_time_s -= sum(each.seconds for each in chapter.eased)
        if smooth < settings.s_curve and chapter.ends.begin is None:
            summary.warnings.append(_not_smooth(chapter))
        if chapter.ends.end is None:
            moves = len(chapter.program.moves)
            waits = sum(event.dwell_s for event in chapter.program.events if event.move == moves)
            summary.original_print_time_s += waits
            summary.print_time_s += waits
        summary.predicted = prediction.samples if prediction else None
        return planned, state, prediction

    def _is_simulated(self, chapter: Chapter) -> bool:
        """Whether some of it is. Of a motion in several chapters, only as many of them as are a share of it."""
        if chapter.ends == WHOLE:
            return self.share > 0.0
        return ceil(self.share * (chapter.cuts + 1)) > ceil(self.share * chapter.cuts)

    def lines(
        self, chapter: Chapter, inverter: InverseModel, summary: Summary, progress: Progress = lambda share: None
    ) -> Iterator[bytes]:
        """The compensated lines of a chapter. progress : called with the share of it that is done"""
        planned, state, prediction = self.begun(chapter, inverter, summary)
        yield from compensate(
            planned,
            self.machine,
            inverter,
            self.flavor,
            summary,
            lambda done_s: progress(done_s / max(planned.trajectory.end_t, done_s)),
            offset=self.offset,
            state=state,
            said=chapter.said,
            prediction=prediction,
            layers_before=chapter.layers,
            ends=chapter.ends,
        )


_own = threading.local()


def inverter_of(machine: Machine, settings: Settings) -> InverseModel:
    """A thread's inverter, the same one from chapter to chapter and from file to file."""
    key = pickle.dumps((machine, settings))
    if getattr(_own, "key", None) != key:
        _own.inverter, _own.key = InverseModel(machine, settings), key
    inverter: InverseModel = _own.inverter
    return inverter


def _work(chapter: Chapter, recipe: Recipe) -> tuple[list[bytes], Summary]:
    """A chapter in a process of its own."""
    inverter, summary = inverter_of(recipe.machine, recipe.settings), Summary()
    done = list(joined(recipe.lines(chapter, inverter, summary))), summary
    inverter.save_cache()
    return done


class Job:
    """A G-code file and the machine it is for. The file is read while it is written, chapter by chapter."""

    def __init__(
        self,
        source: Source,
        path: str,
        machine: Machine,
        *,
        offset: tuple[float, float] = (0.0, 0.0),
        flavor: str = "",
        predict: bool = True,
        settings: Settings | None = None,
        shaper_off: bool = False,
        inverter: InverseModel | None = None,
        restore: bool = False,
        jobs: int = 1,
    ) -> None:
        """`restore`: the file is a compensated one, and what is compensated is the original that it keeps."""
        self.started = time.perf_counter()
        self.source, self.path, self.machine, self.offset = source, path, machine, offset
        self.restore, self.jobs, self.predict, self.shaper_off = restore, jobs, predict, shaper_off
        head, tail, self.size = ends_of(source)
        self.flavor = flavor or flavor_by_ends(head, tail)
        if self.flavor not in FLAVORS:
            raise UnsupportedGcode(f"The flavor {flavor!r} is none of {', '.join(sorted(FLAVORS))}.", path=path)
        self.settings = settings or settings_for(machine)
        self.inverter = inverter or InverseModel(machine, self.settings)
        self.summary = Summary(warnings=_not_modelled(self.inverter))
        self.compute_time_s = 0.0

    def write(self, target: Path | None, progress: Progress = lambda share: None) -> None:
        """Compensate into `target` (None: nowhere), which is replaced whole at the end or not at all.

        progress : called with the share of the file that is done, 0 to 1
        """
        lines = self.lines(progress, None if target is None else Path(realpath(target)).parent)
        if target is None:
            for _ in lines:
                pass
        else:
            replace_atomically(target, lines)

    def write_steps(
        self,
        target: Path | None,
        board: Board,
        error_s: float | None = None,
        plain: bool = False,
        progress: Progress = lambda share: None,
    ) -> dict[str, MotorTotal]:
        """The commands as step timings in an archive (None: nowhere), replaced whole at the end or not at all.

        Parameters
        ----------
        error_s : by which a compressed step may be early or late; None: every step, exactly
        plain : the plan as it is, uncompensated

        Returns
        -------
        what became of each motor's steps, by its letter
        """
        together, recipe = self._started(plain)
        with TemporaryDirectory() if target is None else nullcontext("") as folder:
            totals = self._stepped(
                together, recipe, target or Path(folder, "steps.npz"), board, error_s, plain, progress
            )
        self.inverter.save_cache()
        self.compute_time_s = time.perf_counter() - self.started
        return totals

    def _stepped(
        self,
        together: Iterator[Chapter],
        recipe: Recipe,
        target: Path,
        board: Board,
        error_s: float | None,
        plain: bool,
        progress: Progress,
    ) -> dict[str, MotorTotal]:
        done = 0
        with StepSink(self.machine, board, target, error_s) as sink:
            stepping = Stepping(sink)
            for chapter in together:
                summary = Summary()
                planned, state, prediction = recipe.begun(chapter, self.inverter, summary)
                if plain:
                    stepping.plain(planned, summary)
                else:
                    stepping.compensated(
                        planned,
                        self.machine,
                        self.inverter,
                        summary,
                        state,
                        prediction,
                        chapter.layers,
                        chapter.ends,
                    )
                self._take(summary)
                done += _size(chapter.program)
                progress(min(done / max(self.size, 1), 1.0))
            return sink.finish()

    def lines(self, progress: Progress = lambda share: None, folder: Path | None = None) -> Iterator[bytes]:
        """The compensated file, stamped in head and tail, in pieces of whole lines.

        folder : where what comes after a line that tells the whole print's time may wait for it
        """
        stamp = stamp_line(__version__, self.machine.name, self.machine.sha256, self.flavor)
        body = with_times_retold(self._body(progress), lambda: self.summary.print_time_s, folder)
        if self.shaper_off:
            body = _with_shaper_off(body, self.flavor)
        yield from _stamped(body, stamp, offset_line(self.offset))
        self.inverter.save_cache()
        self.compute_time_s = time.perf_counter() - self.started

    def _parts(self) -> Iterator[Program]:
        blocks = blocks_of(self.source)
        if self.restore:
            blocks = original_blocks(blocks)
        return read_parts(blocks, self.path, flavor=self.flavor, offset_mm=self.offset)

    def _chapters(self, parts: Iterable[Program], plain: bool) -> Iterator[Chapter]:
        # plain steps are written from rest to rest, and an S-curve has one level of acceleration
        longest_s = inf if plain else S_CURVE_LONGEST_S if self.settings.s_curve else cutting.LONGEST_S
        ease = self._eased if self.settings.slow_down and not plain else None
        s = self.settings
        return chapters(parts, s.segment_s, s.lead_s, self._plan_of, longest_s=longest_s, ease=ease)

    def _plan_of(self, program: Program) -> Trajectory:
        return firmware_plan(program, self.machine, self.offset)

    def _eased(self, around: Program, cut: PathPosition, layers: int) -> tuple[Moves, tuple[TimeScaling, ...]]:
        limits, layer_of = planner_limits(self.machine), LayerLookup(around, layers).of
        return scale_around_cut(self.inverter, around, limits, cut, partial(plan_section, limits), layer_of)

    def _started(self, plain: bool = False) -> tuple[Iterator[Chapter], Recipe]:
        parts = self._parts()
        first = list(islice(parts, 1))
        if not first:
            raise NothingToDo(f"{self.path or 'The file'} holds no line: nothing to compensate.")
        while not len(first[-1].moves) and (more := next(parts, None)) is not None:
            first.append(more)
        share = _share(first[-1], self.size) if self.predict else 0.0
        recipe = Recipe(self.machine, self.settings, self.flavor, self.offset, share)
        return self._chapters(chain(first, parts), plain), recipe

    def _body(self, progress: Progress) -> Iterator[bytes]:
        together, recipe = self._started()
        done = 0
        for lines, size, summary in (
            self._one_by_one(together, recipe, progress) if self.jobs == 1 else self._side_by_side(together, recipe)
        ):
            begun_s = self.summary.print_time_s
            yield from (Timed.at(line, begun_s + line.at_s) if isinstance(line, Timed) else line for line in lines)
            self._take(summary)
            done += size
            progress(min(done / max(self.size, 1), 1.0))

    def _one_by_one(self, together: Iterator[Chapter], recipe: Recipe, progress: Progress) -> Iterator[_Done]:
        before = 0
        for chapter in together:
            summary, size = Summary(), _size(chapter.program)

            def within(share: float, before: int = before, size: int = size) -> None:
                progress(min((before + share * size) / max(self.size, 1), 1.0))

            yield recipe.lines(chapter, self.inverter, summary, within), size, summary
            before += size

    def _side_by_side(self, together: Iterator[Chapter], recipe: Recipe) -> Iterator[_Done]:
        from joblib import Parallel, delayed

        sizes: deque[int] = deque()

        def tasks() -> Iterator[Any]:
            for chapter in together:
                sizes.append(_size(chapter.program))
                yield delayed(_work)(chapter, recipe)

        pool = Parallel(n_jobs=self.jobs, return_as="generator", batch_size=1, pre_dispatch="2 * n_jobs")
        for text, summary in pool(tasks()):
            yield iter(text), sizes.popleft(), summary

    def add(self, other: Job) -> None:
        """Count what another job has done as done by this one."""
        self._take(other.summary)
        self.compute_time_s += other.compute_time_s

    def _take(self, chapter: Summary) -> None:
        """Add up what was done."""
        mine = self.summary
        for name in ("moves", "segments", "windows", "limited_windows", "original_print_time_s", "print_time_s"):
            setattr(mine, name, getattr(mine, name) + getattr(chapter, name))
        mine.warnings += [each for each in chapter.warnings if each not in mine.warnings]
        mine.slowed += chapter.slowed
        if mine.predicted is None:
            mine.predicted = chapter.predicted
        elif chapter.predicted is not None:
            mine.predicted.join(chapter.predicted)

    @property
    def warnings(self) -> list[str]:
        """All there is to say, in sentences."""
        slowed = self.summary.slowed
        told = [each.sentence() for each in slowed[:TOLD]]
        if len(slowed) > TOLD:
            more = sum(each.seconds for each in slowed[TOLD:])
            told.append(
                f"{len(slowed) - TOLD} more places were slowed down in the same way, {more:.2g} s longer in all."
            )
        return [*self.summary.warnings, *told]

    def result(self) -> dict[str, Any]:
        """The JSON object of `compensate`."""
        summary = self.summary
        tracks = summary.predicted.tracks() if summary.predicted else {}
        return {
            "schema": "ffcomp-compensate/1",
            "input": self.path,
            "machine": {"name": self.machine.name, "sha256": self.machine.sha256},
            "flavor": self.flavor,
            "print_time_s": summary.print_time_s,
            "original_print_time_s": summary.original_print_time_s,
            "compute_time_s": self.compute_time_s,
            "moves": summary.moves,
            "segments": summary.segments,
            "windows": summary.windows,
            "limited_windows": summary.limited_windows,
            "warnings": self.warnings,
            "slowed": [asdict(each) for each in summary.slowed],
            "predicted": {name: asdict(track) for name, track in tracks.items()},
            "predicted_over_s": summary.predicted.covered_s if summary.predicted else 0.0,
        }


def _not_smooth(chapter: Chapter) -> str:
    line = chapter.program.first_line + int(chapter.program.moves.line[0]) + 1
    longest = f"{S_CURVE_LONGEST_S / 60:g} minutes"
    return f"line {line}: the motion that begins here does not rest for {longest}; it is planned without S-curves."


def _size(program: Program) -> int:
    return sum(map(len, program.lines))


def _share(first: Program, size: int) -> float:
    """How much of the print may be simulated, by what its first moves take at least."""
    moves = first.moves
    quickest = float((lines_of(moves).length / moves.speed).sum()) * size / max(_size(first), 1)
    return min(1.0, LONGEST_S / max(quickest, 1e-9))


def _not_modelled(inverter: InverseModel) -> list[str]:
    """A sentence, if the machine file lists effects that the command does not allow for."""
    names = ", ".join(inverter.not_modelled)
    return [f"The machine file lists effects that are not compensated: {names}."] if names else []


def _with_shaper_off(pieces: Iterator[bytes], flavor: str) -> Iterator[bytes]:
    """The firmware's own shaper is switched off where our first block opens."""
    waiting = True
    for piece in pieces:
        at = piece.find(OURS) if waiting else -1
        if at >= 0:
            waiting = False
            begin = piece.rfind(b"\n", 0, at) + 1
            ending = b"\r\n" if piece[: piece.find(b"\n", at) + 1].endswith(b"\r\n") else b"\n"
            yield piece[:begin]
            yield from (off.rstrip(b"\n") + OURS + ending for off in shaper_off(flavor))
            piece = piece[begin:]
        yield piece


def _stamped(pieces: Iterator[bytes], stamp: bytes, offset: bytes) -> Iterator[bytes]:
    """The stamp after the first line (slicers are known by it) and at the end, before a last line without newline."""
    kept = next(pieces, b"")
    begin = kept.find(b"\n") + 1
    if b"\r" in kept[:begin].removesuffix(b"\r\n"):
        begin = 0  # lines that end in other ways: the stamp comes first of all
    ending = b"\r\n" if kept[:begin].endswith(b"\r\n") else b"\n"
    stamp = stamp.rstrip(b"\n") + ending
    yield kept[:begin] + stamp + offset.replace(b"\n", ending)
    kept = kept[begin:]
    for piece in filter(None, pieces):
        yield kept
        kept = piece
    end = kept.rfind(b"\n") + 1
    yield kept[:end] + stamp
    yield kept[end:]
