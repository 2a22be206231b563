"""`ffcomp identify`: from measurements to a machine file."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ffcomp.cli.command import group, verb
from ffcomp.identification.request import FitRequest, RingingRequest, ScanRequest, UpdateRequest
from ffcomp.result import Result

if TYPE_CHECKING:
    from ffcomp.identification.machine_fit import MachineFit


@verb
def fit(request: FitRequest) -> Result:
    """Fit a machine file's parameters to measurements, with their uncertainties.

    ffcomp states each parameter with its 90 % interval and names those that the data leave weak.

    Example: ffcomp identify fit carriage.csv hammer.uff centre-*.csv -m mp-delta-pro
    --known effector.total_mass_kg=0.651±0.001 -o my-printer.toml --report fit.html

    A cartesian or CoreXY machine: ffcomp identify fit raw_data_x_*.csv raw_data_y_*.csv -m voron-300 -o my.toml

    Its belts, or a delta's towers, compared: ffcomp identify fit raw_data_axis=*.csv -m voron-300 --figure belts.png
    """
    from ffcomp.cli.progress import SearchProgress
    from ffcomp.identification.fitting import USUAL_S, fit_files
    from models.file import load_plant

    start = load_plant(str(request.machine))
    with SearchProgress(USUAL_S, "reading the files") as progress:
        return _deliver(fit_files(start, request, progress), request)


@verb
def scan(request: ScanRequest) -> Result:
    """Identify a printer without a sensor: from a scan or a photo of a page that it has printed.

    First print the page: ffcomp record plan --for scan -m MACHINE -o page.gcode. Scan it at 600 dpi or more, straight
    on the glass; or photograph all of it from above, without flash, so that it fills the picture. ffcomp finds the
    discs, removes perspective and the scanner's wobble with the slow lines, and fits the machine to the waves in the
    quick ones.

    Example: ffcomp identify scan page.jpg --plan page.json -m voron-250 -o my-voron.toml --figure page.png
    """
    from ffcomp.cli.progress import SearchProgress
    from ffcomp.errors import missing_extras_explained
    from models.file import load_machine

    start = load_machine(request.machine)
    with missing_extras_explained():
        from ffcomp.identification.page.scan import USUAL_S, fit_pictures

        with SearchProgress(USUAL_S, "reading the pictures") as progress:
            result = fit_pictures(start, request, progress)
    return _deliver(result, request)


@verb
def ringing(request: RingingRequest) -> Result:
    """Move a machine's modes to frequencies that you read off a print, if you have no sensor.

    Print a tower with walls along x and y and a sharp corner before each, the shaper off. Then
    frequency (Hz) = wall speed (mm/s) × number of waves ÷ distance they span (mm), e.g. 100 × 6 ÷ 12.1 = 49.6 Hz.
    Such readings are accurate to about 5 %.

    Example: ffcomp identify ringing --x-hz 48 --y-hz 37 -m ender-3 -o my-ender.toml
    """
    from ffcomp.identification.fitting import fit_ringing
    from models.file import load_machine

    return fit_ringing(load_machine(request.machine), request).write(request.output)


@verb
def update(request: UpdateRequest) -> Result:
    """Update a machine file's numbers with recordings of a print; the file's numbers are the prior.

    Each print recorded with the sensor moves the numbers and narrows [uncertainty] (Bayes' rule). Each layer is left
    out in turn: nothing is written unless the other layers predict it at least as well as the file does. Recordings
    that do not fit the machine at all are refused; ffcomp diagnose then finds what has changed. Every update adds a
    line to the history next to the machine file.

    Example: ffcomp identify update captures/*.csv --plan recorded.gcode -m my-delta.toml -o my-delta.toml
    """
    from ffcomp.cli.progress import SearchProgress
    from ffcomp.diagnosis.update import USUAL_S, update_files

    with SearchProgress(USUAL_S) as progress:
        return update_files(request, progress)


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
)


def _deliver(result: MachineFit, request: FitRequest | ScanRequest) -> MachineFit:
    """Write the machine file, if it is wanted."""
    from models.file import check_text

    if request.output is not None:
        result = result.write(request.output)
    elif result.text:  # a later run would write it
        check_text(result.text, result.origin.name)
    return result
