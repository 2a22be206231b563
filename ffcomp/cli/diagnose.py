"""`ffcomp diagnose`: find the physical effect that a machine file lacks."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ffcomp.cli.options import AsJson, CaptureAxes, Force, MachineName, MovesPlanFile, Quiet, Report, Runs
from ffcomp.request import ACCURACY, OUTPUT

if TYPE_CHECKING:
    from ffcomp.diagnose.diagnosis import Diagnosis
    from ffcomp.diagnose.print_gain import PrintGain
    from ffcomp.diagnose.problem import Problem
    from ffcomp.diagnose.result import DiagnosisResult

Output = Annotated[
    Path | None,
    typer.Option(
        "--output",
        "-o",
        metavar="FILE",
        rich_help_panel=OUTPUT,
        help="Improved machine file. Written if an effect is named or retuning closes the model discrepancy.",
    ),
]
NoRepeats = Annotated[
    bool,
    typer.Option(
        "--without-repeats",
        rich_help_panel=ACCURACY,
        help="Guess the noise where no experiment was repeated. The evidence is weaker.",
    ),
]

Thorough = Annotated[
    bool,
    typer.Option(
        "--thorough",
        rich_help_panel=ACCURACY,
        help="Try everything, for as long as it takes. Else a search ends at a budget of work, and says so.",
    ),
]


def diagnose(
    runs: Runs,
    machine: MachineName,
    plan: MovesPlanFile = None,
    axes_map: CaptureAxes = None,
    output: Output = None,
    report: Report = None,
    force: Force = False,
    without_repeats: NoRepeats = False,
    thorough: Thorough = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Find the physical effect that the machine file lacks, and its size.

    The answer is one effect or several, none, or unknown. A change of the file's own parameters within their
    uncertainty is retuning, not an effect. An effect is named only if it explains the discrepancy at positions it was
    not fitted to. The answer ends with what to do to the printer.

    Captures of ffcomp record plan are joined with their commands by --plan.

    Example: ffcomp diagnose runs/*.csv --machine my-delta.toml -o better.toml --report diagnosis.html
    """
    from ffcomp.cli.common import exit_codes, print_json, say

    _check_targets(output, report, force)
    with exit_codes():
        import time
        from math import inf

        from ffcomp.cli.search_progress import SearchProgress
        from ffcomp.diagnose.diagnosis import USUAL_S
        from ffcomp.diagnose.diagnosis import diagnose as searched
        from ffcomp.diagnose.json import diagnosis_json
        from ffcomp.diagnose.problems import check_recordings, gain_of, problem_of, recordings_of, separated
        from ffcomp.diagnose.result import result_of
        from ffcomp.diagnose.settings import SETTINGS
        from ffcomp.record.axes import turn_of
        from models.file import load_plant

        began = time.monotonic()
        loaded = load_plant(machine)

        def progress(sentence: str) -> None:
            say(f"ffcomp: {sentence}", quiet)

        measured = recordings_of(loaded, runs, plan, turn_of(axes_map), progress)
        problem = problem_of(loaded, measured)
        check_recordings(problem, measured, without_repeats)
        with SearchProgress(quiet, USUAL_S) as shown:
            search = searched(problem, shown, inf if thorough else SETTINGS.budget_steps)
        found = separated(problem, search, result_of(problem, search))
        better = output if found.mends else None
        gain = gain_of(loaded, found)
        page = _page(problem, search, found, better, report, runs, began, gain)
        files = _better(problem, found, better, runs) | page
        _write(files)
        if as_json:
            print_json(diagnosis_json(found, _text(better), _text(report), time.monotonic() - began, gain))
        else:
            _print(found, better, report, gain)


def _check_targets(output: Path | None, report: Path | None, force: bool) -> None:
    """Refuse, before the work, targets that cannot be written."""
    for path, option in ((output, "--output"), (report, "--report")):
        if path is None:
            continue
        if path.is_dir() or not path.resolve().parent.is_dir():
            raise typer.BadParameter(f"{path}: {option} names a file in a folder that exists.")
        if path.exists() and not force:
            raise typer.BadParameter(f"{path} exists already; give another {option}, or --force.")
    if output is not None and report is not None and output.resolve() == report.resolve():
        raise typer.BadParameter(f"{report}: --report and --output must be two files.")


def _better(problem: Problem, found: DiagnosisResult, target: Path | None, runs: list[Path]) -> dict[Path, bytes]:
    """Make the improved machine file, if it is asked for and an effect is named."""
    if target is None:
        return {}
    from datetime import date

    from ffcomp.diagnose.result import better_file
    from ffcomp.identify.machine_fit import hash_of
    from models.file import check_text

    hashes = [hash_of(path) for path in runs]
    text = better_file(Path(problem.path), target.stem, found, hashes, date.today().isoformat())
    check_text(text, str(target))
    return {target: text.encode()}


def _page(
    problem: Problem,
    search: Diagnosis,
    found: DiagnosisResult,
    better: Path | None,
    target: Path | None,
    runs: list[Path],
    began: float,
    gain: PrintGain | None,
) -> dict[Path, bytes]:
    """Make the report, if it is asked for."""
    if target is None:
        return {}
    import time
    from datetime import date

    from ffcomp.diagnose.problems import proposals_of
    from ffcomp.diagnose.summary import summarise
    from ffcomp.identify.machine_fit import hash_of
    from ffcomp.report.diagnose.html import page
    from ffcomp.report.diagnose.inputs import Origin, ReportInput
    from ffcomp.version import __version__

    drawn, proposals = summarise(problem, search), proposals_of(problem, search)
    origin = Origin(
        machine=problem.name,
        machine_file=hash_of(Path(problem.path)),
        runs=[hash_of(path) for path in runs],
        date=date.today().isoformat(),
        version=__version__,
        seconds=time.monotonic() - began,
        written="" if better is None else better.name,
    )
    return {target: page(ReportInput(found, drawn, proposals, origin, "" if gain is None else gain.sentence()))}


def _write(files: dict[Path, bytes]) -> None:
    """All are complete before the first is written."""
    from gcode.atomic_write import replace_atomically

    for path, content in files.items():
        replace_atomically(path, [content])


def _text(path: Path | None) -> str | None:
    return None if path is None else str(path)


def _digits(value: Any) -> str:
    if isinstance(value, list):
        return f"[{', '.join(_digits(x) for x in value)}]"
    return value if isinstance(value, str) else f"{value:.4g}"


def _print(found: DiagnosisResult, written: Path | None, report: Path | None, gain: PrintGain | None) -> None:
    from ffcomp.diagnose.sentences import said
    from ffcomp.diagnose.what_to_do import what_to_do
    from models.effects.catalogue import CATALOGUE

    first, *others = said(found)
    print(first)
    for name in found.effects if found.verdict == "effects" else ():
        print(f"  {name}: {CATALOGUE[name].title.lower()}")
        for key, e in found.parameters(name).items():
            print(f"    {key} = {_digits(e['value'])}   (90 %: {_digits(e['low'])} to {_digits(e['high'])})")
    print(*others, sep="\n", end="\n" if others else "")
    for name, how in found.confounded_with if found.verdict == "effects" else ():
        print(f"Looks alike: {name}. To tell them apart: {how}")
    if found.invisible:
        print(f"These runs could not show: {', '.join(found.invisible)}.")
    print("What to do:")
    for step in what_to_do(found):
        print(f"  - {step}")
    if gain is not None:
        print(gain.sentence())
    if written:
        print(f"{written}: written. Compare with new runs: ffcomp gap NEW-RUNS --machine {written}")
    if report:
        print(f"Report: {report}")
