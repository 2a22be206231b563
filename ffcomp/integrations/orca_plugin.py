# /// script
# requires-python = ">=3.12"
# dependencies = []
#
# [tool.orcaslicer.plugin]
# name = "ffcomp"
# description = "Compensates the printer's vibration in the exported G-code."
# author = "The ffcomp maintainers"
# version = "0.1.0"
# type = "slicing-pipeline"
# ///
"""OrcaSlicer's plugin: the exported G-code through ffcomp; where that fails, the export fails and says why.

`ffcomp integrations install orcaslicer` writes it, with the full path of ffcomp. Runs within OrcaSlicer: standard
library only, and no temporary files, for writing is watched there. The step may come twice for one print (for a file
and for an upload): ffcomp knows its own files.
"""

import json
import os
import shlex
import subprocess
from typing import Any

import orca  # type: ignore[import-not-found]

EXECUTABLE = "ffcomp"
MACHINE = ""
DEFAULTS = {"machine": MACHINE, "options": "", "executable": EXECUTABLE}
SETTINGS = ("printable_area", "gcode_flavor")  # what ffcomp checks: SLIC3R_PRINTABLE_AREA, SLIC3R_GCODE_FLAVOR
ORCA_VARIABLES = (
    "PYTHONPATH",
    "PYTHONHOME",
    "LD_LIBRARY_PATH",
)  # of its bundle; another Python would stumble over them
LOOK_S = 0.2  # from one look at whether the user has cancelled to the next


class Compensate(orca.slicing.SlicingPipelineCapabilityBase):
    """The step after G-code generation and classic post-processing scripts."""

    def get_name(self) -> str:
        """Return the name that OrcaSlicer shows."""
        return "Compensate vibration"

    def get_default_config(self) -> dict[str, str]:
        """Return the settings a new profile begins with."""
        return DEFAULTS

    def execute(self, ctx: Any) -> Any:
        """Compensate the file that OrcaSlicer is about to export."""
        if ctx.step != orca.slicing.Step.psGCodePostProcess:
            return orca.ExecutionResult.skipped()
        try:
            sentence = _compensate(ctx, {**DEFAULTS, **json.loads(self.get_config() or "{}")})
        except (OSError, TypeError, ValueError) as error:
            return orca.ExecutionResult.failure(orca.PluginResult.RecoverableError, str(error))
        return orca.ExecutionResult.success(sentence)


def _compensate(ctx: Any, config: dict[str, str]) -> str:
    """Return ffcomp's last line; raises ValueError with a sentence when it failed or was cancelled."""
    named = ["--machine", config["machine"]] if config["machine"] else []
    process = subprocess.Popen(
        [config["executable"], "compensate", *named, *shlex.split(config["options"]), ctx.gcode_path],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        encoding="utf-8",
        errors="replace",
        env=_environment(ctx),
        creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
    )
    output, errors = _wait(process, ctx)
    if process.returncode:
        last = errors.strip().rpartition("ffcomp: ")[2]
        raise ValueError(f"{' '.join(last.split())} (exit code {process.returncode})")
    return output.strip().rpartition("\n")[2]


def _wait(process: Any, ctx: Any) -> tuple[str, str]:
    """Return what the process has printed, once it has ended; end it when the user cancels."""
    while True:
        try:
            return process.communicate(timeout=LOOK_S)
        except subprocess.TimeoutExpired:
            if ctx.cancelled():
                process.terminate()
                process.communicate()
                raise ValueError("Cancelled; the file is unchanged.") from None


def _environment(ctx: Any) -> dict[str, str]:
    slicer_variables = {"SLIC3R_PP_HOST": ctx.host, "SLIC3R_PP_OUTPUT_NAME": ctx.output_name, "PYTHONUTF8": "1"}
    slicer_variables |= {f"SLIC3R_{key.upper()}": ctx.config_value(key) for key in SETTINGS}
    kept = {key: value for key, value in os.environ.items() if key not in ORCA_VARIABLES}
    return kept | {key: value for key, value in slicer_variables.items() if value}


@orca.plugin
class Package(orca.base):
    """The plugin's package."""

    def register_capabilities(self) -> None:
        """Register the post-processing step."""
        orca.register_capability(Compensate)
