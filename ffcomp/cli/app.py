"""The `ffcomp` command. Each verb has its own file and imports what it needs when it runs."""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType

# Our matrices are small: threads of the linear algebra library cost twice what they save. Before numpy is imported.
for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

from cyclopts import App  # noqa: E402

from ffcomp.cli.command import group, run  # noqa: E402
from ffcomp.cli.common import collect_rarely  # noqa: E402
from ffcomp.cli.log import log_path, logged  # noqa: E402
from ffcomp.version import __version__  # noqa: E402

VERBS = {  # with the first sentence of each, so that `ffcomp --help` need not import them
    "compensate": "Compensate a print for your printer's vibration.",
    "show": "Draw a compensated print: reference, uncompensated and compensated path.",
    "estimate": "Estimate how long a print takes, by layer and by feature.",
    "restore": "Restore the original of a compensated print, byte for byte.",
    "compare": "Compare ffcomp with every input shaper on your print.",
    "simulate": "Simulate a print or step timings on the nonlinear printer.",
    "frf": "Compute the machine's frequency responses anywhere on the bed.",
    "gap": "Measure where and how much recordings and simulation disagree.",
    "diagnose": "Find the physical effect that the machine file lacks, and its size.",
    "identify": "Identify a machine file's parameters from measurements.",
    "record": "Record the printer's vibrations with its own accelerometer.",
    "machines": "List, show, check and create machine files.",
    "integrations": "Use ffcomp from your slicer or your printer's host.",
    "serve": "Serve a web page on this computer where you drop prints.",
    "warmup": "Compile the numerical code once, so that the first print need not wait.",
}


def command_line(overview: bool = False) -> App:
    """Make the command with all verbs, each imported when it is called.

    overview : only for the overview of verbs; imports none of them
    """
    made = group(
        "ffcomp",
        """Compensate a printer's vibration in the G-code before printing.

        Start with: ffcomp compensate print.gcode --machine mp-delta-pro -o out.gcode, then ffcomp show out.gcode. Exit
        codes: 0 done, 2 usage, 3 nothing to do, 4 G-code, 5 machine file, 6 limits, 7 solver, 130 interrupted.
        """,
    )
    for number, (name, sentence) in enumerate(VERBS.items()):
        made.command(f"ffcomp.cli.{name}:{name}", name=name, help=sentence if overview else None, sort_key=number)
    made.command(show_version, name="--version", group="Other")
    made.command(show_log_path, name="--log-path", group="Other")
    return made


def show_version() -> None:
    """Show the version and exit."""
    print(f"ffcomp {__version__}")


def show_log_path() -> None:
    """Show where every run is logged and exit."""
    print(log_path() or "FFCOMP_LOG is off: no log is written.")


app = command_line()


def _terminate(number: int, frame: FrameType | None) -> None:
    """End as for an interrupt, so that half-written files are cleared away: slicers and hosts cancel like this."""
    raise SystemExit(128 + number)


def _open_streams() -> None:
    """Replace an output that the caller has closed, so that no file of ours is taken for it."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115 (as long as the process)


def main() -> None:
    """Run the command line; the console script."""
    collect_rarely()
    _open_streams()
    signal.signal(signal.SIGTERM, _terminate)
    with logged(sys.argv[1:]):
        words = sys.argv[1:]
        run(app if words and words[0] in VERBS else command_line(overview=True), words)
