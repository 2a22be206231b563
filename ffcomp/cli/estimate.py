"""`ffcomp estimate`: estimate how long a print takes, by layer and by feature."""

from __future__ import annotations

from ffcomp.cli.command import verb
from ffcomp.estimation.request import EstimateRequest
from ffcomp.result import Result


@verb
def estimate(request: EstimateRequest) -> Result:
    """Estimate how long a print takes, by layer and by feature.

    ffcomp plans the print as the firmware does and adds up the time. Heating, homing and macros are listed but not
    included, because no file contains their duration. A compensated print gets a time with and without compensation.

    Example: ffcomp estimate sample_prints/ringing_tower.gcode --machine mp-delta-pro
    """
    from ffcomp.api.estimation import estimate_request

    return estimate_request(request)
