"""The diagnosis of a printer: commands in, accelerations or positions of carriages and effector out."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from dataclasses import replace
from functools import lru_cache
from itertools import chain, groupby, product

import numpy as np

from ffcomp.diagnosis.candidates import EFFECT_KEY, IN_FILE, machine_parameters, machine_with, printer_candidates
from ffcomp.diagnosis.noise import BAND_HZ
from ffcomp.diagnosis.observations import (
    Part,
    carriages_of,
    compared,
    every_row,
    excerpt_parts,
    first_seconds,
    informative_recordings,
    led_in,
    observation_of,
    parts_of,
)
from ffcomp.diagnosis.problem import InfeasibleParameters, Problem
from ffcomp.diagnosis.recording_clocks import (
    aligned,
    as_recorded,
    belongs_to_recording,
    delay_parameters,
    repeats_of,
    seen_parameters,
    with_stated_clock,
)
from ffcomp.measurement.recording import Recording
from models.arrays import FloatArray
from models.effects.catalogue import CATALOGUE, measured
from models.machine import Machine, value_of
from models.printer.kernels.record import LANES
from models.printer.parameters import ConvertedPrinter, converted_printer
from models.printer.printer import SMOOTH_STEP_S, PrinterMotion, Splines, longest_step, simulate_printers

STEP_S = 1 / 3200  # of a printer without dry friction or backlash: some nanometres off
COARSE_STEP_S, COARSE_KINKED_STEP_S = 1 / 1600, 1 / 3200  # where effects are only ranked
KEPT, AT_ONCE = 4, 24  # machines whose motions are held
WORKERS = min(8, os.cpu_count() or 1)

_Key = tuple[tuple[tuple[str, float], ...], tuple[int, ...], bool]
_Motions = dict[int, PrinterMotion]
_Task = tuple[tuple[float, int], int, int, int]  # row, s, and steps in each; rows; indices of machine and recording


class PrinterProblem(Problem):
    """A machine file and its recordings."""

    band_hz = BAND_HZ

    def __init__(
        self, machine: Machine, recordings: Sequence[Recording], names: Sequence[str] = tuple(CATALOGUE)
    ) -> None:
        self.machine = machine
        self.commands = [compared(carriages_of(machine, one), every_row(one)) for one in recordings]
        recorded = [observation_of(machine, one, c) for one, c in zip(recordings, self.commands, strict=True)]
        self.repeats = repeats_of(recorded)
        self.observations = aligned(recorded, self.repeats)
        self.parameters = (*machine_parameters(machine), *delay_parameters(recordings, recorded, self.repeats))
        possible = printer_candidates(machine, self.commands, names)
        self.candidates = tuple(with_stated_clock(each, recordings) for each in possible)
        self.motions = [
            next(k for k in range(i + 1) if np.array_equal(self.commands[k], command))
            for i, command in enumerate(self.commands)
        ]
        self.kept: dict[_Key, _Motions | InfeasibleParameters] = {}
        self.parts: Sequence[Part] = [Part(0, len(command), 0) for command in self.commands]
        self.splines = Splines()

    def only(self, chosen: Sequence[int]) -> PrinterProblem:
        """Return the problem with some of its observations, see `Problem.only`."""
        return self._of(chosen, [self.parts[i] for i in chosen])

    def excerpt(self) -> PrinterProblem | None:
        """Return the problem on the most informative part of each recording; None where that is hardly quicker."""
        chosen = informative_recordings(self.observations, self.motions)
        same = [chosen.index(self.motions[i]) for i in chosen]
        parts = excerpt_parts([self.observations[i] for i in chosen], same)
        return None if parts is None else self._of(chosen, parts)

    def begun(self, seconds: float) -> PrinterProblem:
        """Return the problem on so much of each recording from where it begins to move."""
        parts = [
            first_seconds(o, command, seconds) for o, command in zip(self.observations, self.commands, strict=True)
        ]
        return self._of(range(len(parts)), parts)

    def _of(self, chosen: Sequence[int], parts: Sequence[Part]) -> PrinterProblem:
        """Return the problem on parts of some recordings."""
        shorter = copy(self)
        whole = [self.observations[i] for i in chosen]
        shorter.motions = [chosen.index(self.motions[i]) for i in chosen]
        shorter.parameters = seen_parameters(self.parameters, whole)
        shorter.kept, shorter.parts, shorter.splines = {}, parts, Splines()
        led = {i: led_in(self.commands[chosen[i]], parts[i], whole[i].rate_hz) for i in set(shorter.motions)}
        shorter.commands = [led[i] for i in shorter.motions]
        shorter.observations = [part.of(o) for part, o in zip(parts, whole, strict=True)]
        return shorter

    def simulate(
        self, values: Mapping[str, float], only: Sequence[int] | None = None, *, coarse: bool = False
    ) -> list[FloatArray]:
        """Simulate the recordings: (n, m) each."""
        simulated = next(iter(self.simulate_many([values], only, coarse=coarse)))
        if isinstance(simulated, InfeasibleParameters):
            raise simulated
        return simulated

    def simulate_many(
        self, many: Sequence[Mapping[str, float]], only: Sequence[int] | None = None, *, coarse: bool = False
    ) -> Iterator[list[FloatArray] | InfeasibleParameters]:
        """Simulate in batches, all recordings of a batch together."""
        chosen = range(len(self.observations)) if only is None else only
        needed = sorted({self.motions[i] for i in chosen})
        for first in range(0, len(many), AT_ONCE):
            part = many[first : first + AT_ONCE]
            for values, motions in zip(part, self._motions(part, needed, coarse), strict=True):
                yield motions if isinstance(motions, InfeasibleParameters) else self._answer(values, motions, chosen)

    def _answer(
        self, values: Mapping[str, float], motions: Mapping[int, PrinterMotion], chosen: Sequence[int]
    ) -> list[FloatArray]:
        in_file = any(CATALOGUE[name].kind == "sensor" for name in self.machine.effects)
        machine = self.machine_with(values) if in_file or any(map(_is_sensor, values)) else None
        signals, answer = dict[tuple[object, ...], FloatArray](), list[FloatArray]()
        for i in chosen:
            o = self.observations[i]
            kind = self.motions[i], o.repeat_of, o.signals, o.clocks
            if kind not in signals:  # repeats have the same array, which the whitener transforms once
                sensed = _signals(machine, motions[self.motions[i]], o.signals, self.parts[i])
                signals[kind] = as_recorded(values, o, sensed)
            answer.append(signals[kind])
        return answer

    def _motions(
        self, many: Sequence[Mapping[str, float]], needed: Sequence[int], coarse: bool
    ) -> list[_Motions | InfeasibleParameters]:
        """Simulate motions by index of the recording; the last few are kept, for sensor effects need no new motion."""
        plain = [
            {name: x for name, x in values.items() if not (_is_sensor(name) or belongs_to_recording(name))}
            for values in many
        ]
        keys = [(tuple(sorted(values.items())), tuple(needed), coarse) for values in plain]
        new = {key: values for key, values in zip(keys, plain, strict=True) if key not in self.kept}
        known = self.kept | dict(zip(new, self._simulated(list(new.values()), needed, coarse), strict=True))
        feasible = [each for each in known.items() if not isinstance(each[1], InfeasibleParameters)]
        self.kept = dict(feasible[-KEPT:])
        return [known[key] for key in keys]

    def _simulated(
        self, many: Sequence[Mapping[str, float]], needed: Sequence[int], coarse: bool
    ) -> list[_Motions | InfeasibleParameters]:
        """Simulate on every core, in SIMD lanes what takes equal steps; one infeasible recording makes all so."""
        motions: list[_Motions | InfeasibleParameters] = [{} for _ in many]
        printers = dict[int, ConvertedPrinter]()
        for n, machine in enumerate(map(self.machine_with, many)):
            try:
                printers[n] = converted_printer(machine)
            except ValueError as error:  # arms may be too short for the bed
                motions[n] = InfeasibleParameters(str(error))
        longest = {n: _longest(printer, coarse) for n, printer in printers.items()}
        # together in the lanes: equal steps, commands of one length, and among those one printer, then prepared once
        tasks = sorted(
            (_steps(step_s, self.observations[i].rate_hz), len(self.commands[i]), n, i)
            for (n, step_s), i in product(longest.items(), needed)
        )
        self.work.add(sum(substeps * rows for (_, substeps), rows, _, _ in tasks))
        alike = [list(each) for _, each in groupby(tasks, key=lambda task: task[0])]
        packs = [each[k : k + LANES] for each in alike for k in range(0, len(each), LANES)]

        def simulate(pack: Sequence[_Task]) -> Sequence[PrinterMotion | ValueError]:
            (row_s, substeps), *_ = pack[0]
            pair = [printers[n] for _, _, n, _ in pack], [self.commands[i] for _, _, _, i in pack]
            return simulate_printers(*pair, row_s, substeps=substeps, splines=self.splines)

        with ThreadPoolExecutor(WORKERS) as pool:
            results = list(pool.map(simulate, packs))
        for (_, _, n, i), motion in zip(chain.from_iterable(packs), chain.from_iterable(results), strict=True):
            if isinstance(motion, ValueError):
                motions[n] = InfeasibleParameters(str(motion))
            elif not isinstance(of_printer := motions[n], InfeasibleParameters):
                of_printer[i] = motion
        return motions

    def moved(self, i: int) -> Mapping[str, FloatArray]:
        """Return commanded position, speed and acceleration of the part each signal is measured on, (n, m) each."""
        o, led = self.observations[i], self.commands[i]
        parts = parts_of(self.machine, led[-len(o.measured) :])
        place = np.stack([parts[signal[4:]] for signal in o.signals], axis=1)
        return {"pos": place, "vel": o.speed, "acc": 1e-3 * np.gradient(o.speed, 1 / o.rate_hz, axis=0)}

    def stated(self, values: Mapping[str, float], name: str) -> float:
        """Return what a file states of one of the machine's numbers: a mount lies between the modes of its axis."""
        return values[name] if name.startswith(IN_FILE) else value_of(self.machine_with(values), name)

    def machine_with(self, values: Mapping[str, float]) -> Machine:
        """Return the machine file's machine with these parameters and effects."""
        return machine_with(self.machine, {n: x for n, x in values.items() if not belongs_to_recording(n)})


@lru_cache(maxsize=4096)
def _is_sensor(name: str) -> bool:
    match = EFFECT_KEY.fullmatch(name)
    return match is not None and CATALOGUE[match["effect"]].kind == "sensor"


def _longest(printer: ConvertedPrinter, coarse: bool) -> float:
    longest = longest_step(printer.parameters, printer.modes)
    if longest == SMOOTH_STEP_S:
        return COARSE_STEP_S if coarse else STEP_S
    return max(longest, COARSE_KINKED_STEP_S) if coarse else longest


def _steps(longest: float, rate_hz: float) -> tuple[float, int]:
    """Return a recording's row, s, and steps in each; rates that differ only by rounded times share the lanes."""
    rate_hz = round(rate_hz, 5)  # beyond are 20 ns in three seconds
    return 1 / rate_hz, math.ceil(1 / rate_hz / longest / 1.03)  # a little longer where that saves one a row


# ---- signals ---------------------------------------------------------------------------------------


def _signals(machine: Machine | None, motion: PrinterMotion, names: Sequence[str], part: Part) -> FloatArray:
    """Return the sensor signals, (n, m), in the order of `names`, of the rows that are compared.

    machine : whose sensors have effects; None: none of them has any.
    """
    rows, sensed = slice(part.first - part.last, None), motion.signals
    if machine is not None:
        dt_s = float(motion.t_s[1] - motion.t_s[0])
        sensed = measured(machine, replace(sensed, t_s=sensed.t_s + dt_s * (part.last - len(motion.t_s))))
    sources = {"acc": (sensed.carriage, sensed.nozzle), "pos": (motion.carriage_mm, motion.nozzle_mm)}
    columns = []
    for name in names:
        kind, axis = name.split("_")
        carriage_or_nozzle, i = divmod("ABCxyz".index(axis), 3)
        columns.append(sources[kind][carriage_or_nozzle][rows, i])
    return np.stack(columns).T
