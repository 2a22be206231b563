"""`ffcomp identify`: from measurements to a machine file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from ffcomp.cli.options import AsJson, Figure, Force, HighestFitted, LowestFitted, MachineFile, MachineName, Quiet
from ffcomp.request import ACCURACY, ADVANCED, MACHINE, OUTPUT

if TYPE_CHECKING:
    from ffcomp.identify.machine_fit import MachineFit
    from ffcomp.identify.machine_fit import Method as FitMethod

app = typer.Typer(
    no_args_is_help=True,
    help="Identify a machine file's parameters from measurements.\n\n"
    "With an accelerometer and no laboratory: ffcomp record plan --for identify, run its G-code, ffcomp identify fit. "
    "With frequency responses of your own: ffcomp identify fit responses.csv … (CSV or UFF 58).",
)

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
        help="Plan (.json) that `record plan` wrote, for its captures.",
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
    list[str] | None,
    typer.Option(
        metavar="AXIS",
        rich_help_panel=MACHINE,
        help="Excited axis of resonance tests whose file names do not state it: x, y, or a direction such as 1,-1 (a "
        "belt of a CoreXY machine) or 0.866,-0.5 (a tower of a delta). Once for all such files, or once for each.",
    ),
]
Column = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        rich_help_panel=MACHINE,
        help="Spectrum to be used of files with several columns, where their header does not say what these are.",
    ),
]
Rough = Annotated[
    bool,
    typer.Option(
        "--rough",
        rich_help_panel=ACCURACY,
        help="Write modes too that leave more than 20 % of their measurement unexplained.",
    ),
]


@app.command("fit")
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
    column: Column = None,
    rough: Rough = False,
    force: Force = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Fit a machine file's parameters to measurements, with their uncertainties.

    ffcomp states each parameter with its 90 % interval and names those that the data leave weak.

    Example: ffcomp identify fit carriage.csv hammer.uff centre-*.csv -m mp-delta-pro
    --known effector.total_mass_kg=0.651±0.001 -o my-printer.toml --figure fit.png

    A cartesian or CoreXY machine: ffcomp identify fit raw_data_x_*.csv raw_data_y_*.csv -m voron-300 -o my.toml

    Its belts, or a delta's towers, compared: ffcomp identify fit raw_data_axis=*.csv -m voron-300 --figure belts.png
    """
    from ffcomp.cli.common import exit_codes, print_json, say

    numbers = dict(_known(text) for text in known or [])
    for said in axis or []:
        _check_axis(said)
    if method not in ("direct", "stepwise"):
        raise typer.BadParameter(f"--method {method!r}: it is direct or stepwise.")
    if output is not None and output.exists() and not force:
        raise typer.BadParameter(f"{output} exists already; give another --output, or --force.")
    with exit_codes():
        from ffcomp.cli.search_progress import SearchProgress
        from ffcomp.identify.fitting import FitRequest, fit_files
        from ffcomp.identify.machine_fit import USUAL_S
        from ffcomp.identify.shaper_advice import in_words
        from models.file import load_plant

        start = load_plant(machine)

        asked = FitRequest(
            name=name or (output.stem if output else start.name),
            plan=plan,
            known=numbers,
            method=cast("FitMethod", method),
            band_hz=(lowest_hz, highest_hz),
            axes=axes_map.split(","),
            shaken_axis=axis or (),
            column=column,
            rough=rough,
            write_start=output is not None,
        )
        with SearchProgress(quiet, USUAL_S, "reading the files") as shown:
            found = fit_files(start, data, asked, shown)
        written = _written(found, output)
        if figure is not None:
            _draw(found, figure)
            say(f"ffcomp: {figure}", quiet)
        result = found.to_dict(written)
        if as_json:
            print_json(result)
        else:
            _print(result)
            if said := in_words(found.shapers):
                print(said)


@app.command("decouple")
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
        from ffcomp.identify.decoupling import evaluate_parts
        from ffcomp.identify.load import gather
        from models.errors import MachineFileError
        from models.file import load_machine

        loaded = load_machine(machine)
        if not loaded.vibration.position_dependent:
            rule = "Straight axes carry no effector to be decoupled from: `ffcomp identify fit` says what they do."
            raise MachineFileError(loaded.path, [rule])
        responses = gather(data, loaded, band_hz=(lowest_hz, highest_hz)).responses
        places = list(dict.fromkeys(r.position_mm for r in responses if r.setup == "assembly")) or [None]
        answers = [
            {
                "position_mm": place,
                "parts": [
                    {"part": p.name, "statement": p.statement, "error": p.error, "noise": p.noise, "holds": p.holds}
                    for p in evaluate_parts(turned_round(loaded, [r for r in responses if r.position_mm == place]))
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


def _check_axis(said: str) -> None:
    """Refuse what is no axis."""
    from ffcomp.identify.resonance_tests import direction_of

    try:
        direction_of(said)
    except ValueError:
        rule = "it is x, y, z, or a direction of x and y such as 1,-1 or 0.866,-0.5"
        raise typer.BadParameter(f"--axis {said!r}: {rule}.") from None


def _written(found: MachineFit, output: Path | None) -> str | None:
    """Write the machine file, if one is asked for; check it in any case, for a later run would write it."""
    from models.file import check_text

    if output is None:
        if found.text:
            check_text(found.text, found.name)
        return None
    found.write(output)
    return str(output)


def _draw(fitted: MachineFit, target: Path) -> None:
    from ffcomp.identify.identify import Identified
    from ffcomp.identify.shaper_advice import in_words
    from ffcomp.report.identify import draw_axes, draw_belts, draw_fit

    more = in_words(fitted.shapers)
    if isinstance(fitted.found, Identified):
        draw_fit(fitted.found, target, more)
    elif fitted.found is not None:
        draw_axes(fitted.found, fitted.name, target, fitted.belts, more)
    elif fitted.belts is not None:
        draw_belts(fitted.belts, fitted.name, target)
    else:
        raise typer.BadParameter("--figure shows frequency responses; these files hold none (see: --plan).")


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
    if "belts" in result:
        _print_belts(result["belts"])
    if "numbers" in result:
        beside = result.get("common_scale", {}).get("numbers", {})
        _print_numbers({**result["numbers"], **beside}, result.get("kept", ()))
    if "misfit" in result:
        print(_verdict(result))
    for sentence in result["advice"]:
        print(sentence)
    if "nrms" in result:
        before, after = (100 * result["nrms"][each] for each in ("before", "after"))
        print(f"The error of the simulation is {after:.2g} % of the motion; with the file as it was, {before:.2g} %.")
    if result["output"]:
        look = "gap RUNS --machine" if "nrms" in result else "machines show"
        print(f"{result['output']}: written. Look: ffcomp {look} {result['output']}")


def _print_axis(name: str, axis: dict[str, Any]) -> None:
    print(f"[axes.{name}]")
    for mode in axis["modes"]:
        share = f", share {_interval(mode['share'])}" if len(axis["modes"]) > 1 else ""
        print(f"  frequency {_interval(mode['frequency_hz'])} Hz, ζ {_interval(mode['damping_ratio'])}{share}")
    print(f"  {axis['verdict']}")
    for datum in axis["data"]:
        left = f"{100 * datum['model_error']:.1f} %" if datum["model_error"] else "its noise"
        print(f"  {datum['source']}: told to {left} ({datum['lines']} frequencies)")


def _print_belts(belts: dict[str, Any]) -> None:
    for name, e in belts["relative_stiffness"].items():
        what = f"tower {name}" if belts["kind"] == "tower" else f"belt of axis={name}"
        low, high = (f"{100 * e[key]:+.0f}" for key in ("low", "high"))
        print(f"{what}: {100 * e['value']:+.1f} % (90 %: {low} to {high} %) against the mean of the others")
    first, second = belts["modes_hz"]
    print(f"  the head resonates at {_interval(first)} and {_interval(second)} Hz")
    for test in belts["tests"]:
        print(f"  {test['file']}: told to {100 * test['model_error']:.1f} %")
    print(belts["sentence"])


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
