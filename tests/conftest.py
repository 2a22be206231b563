"""For all tests: runs of the command line leave the user's log and cache alone, and everybody tries the same examples.

Properties are tried on the same draws each time, so that a change is judged by what it changes. New draws are sought by
`validation/fuzz.py`, and here with HYPOTHESIS_PROFILE=default.
"""

from __future__ import annotations

import os

from hypothesis import settings

os.environ["FFCOMP_LOG"] = "off"
os.environ["FFCOMP_CACHE"] = "off"

settings.register_profile("same", derandomize=True)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "same"))
