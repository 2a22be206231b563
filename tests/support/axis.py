"""An axis by itself that has friction, and the file of one that has none."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from models.effects.catalogue import with_effects
from models.file import load_plant
from models.printer.one_axis import simulate_axis

RATE = 400.0
FILE = """
format = "ffcomp-machine/1"
name = "slide"
[kinematics]
type = "axis"
[axis]
input = "force"
mass_kg = 10.0
stiffness_n_per_m = 0.0
damping_n_s_per_m = 30.0
"""


def write_axis(folder: Path) -> list[Path]:
    """Write slide.toml, which knows of no friction, and two repeats of one motion of a slide that has some."""
    (folder / "slide.toml").write_text(FILE)
    rng = np.random.default_rng(8)
    t = np.arange(1200) / RATE
    force = 15.0 * np.interp(t, np.linspace(0, t[-1], 16), rng.normal(size=16))
    true = with_effects(load_plant(folder / "slide.toml"), {"coulomb_friction": {"force_n": 4.0}})  # type: ignore[arg-type]
    motion = simulate_axis(true, force, 1 / RATE)
    paths = [folder / f"push-{k}.csv" for k in (1, 2)]
    for path in paths:
        noisy = motion.position_mm + 1e-4 * rng.normal(size=len(t))
        np.savetxt(path, np.column_stack([t, force, noisy]), delimiter=",", header="t_s,force_n,pos_q_mm", comments="")
    return paths
