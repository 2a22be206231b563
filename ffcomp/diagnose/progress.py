"""The stages of a search for effects."""

from __future__ import annotations

from ffcomp.numerics.stages import Now, Progress, Stage

__all__ = ["STAGES", "USUAL_S", "Now", "Progress", "Stage"]

USUAL_S = (1.0, 15.0, 9.0, 11.0, 6.0, 4.0, 6.0)  # of CPU, in each stage of a search that finds one effect
STAGES = len(USUAL_S)
