"""Moonraker's component: every uploaded print through ffcomp, before it can be started.

`ffcomp integrations install moonraker` puts it, as ffcomp.py, among Moonraker's components. In moonraker.conf:

    [ffcomp]
    machine: my-delta
    options: --offset-mm -110,-110
    timeout: 600

Moonraker itself has no section for file processors: components register them. It logs a processor that fails, and the
print stays as uploaded; its metadata then lack "ffcomp" among `file_processors`.
"""

from __future__ import annotations

import shlex
from typing import Any

EXECUTABLE = "ffcomp"
MACHINE = ""
STAMP = r"^; Processed by ffcomp (?P<version>v\S+), machine "  # in head and tail of what ffcomp has written


class Ffcomp:
    """Registers the processor; all the rest is Moonraker's."""

    def __init__(self, config: Any) -> None:
        machine = config.get("machine", MACHINE or None)
        if machine is None:
            raise config.error("[ffcomp] needs a machine: a name from 'ffcomp machines list', or a machine file.")
        options = shlex.split(config.get("options", ""))
        processor = {
            "name": "ffcomp",
            "command": [EXECUTABLE, "compensate", "--quiet", "--machine", machine, *options, "{gcode_file_path}"],
            "timeout": config.getfloat("timeout", 600.0, above=0.0),  # s; Moonraker kills what takes longer
            "ident": {"regex": STAMP, "location": "header"},
        }
        files = config.get_server().lookup_component("file_manager")
        files.get_metadata_storage().register_gcode_processor("ffcomp", processor)


def load_component(config: Any) -> Ffcomp:
    """Create the component; Moonraker calls this."""
    return Ffcomp(config)
