"""The `ffcomp` command. Each verb has its own file and imports what it needs when it runs."""

from __future__ import annotations

import os
import signal
import sys
from importlib import import_module
from types import FrameType

# Our matrices are small: threads of the linear algebra library cost twice what they save. Before numpy is imported.
for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

from cyclopts import App  # noqa: E402

from ffcomp.cli.command import group, run  # noqa: E402
from ffcomp.cli.log import log_path, logged  # noqa: E402
from ffcomp.version import __version__  # noqa: E402

VERBS = (
    "compensate",
    "show",
    "estimate",
    "restore",
    "compare",
    "simulate",
    "frf",
    "gap",
    "diagnose",
    "identify",
    "record",
    "machines",
    "integrations",
    "serve",
    "warmup",
)


def command_line(imported: bool = False) -> App:
    """Make the command with all verbs.

    imported : now, so that its help has a sentence of each; else a verb is imported when it is called
    """
    paths = [(f"ffcomp.cli.{name}", name) for name in VERBS]
    made = group(
        "ffcomp",
        """Compensate a printer's vibration in the G-code before printing.

        Start with: ffcomp compensate print.gcode --machine mp-delta-pro -o out.gcode, then ffcomp show out.gcode. Exit
        codes: 0 done, 2 usage, 3 nothing to do, 4 G-code, 5 machine file, 6 limits, 7 solver, 130 interrupted.
        """,
        *(getattr(import_module(module), name) if imported else f"{module}:{name}" for module, name in paths),
    )
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
    _open_streams()
    signal.signal(signal.SIGTERM, _terminate)
    with logged(sys.argv[1:]):
        words = sys.argv[1:]
        run(app if words and words[0] in VERBS else command_line(imported=True), words)
