"""Cura's post-processing script: compensate the print, or return it unchanged with a comment that gives the reason.

`ffcomp integrations install cura` puts it, as Ffcomp.py, where Cura looks for scripts. Cura hands a print over as a
list of pieces (header, start, layers, end) and keeps the old pieces if a script fails, so failures must be reported in
the print itself. Runs within Cura: standard library only.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from UM.Application import Application  # type: ignore[import-not-found]
from UM.Message import Message  # type: ignore[import-not-found]

from ..Script import Script  # type: ignore[import-not-found]

EXECUTABLE = "ffcomp"
MACHINE = ""
CURA_VARIABLES = (
    "PYTHONPATH",
    "PYTHONHOME",
    "LD_LIBRARY_PATH",
)  # of its bundle; another Python would stumble over them


def _setting(label: str, description: str, default: str) -> dict[str, str]:
    return {"label": label, "description": description, "type": "str", "default_value": default}


class Ffcomp(Script):
    """One entry of Extensions > Post Processing > Modify G-Code."""

    def getSettingDataString(self) -> str:
        """Return the script's settings as Cura wants them, as JSON."""
        settings = {
            "machine": _setting("Machine", "A name from 'ffcomp machines list', or a machine file's path.", MACHINE),
            "options": _setting("Options", "More of 'ffcomp compensate --help', e.g. --offset-mm -110,-110.", ""),
            "executable": _setting("ffcomp", "The full path of the ffcomp program.", EXECUTABLE),
        }
        head: dict[str, Any] = {"name": "ffcomp: compensate vibration", "key": "Ffcomp", "metadata": {}, "version": 2}
        return json.dumps({**head, "settings": settings})

    def execute(self, data: list[str]) -> list[str]:
        """Compensate the print that Cura hands over."""
        try:
            text, warnings = self._compensated("".join(data))
        except Exception as error:  # any error: Cura would save the unchanged print silently
            return _failed(data, " ".join(str(error).split()) or repr(error))
        if warnings:
            _tell("\n".join(warnings))
        return _pieces(text, data)

    def _compensated(self, print_text: str) -> tuple[str, list[str]]:
        with TemporaryDirectory(prefix="ffcomp-cura-") as folder:
            path = Path(folder, "print.gcode")
            path.write_bytes(print_text.encode("utf-8", "surrogateescape"))
            result = self._run(path)
            return path.read_bytes().decode("utf-8", "surrogateescape"), result["answer"]["warnings"]

    def _run(self, path: Path) -> dict[str, Any]:
        machine, options, executable = map(self.getSettingValueByKey, ("machine", "options", "executable"))
        named = ["--machine", machine] if machine else []
        answer = subprocess.run(
            [executable, "compensate", "--json", *named, *shlex.split(options or ""), str(path)],
            capture_output=True,
            text=True,
            encoding="utf-8",
            errors="replace",
            env=_environment(Application.getInstance()),
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
        )
        if answer.returncode:
            raise ValueError(f"{_last_sentence(answer.stderr)} (exit code {answer.returncode})")
        result: dict[str, Any] = json.loads(answer.stdout)
        return result


def _last_sentence(output: str) -> str:
    return re.sub("[│╭╮╰╯─]+", " ", re.split("ffcomp: |╭─ Error ─+╮", output)[-1])


def _environment(cura: Any) -> dict[str, str]:
    """Describe the print as slicers that call programs do: its name, and where the bed is."""
    printer = cura.getGlobalContainerStack()
    width, depth, centred = (
        printer.getProperty(f"machine_{key}", "value") for key in ("width", "depth", "center_is_zero")
    )
    x, y = (-width / 2, -depth / 2) if centred else (0.0, 0.0)
    return {
        **{key: value for key, value in os.environ.items() if key not in CURA_VARIABLES},
        "SLIC3R_PP_HOST": "Cura",
        "SLIC3R_PP_OUTPUT_NAME": cura.getPrintInformation().jobName,
        "SLIC3R_PRINTABLE_AREA": f"{x}x{y},{x + width}x{y + depth}",
        "PYTHONUTF8": "1",
    }


def _pieces(text: str, data: list[str]) -> list[str]:
    """Cut the text where the pieces of `data` began, so that other scripts find header, layers and end again.

    Every line of the original is still there, a move as a comment `;~`. An empty line before a layer, as other scripts
    leave it, goes to the piece before. So does a piece whose first line is not found.
    """
    cuts = [0]
    for piece in data[1:]:
        first = piece.lstrip("\r\n").partition("\n")[0]
        match = re.compile(rf"^(?:;~)?{re.escape(first)}\r?$", re.MULTILINE).search(text, cuts[-1] + 1)
        if first and match:
            cuts.append(match.start())
    return [text[begin:end] for begin, end in pairwise([*cuts, len(text)])]


def _failed(data: list[str], why: str) -> list[str]:
    """Return the print with only a comment added below its first line, and show a message."""
    _tell(f"The print is NOT compensated. {why}")
    first, newline, rest = data[0].partition("\n") if data else ("", "", "")
    return [f"{first}{newline or chr(10)};ffcomp FAILED, this print is NOT compensated: {why}\n{rest}", *data[1:]]


def _tell(text: str) -> None:
    """Show a message that stays until the user closes it: a print may take longer to save than people wait."""
    Message(text, lifetime=0, title="ffcomp").show()
