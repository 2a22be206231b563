"""The `ffcomp` command. Each verb has its own file and imports what it needs when it runs."""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType

# Our matrices are small: threads of the linear algebra library cost twice what they save. Before numpy is imported.
for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

from ffcomp.cli.command import group, run  # noqa: E402
from ffcomp.cli.compare import compare  # noqa: E402
from ffcomp.cli.compensate import compensate  # noqa: E402
from ffcomp.cli.diagnose import diagnose  # noqa: E402
from ffcomp.cli.estimate import estimate  # noqa: E402
from ffcomp.cli.frf import frf  # noqa: E402
from ffcomp.cli.gap import gap  # noqa: E402
from ffcomp.cli.identify import app as identify  # noqa: E402
from ffcomp.cli.integrations import integrations  # noqa: E402
from ffcomp.cli.log import log_path, logged  # noqa: E402
from ffcomp.cli.machines import machines  # noqa: E402
from ffcomp.cli.record import app as record  # noqa: E402
from ffcomp.cli.restore import restore  # noqa: E402
from ffcomp.cli.serve import serve  # noqa: E402
from ffcomp.cli.show import show  # noqa: E402
from ffcomp.cli.simulate import simulate  # noqa: E402
from ffcomp.cli.warmup import warmup  # noqa: E402
from ffcomp.version import __version__  # noqa: E402

app = group(
    "ffcomp",
    """Compensate a printer's vibration in the G-code before printing.

    Start with: ffcomp compensate print.gcode --machine mp-delta-pro -o out.gcode, then ffcomp show out.gcode. Exit
    codes: 0 done, 2 usage, 3 nothing to do, 4 G-code, 5 machine file, 6 limits, 7 solver, 130 interrupted.
    """,
    compensate,
    show,
    estimate,
    restore,
    compare,
    simulate,
    frf,
    gap,
    diagnose,
    identify,
    record,
    machines,
    integrations,
    serve,
    warmup,
    version_flags=("--version",),
    version=f"ffcomp {__version__}",
)


@app.command(name="--log-path", group="Other")
def show_log_path() -> None:
    """Show where every run is logged and exit."""
    print(log_path() or "FFCOMP_LOG is off: no log is written.")


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
        run(app, sys.argv[1:])
