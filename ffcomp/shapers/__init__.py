"""Input shapers, the baselines of every firmware: a few pulses, or a kernel, that let a vibration cancel itself.

The planned Cartesian path is convolved with them, x_s(t) = Σ A_i x(t - (T_i - T̄)) with T̄ = Σ A_i T_i,
and only then turned into carriage paths, as Klipper does on a delta: taking T̄ off leaves no delay at
constant speed, so a `Shaper` holds the times with T̄ taken off already.
"""

from ffcomp.shapers.apply import dominant_frequencies, shape
from ffcomp.shapers.pulses import DAMPING_RATIO, SHAPERS, Shaper, residual_vibration

__all__ = ["DAMPING_RATIO", "SHAPERS", "Shaper", "dominant_frequencies", "residual_vibration", "shape"]
