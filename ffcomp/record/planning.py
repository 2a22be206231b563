"""`ffcomp record plan`: from a request to the G-code of experiments and the plan next to it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from ffcomp.errors import RequestError
from ffcomp.numerics.serialise import keys
from ffcomp.record.excitation import (
    COARSE_ROUNDING,
    ExcitationRequest,
    line_of_action,
    make_excitation_plan,
)
from ffcomp.record.gcode_writer import Recorder, gcode_lines
from ffcomp.record.moves import MOST_ROUNDING, Place, Request, make_plan
from ffcomp.record.page import PageRequest, make_page, page_lines, twins
from ffcomp.record.plan import Experiment, Page, Plan, save_plan
from ffcomp.record.prints import plan_print, print_lines
from ffcomp.record.request import CENTRE, LINE_OF_ACTION, PlanRequest, number_pair, one_of
from ffcomp.request import shared_with
from ffcomp.result import Fact, Result
from gcode.atomic_write import replace_atomically
from gcode.dialect import KLIPPER
from gcode.dialects import shaper_commands
from models.file import load_machine
from models.machine import Machine

CHECK_KINDS, CHECK_SECONDS, CHECK_REPEATS, CHECK_SEED = ("multisine", "loop", "reversals"), 2.0, 2, 17


@dataclass(frozen=True, eq=False, repr=False)
class PlanResult(Result):
    """The plan of a recording, and its files."""

    schema = "ffcomp-record-plan/1"
    json_keys: ClassVar = keys("output", "experiments", "captures", "recommended_places_mm", "warnings", "next") | {
        "machine.name": "plan.machine",
        "machine.sha256": "plan.machine_sha256",
        "plan": "plan_file",
        "flavor": "recorder.flavor",
        "duration_s": "plan.duration_s",
        "repeats": "plan.repeats",
        "restores": "restores",
    }

    plan: Plan
    machine: Machine
    output: Path
    plan_file: Path
    recorder: Recorder
    next: str  # command line
    recommended_places_mm: tuple[Place, ...] = ()

    @property
    def captures(self) -> list[str]:
        """Patterns of the captures' names."""
        return [each.capture for each in self.plan.named_runs]

    @property
    def warnings(self) -> list[str]:
        """Say where microsteps matter."""
        if self.plan.page is not None:  # they are lost in the roughness of the lines
            return []
        of_periods = self.plan.experiments[0].excitation is not None
        largest = COARSE_ROUNDING if of_periods else MOST_ROUNDING
        coarse = [each for each in self.plan.experiments if each.rounding > largest]
        if not coarse:
            return []
        worst, count = max(coarse, key=lambda each: each.rounding), f"{len(coarse)} of {len(self.plan.experiments)}"
        louder = "a larger --amplitude-mm-per-s2, a lower --highest-hz" if of_periods else "higher limits"
        return [
            f"In {count} experiments rounding to microsteps is more than {largest:.0%} of the command; most in "
            f"{worst.name}, {worst.rounding:.0%}. Finer microsteps or {louder} make it smaller."
        ]

    @property
    def missing_places_mm(self) -> list[Place]:
        """More informative places."""
        planned = {each.position_mm[:2] for each in self.plan.experiments}
        return [place for place in self.recommended_places_mm if place not in planned]

    @property
    def experiments(self) -> list[PlannedExperiment]:
        """Every experiment, without its moves."""
        return [PlannedExperiment(each) for each in self.plan.experiments]

    @property
    def restores(self) -> list[str]:
        """How limits, shaper and bed mesh are put back."""
        return self.recorder.restores()

    @property
    def headline(self) -> str:
        """The contents of the file and its duration."""
        plan, minutes = self.plan, self.plan.duration_s / 60
        if plan.page is not None:
            return f"{self.output}: a page of {len(twins(plan))} strokes, {minutes:.0f} min to print."
        often = f", {plan.repeats} times each" if plan.repeats > 1 else ""
        return f"{self.output}: {len(plan.experiments)} experiments{often}, {minutes:.1f} min recorded."

    @property
    def facts(self) -> list[Fact]:
        """Every experiment of a recording."""
        own = [("Firmware", self.recorder.flavor), ("Plan", str(self.plan_file))]
        return own if self.plan.page is not None else [*own, *map(self._fact, self.plan.experiments)]

    def _fact(self, experiment: Experiment) -> Fact:
        x, y, *_ = experiment.position_mm
        words = f"at {x:g}, {y:g} mm, {experiment.duration_s:.1f} s, microstep error {100 * experiment.rounding:.0f} %"
        return experiment.name.removeprefix("ffcomp-"), words

    @property
    def next_steps(self) -> list[str]:
        """How to run the file, and what to do with its captures."""
        return [*self._next_steps(), *self.restores, f"Then: {self.next}"]

    def _next_steps(self) -> Iterator[str]:
        if self.plan.page is not None:
            yield f"Print {self.output.name} with the input shaper off, and keep {self.plan_file.name}."
            yield "Scan it at 600 dpi or more, or photograph all of it straight from above, in even light, no flash."
            return
        if places := self.missing_places_mm:
            options = " ".join(f"--at {x:g},{y:g}" for x, y in places)
            yield f"More informative places: {options} (or --at line-of-action)."
        if self.recorder.records:
            count = f"{len(self.captures)} captures for each accelerometer"
            yield f"Run it with the accelerometer on the nozzle holder, the heaters off, and bring back {count}."
        else:
            yield "This firmware records nothing: record all of it with a sensor of your own."
        yield f"Keep {self.plan_file}."


@dataclass(frozen=True, eq=False)
class PlannedExperiment:
    """An experiment of a plan, without its moves."""

    json_keys: ClassVar = keys(
        name="experiment.name",
        kind="experiment.kind",
        direction="experiment.excitation.direction",
        position_mm="experiment.position_mm",
        duration_s="experiment.duration_s",
        moves="experiment.moves",
        microstep_error="experiment.rounding",
    )

    experiment: Experiment


def plan_recording(request: PlanRequest) -> PlanResult:
    """Plan experiments, and write their G-code with the plan next to it.

    Raises RequestError for options that contradict each other, LimitsError for motion that the machine cannot execute.
    """
    if request.plan_file.exists() and not request.force:  # captures of it may exist, which nothing else explains
        raise RequestError(f"{request.plan_file} exists already; give another -o, or --force.")
    machine = load_machine(request.machine)
    flavor = request.flavor or machine.flavor or KLIPPER
    recorder = Recorder(flavor, request.chip or None, shaper_commands(flavor, machine.input_shaper))
    plan, lines = _planned(request, machine, recorder)
    save_plan(plan, request.plan_file)
    replace_atomically(request.output, lines)
    recommended: tuple[Place, ...] = ()
    if request.purpose == "identify":
        recommended = (machine.kinematics.centre_mm, *line_of_action(machine.kinematics))
    return PlanResult(plan, machine, request.output, request.plan_file, recorder, _next(request, plan), recommended)


def _planned(request: PlanRequest, machine: Machine, recorder: Recorder) -> tuple[Plan, Iterable[bytes]]:
    kinematics, amplitude = machine.kinematics, request.amplitude_mm_per_s2
    if request.print_file is not None:
        plan, program = plan_print(request.print_file, machine, recorder.flavor)
        return plan, print_lines(plan, program, recorder)
    if request.purpose == "scan":
        page = Page(**shared_with(request, Page))
        options = shared_with(request, PageRequest, page=page, acceleration_mm_per_s2=amplitude)
        plan = make_page(machine, PageRequest(**options))
        return plan, page_lines(plan, machine, recorder)
    if request.purpose == "identify":
        groups = kinematics.excitation_directions
        axes = request.axes or next(iter(groups))  # the first is the machine's default
        one_of("--axes", [axes], groups)
        options = shared_with(
            request,
            ExcitationRequest,
            places_mm=_excited_places(request.at or (CENTRE,), machine),
            directions=groups[axes],
            acceleration_mm_per_s2=amplitude,
        )
        plan = make_excitation_plan(machine, ExcitationRequest(**options))
    elif request.purpose == "check":  # half a minute in the middle of the bed, always the same
        options = {"seconds": CHECK_SECONDS, "repeats": CHECK_REPEATS, "seed": CHECK_SEED, "kinds": CHECK_KINDS}
        plan = make_plan(machine, Request([kinematics.centre_mm], **options))
    else:
        places = [number_pair("--at", text) for text in request.at]
        kinds = list(dict.fromkeys(request.kind)) or None
        options = shared_with(request, Request, places_mm=places, kinds=kinds, acceleration_mm_per_s2=amplitude)
        plan = make_plan(machine, Request(**options))
    return plan, gcode_lines(plan, machine, recorder)


def _excited_places(texts: Sequence[str], machine: Machine) -> list[Place]:
    """Return places in mm, each once, in their order."""
    places: list[Place] = []
    for text in texts:
        if text == CENTRE:
            places.append(machine.kinematics.centre_mm)
        elif text == LINE_OF_ACTION:
            if not machine.kinematics.tower_directions:
                raise RequestError(f"--at {text}: that is a delta's; straight axes answer alike everywhere.")
            places += line_of_action(machine.kinematics)
        else:
            places.append(number_pair("--at", text))
    return list(dict.fromkeys(places))


def _next(request: PlanRequest, plan: Plan) -> str:
    of_plan = f"--plan {request.plan_file} -m {request.machine}"
    if request.purpose == "identify":
        return f"ffcomp identify fit -m {request.machine} --plan {request.plan_file} CAPTURES"
    if request.purpose == "scan":
        return f"ffcomp identify scan PICTURE {of_plan} -o better.toml"
    if request.purpose == "check":
        return f"ffcomp record check CAPTURES {of_plan}"
    return f"ffcomp diagnose CAPTURES {of_plan}{'' if plan.repeats > 1 else ' --without-repeats'}"
