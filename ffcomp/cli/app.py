"""The `ffcomp` command: verbs are mounted here; each has its own file and imports what it needs when it runs."""

from __future__ import annotations

import os
from typing import Annotated

# Our matrices are small: threads of the linear algebra library cost twice what they save. Before numpy is imported.
for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

import typer  # noqa: E402

from ffcomp import __version__  # noqa: E402
from ffcomp.cli.compare import compare  # noqa: E402
from ffcomp.cli.compensate import compensate  # noqa: E402
from ffcomp.cli.diagnose import diagnose  # noqa: E402
from ffcomp.cli.frf import frf  # noqa: E402
from ffcomp.cli.gap import gap  # noqa: E402
from ffcomp.cli.identify import app as identify  # noqa: E402
from ffcomp.cli.machines import app as machines  # noqa: E402
from ffcomp.cli.restore import restore  # noqa: E402
from ffcomp.cli.show import show  # noqa: E402
from ffcomp.cli.simulate import simulate  # noqa: E402

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Compensate a printer's vibration in its G-code, before it is printed.\n\n"
    "Start with: ffcomp compensate print.gcode --machine mp-delta-pro -o out.gcode, then ffcomp show out.gcode. "
    "Exit codes: 0 done, 2 usage, 3 nothing to do, 4 G-code, 5 machine file, 6 limits, 7 solver, 130 interrupted.",
)
app.command()(compensate)
app.command()(show)
app.command()(restore)
app.command()(compare)
app.command()(simulate)
app.command()(frf)
app.command()(gap)
app.command()(diagnose)
app.add_typer(identify, name="identify")
app.add_typer(machines, name="machines")


def _version(asked: bool) -> None:
    if asked:
        print(f"ffcomp {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Say it and stop.")
    ] = False,
) -> None:
    """Options that stand before the verb."""


def main() -> None:
    """The console script."""
    app()
