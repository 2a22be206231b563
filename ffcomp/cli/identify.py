"""`ffcomp identify`: from measurements to a machine file."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ffcomp.cli.command import Json, Shown, group, verb
from ffcomp.cli.common import print_json, say
from ffcomp.errors import RequestError
from ffcomp.identification.request import DecoupleRequest, FitRequest, RingingRequest, ScanRequest, UpdateRequest

if TYPE_CHECKING:
    from ffcomp.identification.axes import AxisFit
    from ffcomp.identification.belts import BeltComparison
    from ffcomp.identification.decoupling import PlaceParts
    from ffcomp.identification.machine_fit import MachineFit, ParametersFit, ResonancesFit, ScanFit, StepwiseFit
    from ffcomp.identification.uncertainty import Estimate


@verb
def fit(request: FitRequest, shown: Shown) -> None:
    """Fit a machine file's parameters to measurements, with their uncertainties.

    ffcomp states each parameter with its 90 % interval and names those that the data leave weak.

    Example: ffcomp identify fit carriage.csv hammer.uff centre-*.csv -m mp-delta-pro
    --known effector.total_mass_kg=0.651±0.001 -o my-printer.toml --figure fit.png

    A cartesian or CoreXY machine: ffcomp identify fit raw_data_x_*.csv raw_data_y_*.csv -m voron-300 -o my.toml

    Its belts, or a delta's towers, compared: ffcomp identify fit raw_data_axis=*.csv -m voron-300 --figure belts.png
    """
    from ffcomp.cli.progress import SearchProgress
    from ffcomp.identification.fitting import USUAL_S, fit_files
    from models.file import load_plant

    start = load_plant(str(request.machine))
    with SearchProgress(shown.quiet, USUAL_S, "reading the files") as progress:
        result = fit_files(start, request, progress)
    _deliver(result, request, shown)


@verb
def decouple(request: DecoupleRequest) -> None:
    """Find which part of a delta's model is wrong.

    ffcomp recovers the effector's load on the carriages from measured responses. It needs all nine responses cmd_A …
    cmd_C to pos_A … pos_C (or acc_) of a position: each carriage excited by itself and all three measured. The
    carriages' own parameters (sub-model 1) are taken from the machine file.

    Example: ffcomp identify decouple towers-centre.uff --machine my-delta.toml
    """
    from ffcomp.identification.decoupling import parts_of_places
    from ffcomp.identification.load import gather
    from models.errors import MachineFileError
    from models.file import load_machine

    machine = load_machine(request.machine)
    if not machine.vibration.position_dependent:
        rule = "Straight axes carry no effector to be decoupled from: `ffcomp identify fit` says what they do."
        raise MachineFileError(machine.path, [rule])
    band_hz = (request.lowest_hz, request.highest_hz)
    places = parts_of_places(machine, gather(request.data, machine, band_hz=band_hz).responses)
    if request.as_json:
        answers = [place.to_dict() for place in places]
        print_json(
            {
                "schema": "ffcomp-identify-decouple/1",
                "machine": machine.name,  # its name
                "places": answers,
            }
        )
    else:
        for place in places:
            _print_parts(place)


@verb
def scan(request: ScanRequest, shown: Shown) -> None:
    """Identify a printer without a sensor: from a scan or a photo of a page that it has printed.

    First print the page: ffcomp record plan --for scan -m MACHINE -o page.gcode. Scan it at 600 dpi or more, straight
    on the glass; or photograph all of it from above, without flash, so that it fills the picture. ffcomp finds the
    discs, takes out perspective and the scanner's wobble by the slow lines, and fits the machine to the waves in the
    quick ones.

    Example: ffcomp identify scan page.jpg --plan page.json -m voron-250 -o my-voron.toml --figure page.png
    """
    from ffcomp.cli.progress import SearchProgress
    from ffcomp.errors import missing_extras_explained
    from models.file import load_machine

    start = load_machine(request.machine)
    with missing_extras_explained():
        from ffcomp.identification.scanning import USUAL_S, fit_pictures

        with SearchProgress(shown.quiet, USUAL_S, "reading the pictures") as progress:
            result = fit_pictures(start, request, progress)
    _deliver(result, request, shown)


@verb
def ringing(request: RingingRequest, shown: Json) -> None:
    """Move a machine's modes to frequencies that you have read off a print, where there is nothing to measure with.

    Print a tower with walls along x and y and a sharp corner before each, the shaper off. Then
    frequency (Hz) = wall speed (mm/s) × number of waves ÷ distance they span (mm), e.g. 100 × 6 ÷ 12.1 = 49.6 Hz.
    What is read so is known to 5 %.

    Example: ffcomp identify ringing --x-hz 48 --y-hz 37 -m ender-3 -o my-ender.toml
    """
    from ffcomp.identification.fitting import fit_ringing
    from models.file import load_machine

    result = fit_ringing(load_machine(request.machine), request)
    result.write(request.output)
    if shown.as_json:
        print_json(result.to_dict(str(request.output)))
    else:
        _print(result, request.output)


@verb
def update(request: UpdateRequest, shown: Shown) -> None:
    """Update a machine file's numbers by recordings of a print, with what the file knew already.

    Each print with the sensor on narrows [uncertainty] and moves the numbers, as far as print and drift allow (Bayes'
    rule). Each layer is left out in turn: unless what the others say simulates it as well as the file does, nothing is
    written. What does not fit at all is refused: then ffcomp diagnose tells what has changed. Every update is kept as a
    line of the history beside the machine file.

    Example: ffcomp identify update captures/*.csv --plan recorded.gcode -m my-delta.toml -o my-delta.toml
    """
    from ffcomp.cli.progress import SearchProgress
    from ffcomp.diagnosis.update import USUAL_S, update_files

    with SearchProgress(shown.quiet, USUAL_S) as progress:
        result = update_files(request, progress)
    if shown.as_json:
        print_json(result.to_dict(request.output, request.history_file))
        return
    _print_numbers(result.after)
    if result.kept:
        print(f"The recordings do not tell {', '.join(result.kept)}: as they were.")
    before, after, noise = (100 * each for each in result.held_out)
    print(
        f"{result.layers} layers, each left out in turn: {after:.2g} % of its motion is left, {before:.2g} % with the "
        f"file as it was; noise {noise:.2g} %."
    )
    print(f"{request.output}: written; a line is added to {request.history_file}.")


identify = group(
    "identify",
    """Identify a machine file's parameters from measurements.

    Without a sensor: ffcomp record plan --for scan, print its page, scan it, ffcomp identify scan. Without a scanner:
    ffcomp identify ringing.

    With an accelerometer and no laboratory: ffcomp record plan --for identify, run its G-code, ffcomp identify fit.
    From then on, leave the sensor on while you print: ffcomp identify update.
    With frequency responses of your own: ffcomp identify fit responses.csv … (CSV or UFF 58).
    """,
    fit,
    scan,
    ringing,
    update,
    decouple,
)


def _print_parts(place: PlaceParts) -> None:
    at = ", ".join(f"{x:g}" for x in (place.position_mm or (0, 0))[:2])
    wrong = [part.name for part in place.parts if not part.holds]
    print(f"at ({at}) mm: " + (f"wrong: {', '.join(wrong)}" if wrong else "every part holds"))
    for part in place.parts:
        mark = "holds" if part.holds else "WRONG"
        print(f"  {mark}  {100 * part.error:6.1f} % (noise {100 * part.noise:.1f} %)  {part.statement}")


def _deliver(result: MachineFit, request: FitRequest | ScanRequest, shown: Shown) -> None:
    """Write the machine file and the figure, if they are wanted, and print."""
    from models.file import check_text

    output = request.output
    if output is not None:
        result.write(output)
    elif result.text:  # a later run would write it
        check_text(result.text, result.name)
    if request.figure is not None:
        from ffcomp.report.drawing import write_figure
        from ffcomp.report.identify import figure_of

        figure = figure_of(result)
        if figure is None:
            raise RequestError("--figure shows frequency responses; these files hold none (see: --plan).")
        write_figure(figure, request.figure, figure.dpi)
        say(f"ffcomp: {request.figure}", shown.quiet)
    if shown.as_json:
        print_json(result.to_dict(None if output is None else str(output)))
    else:
        _print(result, output)


# ---- for people ----------------------------------------------------------------------------------


def _print(result: MachineFit, output: Path | None) -> None:
    from ffcomp.identification.axis_fit import OneAxisFit
    from ffcomp.identification.machine_fit import AxesFit, ParametersFit, ResonancesFit, ScanFit, StepwiseFit
    from ffcomp.shapers.calibration import in_words

    match result:
        case StepwiseFit():
            _print_steps(result)
        case ResonancesFit():
            _print_spectra(result)
        case AxesFit():
            for axis in result.result.axes:
                _print_axis(axis)
        case ScanFit():
            _print_page(result)
    if result.belts is not None:
        _print_belts(result.belts)
    match result:
        case ParametersFit():
            _print_numbers({**result.result.fitted.estimates, **result.beside_scale}, result.result.kept)
            print(_verdict(result))
        case OneAxisFit():
            _print_numbers(result.result.estimates, result.kept)
        case ResonancesFit(started=started) if started is not None:
            _print_numbers(started.estimates)
    for sentence in result.advice:
        print(sentence)
    if isinstance(result, OneAxisFit):
        before, after = 100 * result.result.before, 100 * result.result.after
        print(f"The error of the simulation is {after:.2g} % of the motion; with the file as it was, {before:.2g} %.")
    if output is not None:
        look = "gap RUNS --machine" if isinstance(result, OneAxisFit) else "machines show"
        print(f"{output}: written. Look: ffcomp {look} {output}")
    if advice := in_words(result.shapers):
        print(advice)


def _print_steps(result: StepwiseFit) -> None:
    for step in result.result.steps:
        print(f"\n{step.title} (redundant equations: χ² {step.consistency:.2f} a degree)")
        _print_numbers(step.joint.estimates())


def _print_page(result: ScanFit) -> None:
    fit = result.result
    if result.start.vibration.position_dependent:
        for (x, y), modes in fit.modes.items():
            words = "; ".join(f"{_interval(f)} Hz, ζ {_interval(d)}" for f, d in modes)
            print(f"at {x:.0f}, {y:.0f} mm: {words}")
    _print_numbers(fit.estimates)
    if fit.friction:
        print("Dry friction of the guides is in the file too, and a compensation takes it into account.")
    noise = sorted(1e3 * line.noise_mm for line in fit.lines)[len(fit.lines) // 2]
    explained = f"the machine explains {100 * fit.explained:.0f} % of their waves"
    print(f"{len(fit.lines)} lines, rough by {noise:.0f} µm; {explained}.")


def _print_spectra(result: ResonancesFit) -> None:
    for spectrum in result.spectra:
        print(f"{Path(spectrum.source).name}, {spectrum.signal}: {spectrum.verdict}")
        for mode in spectrum.modes:
            frequency = f"{mode.frequency_hz:6.1f} ± {mode.frequency_sd_hz:.1f} Hz"
            damping = f"ζ {mode.damping_ratio:.3f} ± {mode.damping_ratio_sd:.3f}"
            print(f"  {frequency}, {damping}" + ("" if mode.clear else "  (uncertain)"))


def _print_axis(axis: AxisFit) -> None:
    print(f"[axes.{axis.name}]")
    for mode in axis.modes:
        share = f", share {_interval(mode.share)}" if len(axis.modes) > 1 else ""
        print(f"  frequency {_interval(mode.frequency_hz)} Hz, ζ {_interval(mode.damping_ratio)}{share}")
    print(f"  {axis.verdict}")
    for datum, error in zip(axis.data, axis.errors, strict=True):
        explained = f"{100 * error:.1f} %" if error else "its noise"
        print(f"  {Path(datum.source).name}: explained to {explained} ({len(datum.frequency_hz)} frequencies)")


def _print_belts(belts: BeltComparison) -> None:
    for name, e in zip(belts.names, belts.stiffness, strict=True):
        what = f"tower {name}" if belts.kind == "tower" else f"belt of axis={name}"
        interval = f"{100 * e.low:+.0f} to {100 * e.high:+.0f} %"
        print(f"{what}: {100 * e.value:+.1f} % (90 %: {interval}) against the mean of the others")
    first, second = belts.modes_hz
    print(f"  the head resonates at {_interval(first)} and {_interval(second)} Hz")
    for test, error in zip(belts.tests, belts.errors, strict=True):
        print(f"  {test.spectrum.source}: explained to {100 * error:.1f} %")
    print(belts.sentence)


def _interval(e: Estimate) -> str:
    return f"{e.value:.4g} ({e.low:.4g} … {e.high:.4g})"


def _print_numbers(numbers: Mapping[str, Estimate], kept: Collection[str] = ()) -> None:
    """Aligned text that stays whole when piped."""
    width = max(map(len, numbers))
    for key, e in numbers.items():
        percent = f"± {100 * e.sd / abs(e.value):.2g} %" if e.value else ""
        remark = "  kept as it was: the data do not say" if key in kept else ""
        print(f"{key:{width}}  {e.value:<12.5g} {percent:10} 90 %: {e.low:.4g} … {e.high:.4g}{remark}")


def _verdict(result: ParametersFit) -> str:
    """How many responses are explained, and which one worst."""
    fitted = result.result.fitted
    pairs: Sequence[tuple[float, int]] = [(float(e), i) for i, e in enumerate(fitted.model_errors) if e > 0]
    count = len(fitted.responses)
    if not pairs:
        return f"The model explains all {count} responses to their noise (misfit {fitted.misfit:.2f})."
    error, i = max(pairs, key=lambda pair: pair[0])
    return (
        f"The model explains {count - len(pairs)} of {count} responses to their noise, the others to "
        f"{100 * min(pairs)[0]:.1f}-{100 * error:.1f} % of their values; worst {fitted.responses[i].input} to "
        f"{fitted.responses[i].output}."
    )
