"""`ffcomp compare`: evaluate ffcomp and every input shaper on one print."""

from __future__ import annotations

import os
import sys
from dataclasses import replace

from ffcomp.cli.command import verb
from ffcomp.cli.common import exit_codes
from ffcomp.cli.progress import Progress
from ffcomp.comparison.request import CompareRequest
from ffcomp.result import Result


@verb
def compare(request: CompareRequest) -> Result:
    """Compare ffcomp with every input shaper on your print.

    Every method plans its command with --machine and is evaluated on a simulated printer (--plant), never on the
    model that made the command. Shapers get the frequencies of the firmware's own calibration, and the best ones that
    a search finds with the printer known. The table shows the contour error and how fast each method could go.

    Example: ffcomp compare sample_prints/ringing_tower.gcode -m mp-delta-pro --sample 10% --report report.html
    """
    from ffcomp.api.comparison import compare_request

    try:
        with exit_codes(), Progress(1.0, "comparing") as progress:
            return compare_request(replace(request, progress=progress.phase))
    except SystemExit as end:
        if end.code == 130:  # interrupted: do not wait for searches in threads; nothing of theirs is on disk
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(130)
        raise
