"""For all tests: runs of the command line leave the user's log and cache alone."""

from __future__ import annotations

import os

os.environ["FFCOMP_LOG"] = "off"
os.environ["FFCOMP_CACHE"] = "off"
