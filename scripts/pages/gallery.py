"""The pictures of docs/TROUBLESHOOTING.md and of the pages to follow, good and bad.

    python -m scripts.pages.gallery --write [NAME ...]

The pages' own commands run first, so a reader who follows a page sees its picture. The bad ones add a fault: a machine
file that is 10 % off, limits that bind, noise, a mode in the wrong place.
"""

from __future__ import annotations

import os

from models.kinds import delta_vibration, with_parts

os.environ["OPENBLAS_NUM_THREADS"] = "1"
os.environ["FFCOMP_LOG"] = "off"

import argparse
import io
import re
import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from PIL import Image

from ffcomp.api.comparison import compare
from ffcomp.diagnosis.diagnosis import diagnose
from ffcomp.diagnosis.printer_problem import PrinterProblem
from ffcomp.diagnosis.result import DiagnosisResult
from ffcomp.diagnosis.where import overlays_of
from ffcomp.identification.predict import predicted
from ffcomp.measurement.frf import FrequencyResponse
from ffcomp.measurement.frf_files import write_frf
from ffcomp.measurement.recording import read_recording
from ffcomp.report.diagnose import overlay, splits
from ffcomp.report.drawing import Drawing, file_of, layout
from models.file import load_machine
from models.machine import Machine
from tests.support import docs_runner

GALLERY = docs_runner.ROOT / "docs" / "gallery"
DOCS = docs_runner.ROOT / "docs"
WIDTH_PX, LARGEST_BYTES = 1000, 100_000
COLOURS = (128, 96, 64, 48)  # the most that the size allows
ROWS = "mzv,ei,2hump_ei"
LIMIT_MM_PER_S2 = 2500.0  # of a carriage, for the picture of limits that bind
LINES_HZ = np.arange(2.0, 125.1, 0.5)
# What a tenth wrong is: softer belts and a heavier effector, both of which lower its resonances.
TENTH_OFF = {"belt_stiffness_n_per_m": 0.9, "nozzle_mass_kg": 1.1, "extruder_mass_kg": 1.1}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="into docs/gallery; else only the sizes are told")
    parser.add_argument("names", nargs="*", help=f"only these: {', '.join(MADE)}")
    asked = parser.parse_args()
    for name in asked.names or MADE:
        with tempfile.TemporaryDirectory() as folder:
            content = made(name, Path(folder))
        print(f"{name}: {len(content) / 1e3:.0f} kB")
        if asked.write:
            (GALLERY / f"{name}.png").write_bytes(content)


def made(name: str, folder: Path) -> bytes:
    """A picture, made in a folder of its own."""
    docs_runner.lay_out(folder)
    os.environ.update(docs_runner.environment(folder))
    os.chdir(folder)
    return small(MADE[name]())


def small(image: Image.Image) -> bytes:
    """A PNG of few colours, not wider than a page shows it."""
    if image.width > WIDTH_PX:
        image = image.resize((WIDTH_PX, round(image.height * WIDTH_PX / image.width)), Image.Resampling.LANCZOS)
    pictures = (_png(image.convert("RGB"), colours) for colours in COLOURS)
    return next(content for content in pictures if len(content) <= LARGEST_BYTES)


def _png(image: Image.Image, colours: int) -> bytes:
    file = io.BytesIO()
    few = image.quantize(colours, Image.Quantize.MAXCOVERAGE, kmeans=2, dither=Image.Dither.NONE)
    few.save(file, "PNG", optimize=True)
    return file.getvalue()


def ffcomp(*words: object) -> None:
    code, output = docs_runner.run_here([str(word) for word in words])
    assert code == 0, output


def follow(name: str, until: str = "") -> None:
    """Run a page's examples, all or those before the heading that begins so."""
    page = DOCS / f"{name}.md"
    lines = page.read_text(encoding="utf-8").splitlines()
    last = next((i for i, line in enumerate(lines) if until and line.startswith(until)), len(lines))
    for block in docs_runner.blocks_of(page):
        if block.is_example and block.line < last:
            docs_runner.run_block(block)


# ---- show ----------------------------------------------------------------------------------------


def show_good() -> Image.Image:
    follow("start/delta", until="## 5.")
    return Image.open("out.gcode.png")


def show_wrong_file() -> Image.Image:
    """Compensated with a file that is a tenth off, and shown on the printer as it is."""
    changed("tenth-off", TENTH_OFF)
    ffcomp("compensate", "print.gcode", "-m", "tenth-off.toml", "-o", "wrong.gcode", "--quiet")
    ffcomp("show", "wrong.gcode", "-m", "mp-delta-pro", "-o", "wrong.png")
    return Image.open("wrong.png")


def show_limits() -> Image.Image:
    """Carriages that may only accelerate a little: the print is slowed down."""
    changed("weak", {"carriage_acceleration_mm_per_s2": LIMIT_MM_PER_S2 / 30000.0})
    ffcomp("compensate", "print.gcode", "-m", "weak.toml", "-o", "limits.gcode", "--quiet")
    ffcomp("show", "limits.gcode", "-m", "weak.toml", "-o", "limits.png")
    return Image.open("limits.png")


def changed(name: str, factors: dict[str, float]) -> None:
    """NAME.toml: the library's machine with some numbers times a factor."""
    ffcomp("machines", "new", name, "--from", "mp-delta-pro", "-o", f"{name}.toml")
    path = Path(f"{name}.toml")
    text = path.read_text(encoding="utf-8")
    for key, factor in factors.items():
        text, count = re.subn(rf"^({key} = )(\S+)", partial(_times, factor=factor), text, flags=re.MULTILINE)
        assert count == 1, key
    path.write_text(text, encoding="utf-8")


def _times(match: re.Match[str], factor: float) -> str:
    return f"{match[1]}{factor * float(match[2]):.6g}"


# ---- compare -------------------------------------------------------------------------------------


def compared(name: str) -> Image.Image:
    found = compare("print.gcode", "mp-delta-pro", only=tuple(ROWS.split(",")), quality_um=0.0)
    found.write_figure("one.png", name)
    return Image.open("one.png")


# ---- frf -----------------------------------------------------------------------------------------


def frf_wrong_mode() -> Image.Image:
    """The printer's nozzle holder is twice as heavy as the file says."""
    machine = load_machine("mp-delta-pro")
    heavy = replace(
        delta_vibration(machine).effector, nozzle_mass_kg=2.0 * delta_vibration(machine).effector.nozzle_mass_kg
    )
    return measured_frf("wrong-mode", 0.03, with_parts(machine, effector=heavy))


def measured_frf(name: str, noise: float, real: Machine | None = None) -> Image.Image:
    """`ffcomp frf` with made-up measurements of a printer.

    noise : relative to each value, and as much of the median value
    real : the printer; None: as its file says
    """
    rng = np.random.default_rng(1)
    options: list[object] = []
    for letter in "ABC":
        nothing = np.zeros(len(LINES_HZ))
        asked = FrequencyResponse(
            f"cmd_{letter}", f"pos_{letter}", LINES_HZ, nothing.astype(complex), nothing, position_mm=(0.0, 0.0, 30.0)
        )
        value = predicted(real or load_machine("mp-delta-pro"), [asked])[0]
        spread = noise * np.hypot(np.abs(value), np.median(np.abs(value)))
        drawn = spread * (rng.normal(size=len(value)) + 1j * rng.normal(size=len(value))) / np.sqrt(2)
        write_frf(Path(f"{name}-{letter}.csv"), replace(asked, value=value + drawn))
        options += ["--measured", f"{name}-{letter}.csv"]
    ffcomp("frf", "-m", "mp-delta-pro", "--highest-hz", 125, *options, "--figure", f"{name}.png")
    return Image.open(f"{name}.png")


# ---- identify ------------------------------------------------------------------------------------


def fit_good() -> Image.Image:
    follow("MEASURE", until="## 4.")
    return Image.open("fit.png")


def fit_weak() -> Image.Image:
    """The same captures with eight times the noise, as of a sensor that hangs on tape."""
    follow("MEASURE", until="## 3.")
    rng = np.random.default_rng(2)
    captures = sorted(Path("captures").glob("*.csv"))
    for path in captures:
        rows = np.loadtxt(path, delimiter=",")
        rows[:, 1:] += 1200.0 * rng.normal(size=(len(rows), 3))
        np.savetxt(path, rows, "%.6f", ",", header="time,accel_x,accel_y,accel_z", comments="#")
    known = ("--known", "effector.total_mass_kg=0.600±0.002")
    options = ("--plan", "excite.json", "-m", "my-delta.toml", *known, "--figure", "weak.png", "--quiet")
    ffcomp("identify", "fit", *captures, *options)
    return Image.open("weak.png")


# ---- diagnose ------------------------------------------------------------------------------------


def diagnosis() -> Image.Image:
    """Where the gap is, by frequency, and one stretch of a run, before and after, as in the report."""
    follow("DIAGNOSE", until="## 2.")
    runs = [read_recording(path) for path in sorted(Path("runs").glob("*.csv"))]
    search = diagnose(PrinterProblem(load_machine("my-delta.toml"), runs))
    worst = overlays_of(search.estimation, search.final.values)[0]
    return side_by_side([overlay(worst), splits(DiagnosisResult(search=search))[0]])


def side_by_side(drawings: list[Drawing]) -> Image.Image:
    """Drawings of a page in one row, each with its title and what it says."""
    import textwrap

    import matplotlib
    from matplotlib.figure import Figure

    from ffcomp.report.drawing import RC

    with matplotlib.rc_context(RC):
        size = (sum(each.width for each in drawings), max(each.height for each in drawings) + 0.6)
        figure = Figure(figsize=size, layout=layout(), facecolor="#ffffff")
        widths = [each.width for each in drawings]
        boxes = figure.subfigures(1, len(drawings), squeeze=False, width_ratios=widths)
        for box, each in zip(boxes[0], drawings, strict=True):
            said = textwrap.fill(each.finding, 70)
            box.suptitle(f"{each.title}\n{said}", x=0.02, ha="left", fontsize=9)
            each.draw(box)
        return Image.open(io.BytesIO(file_of(figure, "png")))


MADE: dict[str, Callable[[], Image.Image]] = {
    **{each.__name__: each for each in (show_good, show_wrong_file, show_limits, frf_wrong_mode)},
    **{each.__name__: each for each in (fit_good, fit_weak, diagnosis)},
    **{f"compare_{name.replace('-', '_')}": partial(compared, name) for name in ("methods", "close-up")},
    **{f"frf_{name}": partial(measured_frf, name, noise) for name, noise in (("good", 0.03), ("noisy", 0.3))},
}

if __name__ == "__main__":
    main()
