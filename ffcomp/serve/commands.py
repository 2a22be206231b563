"""What each kind of job runs: the command lines of ffcomp, from options that are checked first."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ffcomp.serve.uploads import Refused

PICTURE, REPORT, BETTER = "picture.png", "report.html", "better.toml"
MOVES, PLAN = "moves.gcode", "moves.json"
FLAVORS = ("klipper", "marlin", "reprapfirmware")
MOST_CAPTURES = 200
MEASURED = ("diagnose", "fit")  # kinds that take captures


@dataclass(frozen=True, slots=True)
class Step:
    """One call of `ffcomp`."""

    words: tuple[str, ...]
    doing: str
    needed: bool = True  # the job fails with it


@dataclass(frozen=True, slots=True)
class Request:
    """What a job is to do, with paths that the server has chosen."""

    machine: str  # path of its file
    inputs: tuple[Path, ...]
    out: Path
    options: Mapping[str, Any]


def compensate(request: Request) -> list[Step]:
    """Compensate a print, and draw it before and after."""
    (source,) = request.inputs
    target = str(request.out / source.name)
    words = ("compensate", str(source), "-m", request.machine, "-o", target, "--json", *_words(request.options))
    show = ("show", target, "-o", str(request.out / PICTURE), "--json")
    return [Step(words, "compensating"), Step(show, "drawing", needed=False)]


def compare(request: Request) -> list[Step]:
    """Compare a print's error with every input shaper's."""
    (source,) = request.inputs
    page = str(request.out / REPORT)
    words = ("compare", str(source), "-m", request.machine, "--report", page, "--json", *_words(request.options))
    return [Step(words, "comparing with shapers")]


def plan(request: Request) -> list[Step]:
    """Write moves that are worth recording."""
    return [Step(_planned(request, "diagnose"), "planning moves")]


def excite(request: Request) -> list[Step]:
    """Write moves that excite what a fit of the machine file's numbers needs."""
    return [Step(_planned(request, "identify"), "planning moves")]


def _planned(request: Request, purpose: str) -> tuple[str, ...]:
    target = str(request.out / MOVES)
    words = ("record", "plan", "--for", purpose, "-m", request.machine, "-o", target, "--json")
    return (*words, *_words(request.options))


def diagnose(request: Request) -> list[Step]:
    """Find what the machine file lacks, from captures of a plan."""
    return [Step(_measured(request, "diagnose", "--report", str(request.out / REPORT)), "reading the captures")]


def fit(request: Request) -> list[Step]:
    """Fit the machine file's parameters to captures of a plan."""
    figure = ("--figure", str(request.out / PICTURE))
    return [Step(_measured(request, "identify", "fit", *figure), "fitting the machine file")]


def read_machine(request: Request) -> list[Step]:
    """Make a machine file of a printer's configuration, or check one that is a machine file already."""
    (source,) = request.inputs
    if source.suffix.lower() == ".toml":
        return [Step(("machines", "check", str(source), "--json"), "checking the machine file")]
    target = str(request.out / f"{request.options['name']}.toml")
    options = _words(request.options, skip=("name",))
    words = ("machines", "import", str(source), "-o", target, "--alone", "--json", *options)
    return [Step(words, "reading the configuration")]


def warmup(request: Request) -> list[Step]:
    """Compile the numerical code."""
    return [Step(("warmup",), "compiling, once after installing")]


def _measured(request: Request, *verb: str) -> tuple[str, ...]:
    """Words of a verb that reads captures: the plan is the input that is JSON."""
    plans = [path for path in request.inputs if path.suffix == ".json"]
    captures = [str(path) for path in request.inputs if path.suffix != ".json"]
    given = ("--plan", str(plans[0])) if plans else ()
    better = str(request.out / BETTER)
    return (*verb, *captures, "-m", request.machine, *given, "-o", better, "--json", *_words(request.options))


# -- options --


def _positive(value: Any) -> str:
    number = float(value)
    if not 0.0 < number < 1e6:
        raise ValueError
    return f"{number:g}"


def _one_of(*names: str) -> Callable[[Any], str]:
    def check(value: Any) -> str:
        if value not in names:
            raise ValueError
        return str(value)

    return check


def _pair(value: Any) -> str:
    x, y = map(float, str(value).split(","))
    if not max(abs(x), abs(y)) < 1e5:
        raise ValueError
    return f"{x:g},{y:g}"


def _mass(value: Any) -> str:
    return f"effector.total_mass_kg={_positive(value)}"


def _name(value: Any) -> str:
    name = str(value)
    if not 0 < len(name) <= 60 or not all(each.isascii() and (each.isalnum() or each in "-_") for each in name):
        raise ValueError
    if name.startswith(("-", "_")):
        raise ValueError
    return name


OPTIONS: dict[str, tuple[str, Callable[[Any], str] | None]] = {
    "shaper_off": ("--shaper-off", None),
    "robust": ("--robust", None),
    "force": ("--force", None),
    "without_repeats": ("--without-repeats", None),
    "max_error_um": ("--max-error-um", _positive),
    "max_flow_mm3_per_s": ("--max-flow-mm3-per-s", _positive),
    "plate": ("--plate", lambda value: str(int(_positive(value)))),
    "repeats": ("--repeats", lambda value: str(int(_positive(value)))),
    "seconds": ("--seconds", _positive),
    "height_mm": ("--height-mm", _positive),
    "known_mass_kg": ("--known", _mass),
    "at": ("--at", _pair),
    "offset_mm": ("--offset-mm", _pair),
    "flavor": ("--flavor", _one_of(*FLAVORS)),
    "kinematics": ("--kinematics", _one_of("cartesian", "corexy")),
    "only": ("--only", _one_of("mzv-calibrated", "mzv-calibrated,ei-calibrated")),
    "sample": ("--sample", _one_of("5%", "10%", "25%", "100%")),
    "name": ("--name", _name),
}
"""Options that the page may set: the word of the command line, and how a value is checked; None for a switch."""


@dataclass(frozen=True, slots=True)
class Kind:
    """One kind of job: how it runs, how many files it takes, which options, and whether it needs a machine."""

    steps: Callable[[Request], list[Step]]
    inputs: range
    options: tuple[str, ...] = ()
    machine: bool = True
    title: str = "{name}"


_ONE = range(1, 2)
KINDS: dict[str, Kind] = {
    "compensate": Kind(
        compensate, _ONE, ("shaper_off", "robust", "force", "max_error_um", "max_flow_mm3_per_s", "flavor", "offset_mm")
    ),
    "compare": Kind(compare, _ONE, ("flavor", "offset_mm", "plate", "only", "sample"), title="Compare {name}"),
    "plan": Kind(
        plan, range(1), ("repeats", "seconds", "height_mm", "at", "flavor"), title="Moves to diagnose {machine}"
    ),
    "excite": Kind(excite, range(1), ("height_mm", "at", "flavor"), title="Moves to fit {machine}"),
    "diagnose": Kind(diagnose, range(1, MOST_CAPTURES), ("without_repeats",), title="Diagnosis of {machine}"),
    "fit": Kind(fit, range(1, MOST_CAPTURES), ("known_mass_kg",), title="Fit of {machine}"),
    "import": Kind(read_machine, _ONE, ("name", "kinematics"), machine=False, title="Machine from {name}"),
    "warmup": Kind(warmup, range(1), machine=False, title="Getting ready"),
}


def checked(kind: str, options: Any) -> dict[str, Any]:
    """Return the options of a job, those that are set, as the command line takes them.

    Raises
    ------
    Refused
        If the kind is none, or an option is not its own or has no such value.
    """
    if kind not in KINDS:
        raise Refused(400, f"There is no kind of job {kind!r}.")
    if not isinstance(options, dict):
        raise Refused(400, "The options must be an object.")
    found: dict[str, Any] = {}
    for name, value in options.items():
        if name not in KINDS[kind].options:
            raise Refused(400, f"{kind} has no option {name!r}.")
        check = OPTIONS[name][1]
        if value in (None, "", False):
            continue
        try:
            found[name] = True if check is None else check(value)
        except (ValueError, TypeError):
            raise Refused(400, f"{name} cannot be {str(value)[:60]!r}.") from None
    if kind == "import":
        found.setdefault("name", "my-printer")
    return found


def _words(options: Mapping[str, Any], skip: tuple[str, ...] = ()) -> list[str]:
    words: list[str] = []
    for name, value in options.items():
        if name not in skip:
            word = OPTIONS[name][0]
            words += [word] if value is True else [f"{word}={value}"]
    return words
