"""For all tests: runs of the command line leave the user's log alone."""

from __future__ import annotations

import os

os.environ["FFCOMP_LOG"] = "off"
