"""The `ffcomp` command. Each verb has its own file and imports what it needs when it runs."""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType
from typing import Annotated, Any

# Our matrices are small: threads of the linear algebra library cost twice what they save. Before numpy is imported.
for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

import typer  # noqa: E402

from ffcomp.cli.compare import compare  # noqa: E402
from ffcomp.cli.compensate import compensate  # noqa: E402
from ffcomp.cli.diagnose import diagnose  # noqa: E402
from ffcomp.cli.estimate import estimate  # noqa: E402
from ffcomp.cli.frf import frf  # noqa: E402
from ffcomp.cli.gap import gap  # noqa: E402
from ffcomp.cli.help import SETTINGS, Command, Group  # noqa: E402
from ffcomp.cli.identify import app as identify  # noqa: E402
from ffcomp.cli.integrations import app as integrations  # noqa: E402
from ffcomp.cli.log import log_path, logged, note  # noqa: E402
from ffcomp.cli.machines import app as machines  # noqa: E402
from ffcomp.cli.record import app as record  # noqa: E402
from ffcomp.cli.record_check import check as record_check  # noqa: E402
from ffcomp.cli.restore import restore  # noqa: E402
from ffcomp.cli.serve import serve  # noqa: E402
from ffcomp.cli.show import show  # noqa: E402
from ffcomp.cli.simulate import simulate  # noqa: E402
from ffcomp.cli.warmup import warmup  # noqa: E402
from ffcomp.version import __version__  # noqa: E402


class _Verbs(Group):
    """The top level of verbs; it notes wrong usage in the log, which Typer only prints."""

    def invoke(self, ctx: Any) -> Any:
        """Run the verb; note a usage error in the log before Typer prints it."""
        try:
            return super().invoke(ctx)
        except Exception as error:
            if usage := getattr(error, "format_message", None):
                note(usage())
            raise


app = typer.Typer(
    cls=_Verbs,
    context_settings=SETTINGS,
    rich_markup_mode=None,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Compensate a printer's vibration in the G-code before printing.\n\n"
    "Start with: ffcomp compensate print.gcode --machine mp-delta-pro -o out.gcode, then ffcomp show out.gcode. "
    "Exit codes: 0 done, 2 usage, 3 nothing to do, 4 G-code, 5 machine file, 6 limits, 7 solver, 130 interrupted.",
)
app.command(cls=Command)(compensate)
app.command(cls=Command)(show)
app.command(cls=Command)(estimate)
app.command(cls=Command)(restore)
app.command(cls=Command)(compare)
app.command(cls=Command)(simulate)
app.command(cls=Command)(frf)
app.command(cls=Command)(gap)
app.command(cls=Command)(diagnose)
app.add_typer(identify, name="identify")
record.command("check", cls=Command)(record_check)
app.add_typer(record, name="record")
app.add_typer(machines, name="machines")
app.add_typer(integrations, name="integrations")
app.command(cls=Command)(serve)
app.command(cls=Command)(warmup)


def _version(asked: bool) -> None:
    if asked:
        print(f"ffcomp {__version__}")
        raise typer.Exit


def _log_path(asked: bool) -> None:
    if asked:
        print(log_path() or "FFCOMP_LOG is off: no log is written.")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and exit.")
    ] = False,
    log: Annotated[
        bool,
        typer.Option("--log-path", callback=_log_path, is_eager=True, help="Show where every run is logged and exit."),
    ] = False,
) -> None:
    """Options that stand before the verb."""


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
        app()
