"""`ffcomp identify`: from measurements to a machine file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ffcomp.cli.help import ACCURACY, ADVANCED, MACHINE, OUTPUT, Command, Group
from ffcomp.cli.identify_plan import plan as write_plan
from ffcomp.cli.options import AsJson, Figure, Force, HighestFitted, LowestFitted, MachineFile, MachineName, Quiet

if TYPE_CHECKING:
    from ffcomp.identify.identify import Identified
    from ffcomp.identify.load import Gathered
    from ffcomp.identify.modal_fit import AxisFit, IdentifiedAxes
    from models.machine import Machine

app = typer.Typer(
    cls=Group,
    no_args_is_help=True,
    help="Identify a machine file's parameters from measurements.\n\n"
    "With an accelerometer and no laboratory: ffcomp identify plan, run its G-code, ffcomp identify fit. "
    "With frequency responses of your own: ffcomp identify fit responses.csv … (CSV or UFF 58).",
)
app.command("plan", cls=Command)(write_plan)

Data = Annotated[
    list[Path],
    typer.Argument(
        metavar="DATA...",
        help="Frequency responses (CSV, UFF 58), recordings (CSV), captures of a plan, or Klipper's resonances_*.csv "
        "and raw_data_*.csv.",
    ),
]
PlanFile = Annotated[
    Path | None,
    typer.Option(
        "--plan",
        metavar="FILE",
        rich_help_panel=MACHINE,
        help="Plan (.json) that `identify plan` wrote, for its captures.",
    ),
]
Known = Annotated[
    list[str] | None,
    typer.Option(
        metavar="KEY=VALUE±SD",
        rich_help_panel=ACCURACY,
        help="Known parameter, e.g. effector.total_mass_kg=0.651±0.001 from a kitchen scale. Any parameter of the "
        "machine file may be given. Without ± the standard deviation is one percent.",
    ),
]
Method = Annotated[
    str,
    typer.Option(
        metavar="NAME",
        rich_help_panel=ADVANCED,
        help="Method: direct, the output-error fit; stepwise, the paper's method, which needs all four setups.",
    ),
]
Name = Annotated[
    str | None,
    typer.Option(metavar="NAME", rich_help_panel=OUTPUT, help="Name of the new machine. Default: the output file's."),
]
AxesMap = Annotated[
    str,
    typer.Option(
        metavar="X,Y,Z",
        rich_help_panel=MACHINE,
        help="The printer's axes in the accelerometer's own, e.g. x,-z,y.",
    ),
]
Axis = Annotated[
    str | None,
    typer.Option(
        metavar="AXIS",
        rich_help_panel=MACHINE,
        help="Excited axis, x or y, of resonance tests whose file names do not state it (cartesian and CoreXY).",
    ),
]


@app.command("fit", cls=Command)
def fit(
    data: Data,
    machine: MachineName,
    output: MachineFile = None,
    plan: PlanFile = None,
    known: Known = None,
    method: Method = "direct",
    name: Name = None,
    figure: Figure = None,
    lowest_hz: LowestFitted = 2.0,
    highest_hz: HighestFitted = 400.0,
    axes_map: AxesMap = "x,y,z",
    axis: Axis = None,
    force: Force = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Fit a machine file's parameters to measurements, with their uncertainties.

    ffcomp states each parameter with its 90 % interval and names those that the data leave weak.

    Example: ffcomp identify fit carriage.csv hammer.uff centre-*.csv -m mp-delta-pro
    --known effector.total_mass_kg=0.651±0.001 -o my-printer.toml --figure fit.png

    A cartesian or CoreXY machine: ffcomp identify fit raw_data_x_*.csv raw_data_y_*.csv -m voron-300 -o my.toml
    """
    from ffcomp.cli.common import exit_codes, print_json, say

    numbers = dict(_known(text) for text in known or [])
    if axis not in (None, "x", "y", "z"):
        raise typer.BadParameter(f"--axis {axis!r}: it is x, y or z.")
    if method not in ("direct", "stepwise"):
        raise typer.BadParameter(f"--method {method!r}: it is direct or stepwise.")
    if output is not None and output.exists() and not force:
        raise typer.BadParameter(f"{output} exists already; give another --output, or --force.")
    with exit_codes():
        from ffcomp.identify.experiment_files import load_plan
        from ffcomp.identify.load import gather
        from models.file import load_machine

        start = load_machine(machine)

        def progress(sentence: str) -> None:
            say(f"ffcomp: {sentence}", quiet)

        account = None if plan is None else load_plan(plan)
        axes = axes_map.split(",")
        band = (lowest_hz, highest_hz)
        gathered = gather(data, start, band_hz=band, plan=account, axes=axes, shaken_axis=axis, progress=progress)
        for sentence in gathered.skipped:
            say(f"ffcomp: {sentence}", quiet)
        outcome = _Outcome(start, gathered, data, numbers, output, name)
        result = outcome.of(method, progress)
        if figure is not None:
            outcome.draw(figure)
            say(f"ffcomp: {figure}", quiet)
        if as_json:
            print_json(result)
        else:
            _print(result)


@app.command("decouple", cls=Command)
def decouple(
    data: Data,
    machine: MachineName,
    lowest_hz: LowestFitted = 2.0,
    highest_hz: HighestFitted = 125.0,
    as_json: AsJson = False,
) -> None:
    """Find which part of a delta's model is wrong.

    ffcomp recovers the effector's load on the carriages from measured responses. It needs all nine responses cmd_A …
    cmd_C to pos_A … pos_C (or acc_) of a position: each carriage excited by itself and all three measured. The
    carriages' own parameters (sub-model 1) are taken from the machine file.

    Example: ffcomp identify decouple towers-centre.uff --machine my-delta.toml
    """
    from ffcomp.cli.common import exit_codes, print_json

    with exit_codes():
        from ffcomp.identify.decoupling import decouple as turned_round
        from ffcomp.identify.decoupling import judge_parts
        from ffcomp.identify.load import gather
        from models.errors import MachineFileError
        from models.file import load_machine

        loaded = load_machine(machine)
        if loaded.has_straight_axes:
            rule = "Straight axes carry no effector to be decoupled from: `ffcomp identify fit` says what they do."
            raise MachineFileError(loaded.path, [rule])
        responses = gather(data, loaded, band_hz=(lowest_hz, highest_hz)).responses
        places = list(dict.fromkeys(r.position_mm for r in responses if r.setup == "assembly")) or [None]
        answers = [
            {
                "position_mm": place,
                "parts": [
                    {"part": p.name, "statement": p.statement, "error": p.error, "noise": p.noise, "holds": p.holds}
                    for p in judge_parts(turned_round(loaded, [r for r in responses if r.position_mm == place]))
                ],
            }
            for place in places
        ]
        if as_json:
            print_json({"schema": "ffcomp-identify-decouple/1", "machine": loaded.name, "places": answers})
        else:
            _print_parts(answers)


def _print_parts(answers: list[dict[str, Any]]) -> None:
    for answer in answers:
        place = ", ".join(f"{x:g}" for x in (answer["position_mm"] or (0, 0))[:2])
        wrong = [part["part"] for part in answer["parts"] if not part["holds"]]
        print(f"at ({place}) mm: " + (f"wrong: {', '.join(wrong)}" if wrong else "every part holds"))
        for part in answer["parts"]:
            mark = "holds" if part["holds"] else "WRONG"
            print(f"  {mark}  {100 * part['error']:6.1f} % (noise {100 * part['noise']:.1f} %)  {part['statement']}")


def _known(text: str) -> tuple[str, tuple[float, float]]:
    """KEY=VALUE±SD, also with +- ."""
    key, _, number = text.partition("=")
    value, _, sd = number.replace("+-", "±").partition("±")
    try:
        found = float(value)
        return key.strip(), (found, float(sd) if sd else 0.01 * abs(found))
    except ValueError:
        raise typer.BadParameter(f"--known {text!r}: it reads KEY=VALUE±SD, with numbers.") from None


OF_A_MODE = ("frequency_hz", "damping_ratio", "share")


class _Outcome:
    """What a fit leads to: a result to print, and a file."""

    def __init__(
        self,
        start: Machine,
        gathered: Gathered,
        data: list[Path],
        known: dict[str, tuple[float, float]],
        output: Path | None,
        name: str | None,
    ) -> None:
        self.start, self.gathered, self.known, self.output = start, gathered, known, output
        self.name = name or (output.stem if output else start.name)
        self.hashes = [hash_of(path) for path in data]
        self.identified: Identified | None = None
        self.axes: IdentifiedAxes | None = None

    def of(self, method: str, progress: Any) -> dict[str, Any]:
        if self.start.has_straight_axes:
            return self.from_axes(method, progress)
        return self.from_responses(method, progress) if self.gathered.responses else self.from_modes()

    def draw(self, target: Path) -> None:
        from ffcomp.report.identify import draw_axes, draw_fit

        if self.identified is not None:
            draw_fit(self.identified, target)
        elif self.axes is not None:
            draw_axes(self.axes, self.name, target)
        else:
            raise typer.BadParameter("--figure shows frequency responses; these files hold none (see: --plan).")

    def from_axes(self, method: str, progress: Any) -> dict[str, Any]:
        """The modes of straight axes."""
        from datetime import date

        from ffcomp.identify.identify import axes_file_text
        from ffcomp.identify.modal_fit import identify_axes

        if method == "stepwise" or self.known:
            raise typer.BadParameter("--method stepwise and --known are for deltas; this machine's axes are straight.")
        found = identify_axes(self.gathered.shaken, self.gathered.responses, progress)
        self.axes = found
        text = axes_file_text(Path(self.start.path), found, self.name, self.hashes, date.today().isoformat())
        return {
            **self._head(),
            "method": "axes",
            "axes": {axis.name: _axis_answer(axis) for axis in found.axes},
            "advice": list(found.advice),
            "output": self._written(text),
        }

    def from_responses(self, method: str, progress: Any) -> dict[str, Any]:
        from datetime import date

        from ffcomp.identify.identify import identify, machine_file_text

        if method == "stepwise":
            return self._stepwise()
        found = identify(self.start, self.gathered.responses, self.known, progress)
        self.identified = found
        text = machine_file_text(Path(self.start.path), found, self.name, self.hashes, date.today().isoformat())
        return {
            **self._head(),
            "method": "direct",
            "numbers": {key: _estimate(e) for key, e in found.fitted.estimates.items()},
            "delays_s": {key: _estimate(e) for key, e in found.fitted.delays_s.items()},
            "kept": list(found.kept),
            "weak": {key: dict(others) for key, others in found.fitted.weak.items()},
            "advice": list(found.advice),
            "misfit": found.fitted.misfit,
            "model_error": found.fitted.model_error,
            "responses": _fit_quality(found),
            "output": self._written(text),
        }

    def _stepwise(self) -> dict[str, Any]:
        from dataclasses import replace
        from datetime import date

        from ffcomp.identify.identify import stepwise_file_text
        from ffcomp.identify.output_error import TOTAL_MASS
        from ffcomp.identify.paper import identify_stepwise

        if TOTAL_MASS not in self.known:
            raise typer.BadParameter(f"--method stepwise needs the effector's weight: --known {TOTAL_MASS}=KG±SD.")
        found = identify_stepwise(self.start, self.gathered.responses, *self.known[TOTAL_MASS])
        named = replace(found, machine=replace(found.machine, name=self.name))
        text = stepwise_file_text(Path(self.start.path), named, self.hashes, date.today().isoformat())
        return {
            **self._head(),
            "method": "stepwise",
            "steps": [
                {
                    "step": step.title,
                    "chi_squared_per_degree_of_freedom": step.consistency,
                    "numbers": {key: _estimate(e) for key, e in step.found.estimates().items()},
                }
                for step in found.steps
            ],
            "advice": [],
            "output": self._written(text),
        }

    def from_modes(self) -> dict[str, Any]:
        """Only resonances are known: a table of modes, and a starting file if one is asked for."""
        from datetime import date

        from ffcomp.identify.from_resonances import starting_machine
        from ffcomp.identify.identify import modes_file_text
        from ffcomp.identify.load import resonances_of

        spectra = [
            {
                "file": fit.source,
                "signal": fit.signal,
                "verdict": fit.verdict,
                "modes": [_mode(m) for m in fit.modes],
            }
            for fit in self.gathered.spectra
        ]
        result: dict[str, Any] = {**self._head(), "method": "modes", "spectra": spectra, "output": None}
        result["advice"] = [
            "Spectra hold no phase and no command: they say where it resonates, not why. For a model that can be "
            "compensated with, run `ffcomp identify plan` and bring its captures."
        ]
        if self.output is not None:
            started = starting_machine(self.start, resonances_of(self.gathered.spectra))
            when = date.today().isoformat()
            text = modes_file_text(Path(self.start.path), started, self.name, self.hashes, when)
            result["numbers"] = {key: _estimate(e) for key, e in started.estimates.items()}
            result["output"] = self._written(text)
        return result

    def _head(self) -> dict[str, Any]:
        return {
            "schema": "ffcomp-identify-fit/1",
            "started_from": {"name": self.start.name, "sha256": self.start.sha256},
            "data": self.hashes,
            "skipped": self.gathered.skipped,
        }

    def _written(self, text: str) -> str | None:
        from gcode.atomic_write import replace_atomically
        from models.file import check_text

        check_text(text, str(self.output or self.name))  # never leave a file behind that cannot be read
        if self.output is None:
            return None
        replace_atomically(self.output, [line.encode() for line in text.splitlines(keepends=True)])
        return str(self.output)


def hash_of(path: Path) -> str:
    import hashlib

    return f"{path.name} sha256:{hashlib.sha256(path.read_bytes()).hexdigest()}"


def _estimate(e: Any) -> dict[str, float]:
    return {"value": float(e.value), "sd": float(e.sd), "low": float(e.low), "high": float(e.high)}


def _axis_answer(axis: AxisFit) -> dict[str, Any]:
    return {
        "modes": [{key: _estimate(getattr(mode, key)) for key in OF_A_MODE} for mode in axis.modes],
        "verdict": axis.verdict,
        "data": [
            {"source": Path(datum.source).name, "lines": len(datum.frequency_hz), "model_error": error}
            for datum, error in zip(axis.data, axis.errors, strict=True)
        ],
    }


def _mode(m: Any) -> dict[str, Any]:
    return {
        "frequency_hz": m.frequency_hz,
        "frequency_sd_hz": m.frequency_sd_hz,
        "damping_ratio": m.damping_ratio,
        "damping_ratio_sd": m.damping_ratio_sd,
        "power": m.power,
        "clear": m.clear,
    }


def _fit_quality(found: Identified) -> list[dict[str, Any]]:
    import numpy as np

    rows = []
    fitted = found.fitted
    for r, h, share in zip(fitted.responses, fitted.predictions, fitted.model_errors, strict=True):
        error = float(np.sqrt(np.sum(np.abs(r.value - h) ** 2) / np.sum(np.abs(r.value) ** 2)))
        noise = float(np.sqrt(np.sum(r.variance) / np.sum(np.abs(r.value) ** 2)))
        rows.append(
            {
                "source": r.source,
                "setup": r.setup,
                "input": r.input,
                "output": r.output,
                "position_mm": r.position_mm,
                "points": len(r.frequency_hz),
                "relative_error": error,
                "relative_noise": noise,
                "model_error": float(share),
            }
        )
    return rows


def _print(result: dict[str, Any]) -> None:
    for step in result.get("steps", []):
        print(f"\n{step['step']} (redundant equations: χ² {step['chi_squared_per_degree_of_freedom']:.2f} a degree)")
        _print_numbers(step["numbers"], ())
    for spectrum in result.get("spectra", []):
        print(f"{Path(spectrum['file']).name}, {spectrum['signal']}: {spectrum['verdict']}")
        for m in spectrum["modes"]:
            text = "  {frequency_hz:6.1f} ± {frequency_sd_hz:.1f} Hz, ζ {damping_ratio:.3f} ± {damping_ratio_sd:.3f}"
            print(text.format(**m) + ("" if m["clear"] else "  (uncertain)"))
    for name, axis in result.get("axes", {}).items():
        _print_axis(name, axis)
    if "numbers" in result:
        _print_numbers(result["numbers"], result.get("kept", ()))
    if "misfit" in result:
        print(_verdict(result))
    for sentence in result["advice"]:
        print(sentence)
    if result["output"]:
        print(f"{result['output']}: written. Look: ffcomp machines show {result['output']}")


def _print_axis(name: str, axis: dict[str, Any]) -> None:
    print(f"[axes.{name}]")
    for mode in axis["modes"]:
        share = f", share {_interval(mode['share'])}" if len(axis["modes"]) > 1 else ""
        print(f"  frequency {_interval(mode['frequency_hz'])} Hz, ζ {_interval(mode['damping_ratio'])}{share}")
    print(f"  {axis['verdict']}")
    for datum in axis["data"]:
        left = f"{100 * datum['model_error']:.1f} %" if datum["model_error"] else "its noise"
        print(f"  {datum['source']}: told to {left} ({datum['lines']} frequencies)")


def _interval(e: dict[str, float]) -> str:
    return f"{e['value']:.4g} ({e['low']:.4g} … {e['high']:.4g})"


def _print_numbers(numbers: dict[str, dict[str, float]], kept: Sequence[str]) -> None:
    """Aligned text that stays whole when piped."""
    width = max(map(len, numbers))
    for key, e in numbers.items():
        percent = f"± {100 * e['sd'] / abs(e['value']):.2g} %" if e["value"] else ""
        remark = "  kept as it was: the data do not say" if key in kept else ""
        interval = f"{e['low']:.4g} … {e['high']:.4g}"
        print(f"{key:{width}}  {e['value']:<12.5g} {percent:10} 90 %: {interval}{remark}")


def _verdict(result: dict[str, Any]) -> str:
    """How many responses are explained, and which one worst."""
    responses = result["responses"]
    left = [r for r in responses if r["model_error"] > 0]
    if not left:
        return f"The model explains all {len(responses)} responses to their noise (misfit {result['misfit']:.2f})."
    worst = max(left, key=lambda r: float(r["model_error"]))
    return (
        f"The model explains {len(responses) - len(left)} of {len(responses)} responses to their noise, the others to "
        f"{100 * min(r['model_error'] for r in left):.1f}-{100 * worst['model_error']:.1f} % of their values; worst "
        f"{worst['input']} to {worst['output']}."
    )
