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
from ffcomp.compensation.request import CompensateFilesRequest
from ffcomp.diagnosis.request import DiagnoseRequest
from ffcomp.errors import RequestError
from ffcomp.identification.request import FitRequest, RingingRequest, ScanRequest, UpdateRequest
from ffcomp.importers.request import ImportMachineRequest
from ffcomp.record.request import PlanRequest, Purpose
from ffcomp.request import Declared, Option, Request, declared
from ffcomp.serve.uploads import Refused

PICTURE, REPORT, BETTER, UPDATES = "picture.svg", "report.html", "better.toml", ".updates.jsonl"
MOVES, PLAN = "moves.gcode", "moves.json"
PRINTS = (".gcode", ".gco", ".g")
MOST_CAPTURES = 200
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,59}")  # of a machine
MEASURED = ("diagnose", "fit", "scan", "update")  # kinds that take captures or pictures


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


def compensate(task: Task) -> list[Step]:
    """Compensate a print, and draw it before and after."""
    (source,) = task.inputs
    target = str(task.out / source.name)
    words = ("compensate", str(source), "-m", task.machine, "-o", target, "--json", *task.words)
    show = ("show", target, "-o", str(task.out / PICTURE), *_report(task))
    return [Step(words, "compensating"), Step(show, "drawing", needed=False)]


def compare(task: Task) -> list[Step]:
    """Compare a print's error with every input shaper's."""
    (source,) = task.inputs
    words = ("compare", str(source), "-m", task.machine, *_report(task), *task.words)
    return [Step(words, "comparing with shapers")]


def plan(task: Task, purpose: str) -> list[Step]:
    """Write moves to record."""
    target = str(task.out / MOVES)
    words = ("record", "plan", "--for", purpose, "-m", task.machine, "-o", target, "--json", *task.words)
    return [Step(words, "planning moves")]


def measured(task: Task, verb: Sequence[str], doing: str) -> list[Step]:
    """Read captures or pictures: the plan is the input that is JSON, or the print that was recorded."""
    plans = [path for path in task.inputs if path.suffix in (".json", *PRINTS)]
    captures = [str(path) for path in task.inputs if path not in plans]
    plan_words = ("--plan", str(plans[0])) if plans else ()
    better = str(task.out / BETTER)
    return [Step((*verb, *captures, "-m", task.machine, *plan_words, "-o", better, *_report(task), *task.words), doing)]


def update(task: Task) -> list[Step]:
    """Update the machine file by captures of a print; earlier updates are kept."""
    history = Path(task.machine).with_suffix(UPDATES)
    if history.exists():
        shutil.copyfile(history, (task.out / BETTER).with_suffix(UPDATES))
    return measured(task, ("identify", "update"), "updating the machine file")


def ringing(task: Task) -> list[Step]:
    """Move the machine file's modes to frequencies that were read off a print."""
    words = ("identify", "ringing", "-m", task.machine, "-o", str(task.out / BETTER), "--json", *task.words)
    return [Step(words, "moving the modes")]


def read_machine(task: Task) -> list[Step]:
    """Make a machine file from a printer's configuration, or check a machine file."""
    (source,) = task.inputs
    if source.suffix.lower() == ".toml":
        return [Step(("machines", "check", str(source), "--json"), "checking the machine file")]
    target = str(task.out / f"{task.name}.toml")
    words = ("machines", "import", str(source), "-o", target, "--alone", "--json", *task.words)
    return [Step(words, "reading the configuration")]


def _report(task: Task) -> tuple[str, ...]:
    return "--json", "--report", str(task.out / REPORT)


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
    """One kind of job: how it runs, how many files it takes, its requests, and whether it needs a machine.

    requests : make the verb's request of options that a visitor has set
    without : options that the page does not offer here
    """

    steps: Callable[[Task], list[Step]]
    inputs: range
    requests: tuple[Callable[..., Request], ...] = ()
    without: tuple[str, ...] = ()
    machine: bool = True
    title: str = "{name}"

    @property
    def form(self) -> dict[str, Declared]:
        """The options that the page offers, by name."""
        return {each.field: each for make in self.requests for each in offered(make) if each.field not in self.without}

    def check(self, values: Mapping[str, Any]) -> None:
        """Raise RequestError where values are out of range, or do not go together."""
        for make in self.requests:
            make(**{each.field: values[each.field] for each in offered(make) if each.field in values})


def offered(make: Callable[..., Request]) -> list[Declared]:
    """Return the options of a request that have a label."""
    request: Any = make.func if isinstance(make, partial) else make
    return [each for each in declared(request) if each.option.label]


_ANY = Path("file")  # stands for the files, whose places the server chooses when the job runs
_ONE, _NONE, _CAPTURES = range(1, 2), range(1), range(1, MOST_CAPTURES)


def _plan_for(purpose: Purpose, **more: Any) -> Kind:
    request = partial(PlanRequest, machine="", output=Path(MOVES), purpose=purpose)
    return Kind(partial(plan, purpose=purpose), _NONE, (request,), **more)


KINDS: dict[str, Kind] = {
    "compensate": Kind(compensate, _ONE, (partial(CompensateFilesRequest, files=(_ANY,), machine=""),)),
    "compare": Kind(compare, _ONE, (partial(CompareRequest, _ANY, ""),), title="Compare {name}"),
    "plan": _plan_for("diagnose", title="Moves to diagnose {machine}"),
    "excite": _plan_for("identify", without=("seconds",), title="Moves to fit {machine}"),
    "diagnose": Kind(
        partial(measured, verb=("diagnose",), doing="reading the captures"),
        _CAPTURES,
        (partial(DiagnoseRequest, (_ANY,), ""),),
        title="Diagnosis of {machine}",
    ),
    "fit": Kind(
        partial(measured, verb=("identify", "fit"), doing="fitting the machine file"),
        _CAPTURES,
        (partial(FitRequest, data=(_ANY,), machine=""), Weighed),
        title="Fit of {machine}",
    ),
    "page": _plan_for("scan", without=("at", "seconds", "repeats", "height_mm"), title="Page for {machine}"),
    "scan": Kind(
        partial(measured, verb=("identify", "scan"), doing="reading the pictures"),
        _CAPTURES,
        (partial(ScanRequest, pictures=(_ANY,), plan=_ANY, machine=""),),
        title="Scan for {machine}",
    ),
    "ringing": Kind(ringing, _NONE, (partial(RingingRequest, machine="", output=_ANY),), title="Ringing of {machine}"),
    "update": Kind(
        update, _CAPTURES, (partial(UpdateRequest, data=(_ANY,), machine="", output=_ANY),), title="Update of {machine}"
    ),
    "import": Kind(
        read_machine, _ONE, (Called, partial(ImportMachineRequest, _ANY)), machine=False, title="Machine from {name}"
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

    Raises
    ------
    Refused
        If the kind is none, or an option is not its own or has no such value.
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
        KINDS[kind].check({name: _read(form[name], value) for name, value in stated.items()})
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


def _read(each: Declared, value: bool | str) -> Any:
    return value if isinstance(value, bool) else each.read(value)


def task_of(kind: str, options: Mapping[str, Any], machine: str, inputs: tuple[Path, ...], out: Path) -> Task:
    """Return a job's task, its options as words of the command line."""
    form = KINDS[kind].form
    words = tuple(form[name].word(value) for name, value in options.items() if name in form and name != "name")
    return Task(machine, inputs, out, words, options.get("name", Called.name))
