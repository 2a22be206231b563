"""Axes whose effect is published: EMPS and Silverbox.

EMPS (A. Janot, M. Gautier and M. Brunot, 2019) and Silverbox (T. Wigren and J. Schoukens, 2013) are measured; fetch
them from nonlinearbenchmark.org into `emps` and `silverbox` of $FFCOMP_DATA. They are not shipped.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ffcomp.errors import MeasurementError
from models.arrays import FloatArray
from tests.support.data import DATA

EMPS_FILES = {"plain": "DATA_EMPS.mat", "pulses": "DATA_EMPS_PULSES.mat"}

SILVERBOX_HZ = 610.35
# NOTE: only ratios of its volts mean something; with these units the numbers look like an axis
NEWTONS_A_VOLT, MM_A_VOLT = 1000.0, 1.0
REALISATION, BEFORE = 8192, 40700  # samples of a multisine, of which ten follow the growing sweep
PARTS = 3  # multisines that are taken

FILE = """# {about}
format = "ffcomp-machine/1"
name = "{name}"

[kinematics]
type = "axis"

[axis]
input = "force"
mass_kg = {mass}
stiffness_n_per_m = {stiffness}
damping_n_s_per_m = {damping}

[uncertainty]
"axis.mass_kg" = {sure[0]}
"axis.stiffness_n_per_m" = {sure[1]}
"axis.damping_n_s_per_m" = {sure[2]}
"""


def emps(folder: Path) -> list[Path]:
    """Write EMPS: motor voltage times gain is the force, `qm` the measured position; the file's guesses are rough.

    NOTE: the file with pulses holds them once more as `pulses_N`. They are in `vir` already, and in volts: `vir` jumps
    by 5 V where they do, and regressing gain · vir on mass, frictions, offset and `pulses_N` gives the last a factor
    of -0.03 to -0.07. Added as a force they would be half the time a force that did not act.
    """
    from scipy.io import loadmat

    about = "EMPS, with rough guesses: Janot, Gautier and Brunot, Nonlinear System Identification Benchmarks, 2019"
    text = FILE.format(about=about, name="emps", mass=50.0, stiffness=0.0, damping=100.0, sure=(0.5, 0.5, 1.0))
    written = [_file(folder, "emps", text)]
    for part, name in EMPS_FILES.items():
        path = DATA / "emps" / name
        variables = loadmat(path)
        missing = [key for key in ("t", "vir", "qm", "gtau") if key not in variables]
        if missing:
            raise MeasurementError(str(path), [f"The variable {missing[0]!r} is missing; an EMPS file has it."])
        t, voltage, q = (np.asarray(variables[key], dtype=float).ravel() for key in ("t", "vir", "qm"))
        force = float(variables["gtau"].ravel()[0]) * voltage
        written.append(_run(folder / f"emps-{part}.csv", t, force, 1e3 * q))
    return written


def silverbox(folder: Path) -> list[Path]:
    """Write Silverbox, an electronic mass on a spring that hardens: some of its multisines, in units of our own."""
    volts = np.genfromtxt(DATA / "silverbox" / "SNLS80mV.csv", delimiter=",", skip_header=1)[:, :2]
    about = "Silverbox, with rough guesses, 1 V in = 1 kN and 1 V out = 1 mm: Wigren and Schoukens, 2013"
    text = FILE.format(about=about, name="silverbox", mass=5.0, stiffness=1e6, damping=200.0, sure=(0.2, 0.2, 0.5))
    written = [_file(folder, "silverbox", text)]
    for k in range(PARTS):
        part = volts[BEFORE + k * (REALISATION + 500) :][:REALISATION] - volts.mean(axis=0)
        t = np.arange(len(part)) / SILVERBOX_HZ
        path = folder / f"silverbox-multisine{'abc'[k]}.csv"
        written.append(_run(path, t, NEWTONS_A_VOLT * part[:, 0], MM_A_VOLT * part[:, 1]))
    return written


def _file(folder: Path, name: str, text: str) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.toml"
    path.write_text(text, encoding="utf-8")
    return path


def _run(path: Path, t: FloatArray, force_n: FloatArray, position_mm: FloatArray) -> Path:
    table = np.column_stack([t, force_n, position_mm])
    np.savetxt(path, table, delimiter=",", header="t_s,force_n,pos_q_mm", comments="", fmt="%.9g")
    return path
