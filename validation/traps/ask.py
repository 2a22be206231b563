"""Put captures to `ffcomp record join`, and what it joins to `ffcomp diagnose`, as an owner does."""

from __future__ import annotations

import contextlib
import io
import json
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from validation.traps.captures import write
from validation.traps.owners import CaptureTrap
from validation.traps.run import Answer

PROGRESS = ("ffcomp: reading", "ffcomp: joining")


def joined(trap: CaptureTrap, keep: Path) -> Answer:
    """Write the captures of a trap and join them: `found` is ffcomp-join/1, `text` all that was said."""
    from ffcomp.cli.app import app
    from ffcomp.cli.command import run

    folder = keep / trap.name
    captures = write(trap.bench, trap.sensing, folder, keep / "readings", trap.seed_of_plan)
    shutil.rmtree(folder / "runs", ignore_errors=True)
    machine, plan = str(folder / "machine.toml"), folder / "moves.json"
    axes = ["--axes-map", trap.axes_map] if trap.axes_map else []
    words = [
        "record",
        "join",
        *map(str, captures),
        "--plan",
        plan,
        "-m",
        machine,
        "-o",
        folder / "runs",
        *axes,
        "--json",
    ]
    found, text, code, cpu_s = _called(lambda: run(app, [str(word) for word in words]))
    refusals = [f"{Path(each['file']).name}: {each['why']}" for each in found.get("refused", ())]
    return Answer(found, " ".join([*refusals, text]), code, cpu_s)


def diagnosed(trap: CaptureTrap, keep: Path, before: Answer) -> Answer:
    """Diagnose what was joined; where nothing was, `before` is the answer."""
    from ffcomp.cli.app import app
    from ffcomp.cli.command import run

    if before.code:
        return Answer({}, before.text, before.code, before.cpu_s)
    folder = keep / trap.name
    runs, better = sorted((folder / "runs").glob("*.csv")), folder / "better.toml"
    better.unlink(missing_ok=True)
    found, text, code, cpu_s = _called(
        lambda: run(
            app, ["diagnose", *map(str, runs), "-m", str(folder / "machine.toml"), "-o", str(better), "--json", "-q"]
        )
    )
    return Answer(found, " ".join([before.text, text, *found.get("said", ())]), code, before.cpu_s + cpu_s)


def _called(verb: Callable[[], None]) -> tuple[dict[str, Any], str, int, float]:
    """Call a verb: its JSON, what it said beside it, its exit code, and CPU seconds."""
    out, err, code, began = io.StringIO(), io.StringIO(), 0, time.process_time()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            verb()
        except BaseException as error:  # typer's exit among them
            code = int(getattr(error, "exit_code", getattr(error, "code", 1)) or 0)
            if code == 1:
                raise
    found = json.loads(out.getvalue()) if out.getvalue().strip() else {}
    lines = [line for line in err.getvalue().splitlines() if not line.startswith(PROGRESS)]
    return found, "\n".join(lines), code, time.process_time() - began
