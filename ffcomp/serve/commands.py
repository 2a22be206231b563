"""The command lines of each kind of job, from options that the verb's request declares and checks.

The page offers the options that have a label; a value is read, checked and written as on the command line.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from ffcomp.comparison.request import CompareRequest
from ffcomp.compensation.request import CompensateRequest
from ffcomp.diagnosis.request import DiagnoseRequest
from ffcomp.errors import RequestError
from ffcomp.identification.request import FitRequest, RingingRequest, ScanRequest, UpdateRequest
from ffcomp.importers.request import ImportMachineRequest
from ffcomp.record.request import PlanRequest, Purpose
from ffcomp.request import Declared, Option, Request, declared
from ffcomp.serve.uploads import Refused

PICTURE, PANEL, REPORT, BETTER, UPDATES = "picture.svg", "panel.svg", "report.html", "better.toml", ".updates.jsonl"
MOVES, MOVES_PLAN = "moves.gcode", "moves.json"
PRINTS = (".gcode", ".gco", ".g")
MOST_CAPTURES = 200
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,59}")  # of a machine


@dataclass(frozen=True, slots=True)
class Step:
    """One call of `ffcomp`."""

    words: tuple[str, ...]
    doing: str
    needed: bool = True  # the job fails with it


@dataclass(frozen=True, slots=True)
class Task:
    """One job, with paths that the server has chosen."""

    machine: str  # path of its file
    inputs: tuple[Path, ...]
    out: Path
    words: tuple[str, ...]
    name: str = ""  # of the machine file that an import makes


# -- options --


@dataclass(frozen=True)
class Called(Request):
    """The name of an imported machine; only the page has this option."""

    name: Annotated[str, Option("Its name: letters, digits, - and _.", label="Call it")] = "my-printer"

    def check(self) -> None:
        """Raise RequestError for a name that some file system refuses."""
        if not NAME.fullmatch(self.name):
            raise RequestError("A machine's name has letters, digits, - and _ only, 60 at most.")


@dataclass(frozen=True)
class Weighed(Request):
    """The effector's mass on a kitchen scale; only the page has this option."""

    known_mass_kg: Annotated[
        float | None,
        Option(
            "Without the arms.",
            "",
            "--known=effector.total_mass_kg",
            low=0.01,
            high=20.0,
            label="To fit a delta: the effector with all that rides on it, weighed, kg",
        ),
    ] = None


@dataclass(frozen=True, slots=True)
class Kind:
    """One kind of job: the verb that it calls, its files and its form.

    verb : words of the command line
    doing : the verb's work, in words
    inputs : how many files it takes
    requests : make the verb's request of options that a visitor has set
    output : name of the file that the verb writes, where {file} is the input's and {name} the new machine's; "": none
    report : whether the verb writes a report
    without : options that the page does not offer here
    machine : whether it needs a machine
    """

    verb: tuple[str, ...]
    doing: str
    inputs: range
    requests: tuple[Callable[..., Request], ...]
    output: str = ""
    report: bool = False
    without: tuple[str, ...] = ()
    machine: bool = True
    title: str = "{name}"

    def words(self, task: Task) -> tuple[str, ...]:
        """Return the command line of a task."""
        files, plans = _files_and_plans(self, task.inputs)
        output = self.output.format(file=files[0].name if files else "", name=task.name)
        return (
            *(*self.verb, *map(str, files)),
            *(("-m", task.machine) if self.machine else ()),
            *(("--plan", str(plans[0])) if plans else ()),
            *(("-o", str(task.out / output)) if output else ()),
            *("--json", *(("--report", str(task.out / REPORT)) if self.report else ()), *task.words),
        )

    @property
    def form(self) -> dict[str, Declared]:
        """The options that the page offers, by name."""
        every = [each for make in self.requests for each in options_of(make) if each.option.label]
        return {each.field: each for each in every if each.field not in self.without}

    def check(self, values: Mapping[str, Any]) -> None:
        """Raise RequestError where values are out of range, or do not go together."""
        for make in self.requests:  # the server chooses the files when the job runs
            files = {each.field: "file" for each in options_of(make) if each.required}
            made = {each.field: values[each.field] for each in options_of(make) if each.field in values}
            make(**files | made)


def _files_and_plans(kind: Kind, inputs: Sequence[Path]) -> tuple[list[Path], list[Path]]:
    """Separate captures or pictures from their plan: the input that is JSON, or the print that was recorded."""
    plans = [path for path in inputs if kind.inputs == _CAPTURES and path.suffix in (".json", *PRINTS)]
    return [path for path in inputs if path not in plans], plans


def steps(kind: str, task: Task) -> list[Step]:
    """Return the calls of a job."""
    if kind == "import" and task.inputs[0].suffix.lower() == ".toml":
        return [Step(("machines", "check", str(task.inputs[0]), "--json"), "checking the machine file")]
    if kind == "update" and (history := Path(task.machine).with_suffix(UPDATES)).exists():  # earlier updates are kept
        shutil.copyfile(history, (task.out / BETTER).with_suffix(UPDATES))
    first = Step(KINDS[kind].words(task), KINDS[kind].doing)
    if kind != "compensate":
        return [first]
    target, report = str(task.out / task.inputs[0].name), str(task.out / REPORT)
    show = ("show", target, "-o", str(task.out / PICTURE), "--json", "--report", report)
    return [first, Step(show, "drawing", needed=False)]


def options_of(make: Callable[..., Request]) -> tuple[Declared, ...]:
    """Return all options of a request."""
    request: Any = make.func if isinstance(make, partial) else make
    return declared(request)


_ONE, _NONE, _CAPTURES = range(1, 2), range(1), range(1, MOST_CAPTURES)


def _kind(verb: str, doing: str, inputs: range, *requests: Callable[..., Request], **more: Any) -> Kind:
    return Kind(tuple(verb.split()), doing, inputs, requests, **more)


def _plan_for(purpose: Purpose, **more: Any) -> Kind:
    request = partial(PlanRequest, purpose=purpose)
    return _kind(f"record plan --for {purpose}", "planning moves", _NONE, request, output=MOVES, **more)


def _measured(verb: str, doing: str, *requests: Callable[..., Request], title: str) -> Kind:
    return _kind(verb, doing, _CAPTURES, *requests, output=BETTER, report=True, title=title)


KINDS: dict[str, Kind] = {
    "compensate": _kind("compensate", "compensating", _ONE, CompensateRequest, output="{file}"),
    "compare": _kind("compare", "comparing with shapers", _ONE, CompareRequest, report=True, title="Compare {name}"),
    "plan": _plan_for("diagnose", title="Moves to diagnose {machine}"),
    "excite": _plan_for("identify", without=("seconds",), title="Moves to fit {machine}"),
    "diagnose": _measured("diagnose", "reading the captures", DiagnoseRequest, title="Diagnosis of {machine}"),
    "fit": _measured("identify fit", "fitting the machine file", FitRequest, Weighed, title="Fit of {machine}"),
    "page": _plan_for("scan", without=("at", "seconds", "repeats", "height_mm"), title="Page for {machine}"),
    "scan": _measured("identify scan", "reading the pictures", ScanRequest, title="Scan for {machine}"),
    "ringing": _kind(
        "identify ringing", "moving the modes", _NONE, RingingRequest, output=BETTER, title="Ringing of {machine}"
    ),
    "update": _measured("identify update", "updating the machine file", UpdateRequest, title="Update of {machine}"),
    "import": Kind(
        ("machines", "import", "--alone"),
        "reading the configuration",
        _ONE,
        (Called, ImportMachineRequest),
        output="{name}.toml",
        machine=False,
        title="Machine from {name}",
    ),
}


def forms() -> dict[str, list[dict[str, Any]]]:
    """Return the fields of each kind's form, as the page draws them."""
    return {kind: [_field(each) for each in of.form.values()] for kind, of in KINDS.items()}


def _field(each: Declared) -> dict[str, Any]:
    number = each.plain_type in (int, float) and each.option.parse is None
    return {
        "name": each.field,
        "label": each.option.label,
        "help": each.option.help,
        "kind": "check" if each.is_switch and each.default is False else "number" if number else "text",
        "choices": ["yes", "no"] if each.is_switch and each.default is None else [str(one) for one in each.choices],
        "placeholder": each.default_text or (each.option.metavar if "," in each.option.metavar else "automatic"),
        "low": each.option.low,
        "high": each.option.high,
        "step": 1 if each.plain_type is int else "any",
    }


def checked(kind: str, options: Any) -> dict[str, Any]:
    """Return the options of a job, those that are set: True or False of a switch, else a text.

    Raises Refused if the kind is none, or an option is not its own or has no such value.
    """
    if kind not in KINDS:
        raise Refused(400, f"There is no kind of job {kind!r}.")
    if not isinstance(options, dict):
        raise Refused(400, "The options must be an object.")
    form = KINDS[kind].form
    if unknown := [name for name in options if name not in form]:
        raise Refused(400, f"{kind} has no option {unknown[0]!r}.")
    stated = {name: _stated(form[name], value) for name, value in options.items()}
    stated = {name: value for name, value in stated.items() if value not in ("", form[name].default)}
    try:
        KINDS[kind].check({k: value if isinstance(value, bool) else form[k].read(value) for k, value in stated.items()})
    except RequestError as error:
        raise Refused(400, str(error)) from None
    return stated


def _stated(each: Declared, value: Any) -> bool | str:
    """Return what a visitor has set; empty: nothing."""
    text = "" if value is None else str(value)
    switched: dict[str, bool | str] = {"": "", "True": True, "yes": True, "False": False, "no": False}
    if each.is_switch and text in switched:
        return switched[text]
    if each.is_switch or isinstance(value, bool | list | dict) or not text.isprintable():
        raise Refused(400, f"{each.option.label}: it cannot be {text[:60]!r}.")
    return text


def task_of(kind: str, options: Mapping[str, Any], machine: str, inputs: tuple[Path, ...], out: Path) -> Task:
    """Return a job's task, its options as words of the command line."""
    form = KINDS[kind].form
    words = tuple(form[name].word(value) for name, value in options.items() if name in form and name != "name")
    return Task(machine, inputs, out, words, options.get("name", Called.name))
