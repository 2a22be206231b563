"""Varied prints, sliced here: `python -m validation.sliced FOLDER` (needs prusa-slicer).

Shapes are made as triangles, sliced with options as different as people's profiles are, and left in FOLDER. Which
options: `PRINTS`; the command of each is printed.
"""

from __future__ import annotations

import argparse
import itertools
import shlex
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

BEDS = {f"{x}x{y}": f"0x0,{x}x0,{x}x{y},0x{y}" for x, y in ((250, 210), (220, 220), (300, 300))}
BEDS["round"] = ",".join(f"{85 * np.cos(a):.2f}x{85 * np.sin(a):.2f}" for a in 2 * np.pi * np.arange(48) / 48)
KLIPPER = "--start-gcode=PRINT_START BED=60 EXTRUDER=210\nSET_VELOCITY_LIMIT ACCEL=3000"  # this slicer knows no Klipper
RELATIVE = "--use-relative-e-distances --layer-gcode=G92\\ E0"


@dataclass(frozen=True, slots=True)
class Print:
    """A shape and how it is sliced."""

    about: str
    shapes: tuple[str, ...]
    bed: str
    options: str
    more: tuple[str, ...] = ()


PRINTS = {
    "mk3s_twist": Print(
        "Marlin with the machine's limits at its head, absolute E, a twisted prism",
        ("twist",),
        "250x210",
        "--gcode-flavor=marlin --machine-limits-usage=emit_to_gcode --machine-max-acceleration-x=1000,960 "
        "--machine-max-feedrate-x=200,100 --retract-lift=0.6",
    ),
    "ender3_gear": Print(
        "Marlin 2, relative E, many short moves, wipe while retracting",
        ("gear",),
        "220x220",
        f"--gcode-flavor=marlin2 {RELATIVE} --wipe --default-acceleration=500 --perimeter-acceleration=300",
    ),
    "voron_parts": Print(
        "Klipper, three parts with z-hop and wipe between them, labelled",
        ("gear", "star", "box"),
        "300x300",
        f"--gcode-flavor=marlin {RELATIVE} --retract-lift=0.2 --wipe --gcode-label-objects --perimeter-speed=150 "
        "--travel-speed=300",
        (KLIPPER,),
    ),
    "kossel_vase": Print(
        "Klipper on a delta, one spiral",
        ("vase",),
        "round",
        "--gcode-flavor=repetier --spiral-vase --center=0,0 --top-solid-layers=0 --fill-density=0 --perimeters=1",
        (KLIPPER,),
    ),
    "kossel_hops": Print(
        "Klipper on a delta, two parts with z-hop of 0.6 mm, wipe and 60 mm/s retraction",
        ("star", "box"),
        "round",
        f"--gcode-flavor=reprap {RELATIVE} --retract-lift=0.6 --wipe --retract-speed=60 --center=0,0",
        (KLIPPER,),
    ),
    "rrf_star": Print(
        "RepRapFirmware, relative E, a brim",
        ("star",),
        "300x300",
        f"--gcode-flavor=reprapfirmware {RELATIVE} --brim-width=4 --perimeter-speed=120",
    ),
    "smoothie_box": Print(
        "Smoothieware, absolute E, comments on every line",
        ("box",),
        "220x220",
        "--gcode-flavor=smoothie --gcode-comments --retract-lift=0.3",
    ),
}


def _prism(outline: FloatArray, height: float, layers: int = 1, turn: float = 0.0, grow: float = 0.0) -> FloatArray:
    """Triangles (n, 3, 3) between outlines (m, 2) that turn and grow with height; the outline sees its middle."""
    rings = []
    for k in range(layers + 1):
        share = k / layers
        c, s = np.cos(turn * share), np.sin(turn * share)
        bulge = 1.0 + grow * np.sin(np.pi * share)
        flat = bulge * outline @ np.array([[c, s], [-s, c]])
        rings.append(np.column_stack([flat, np.full(len(flat), height * share)]))
    sides = []
    for low, high in itertools.pairwise(rings):
        a, b, c3, d = low, np.roll(low, -1, axis=0), high, np.roll(high, -1, axis=0)
        sides += [np.stack([a, b, d], axis=1), np.stack([a, d, c3], axis=1)]
    bottom, top = rings[0], rings[-1]
    floor = np.stack([np.roll(bottom, -1, axis=0), bottom, np.broadcast_to(bottom.mean(axis=0), bottom.shape)], axis=1)
    lid = np.stack([top, np.roll(top, -1, axis=0), np.broadcast_to(top.mean(axis=0), top.shape)], axis=1)
    return np.concatenate([*sides, floor, lid])


def _polar(radius: FloatArray) -> FloatArray:
    angle = 2 * np.pi * np.arange(len(radius)) / len(radius)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


def shape(name: str) -> FloatArray:
    """Triangles (n, 3, 3) mm of a shape."""
    angle = 2 * np.pi * np.arange(240) / 240
    if name == "gear":
        return _prism(_polar(14.0 + np.clip(6.0 * np.sin(16 * angle), -1.2, 1.2)), 4.0)
    if name == "star":
        return _prism(_polar(np.tile([18.0, 8.0], 7)), 4.0)
    if name == "twist":
        return _prism(_polar(16.0 + 3.0 * np.cos(5 * angle)), 10.0, 40, np.pi / 3)
    if name == "vase":
        return _prism(_polar(22.0 + 2.0 * np.cos(9 * angle)), 14.0, 40, np.pi / 4, 0.25)
    return _prism(np.array([[-12.0, -8.0], [12.0, -8.0], [12.0, 8.0], [-12.0, 8.0]]), 6.0)


def write_stl(path: Path, triangles: FloatArray) -> None:
    """Write triangles as a binary STL file."""
    rows = np.zeros(len(triangles), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
    rows["corners"] = triangles
    path.write_bytes(b"\0" * 80 + len(triangles).to_bytes(4, "little") + rows.tobytes())


def command_of(name: str, folder: Path) -> list[str]:
    """Return the command that slices a print into a folder."""
    each = PRINTS[name]
    stls = [str(folder / f"{shape}.stl") for shape in each.shapes]
    common = ["--nozzle-diameter=0.4", "--filament-diameter=1.75", "--first-layer-height=0.2", "--layer-height=0.2"]
    merge = ["--merge"] if len(stls) > 1 else []
    options = [*common, *merge, f"--bed-shape={BEDS[each.bed]}", *shlex.split(each.options), *each.more]
    return ["prusa-slicer", "--export-gcode", *options, "-o", str(folder / f"{name}.gcode"), *stls]


def main() -> None:
    """Slice all, or those that are named."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("prints", nargs="*", metavar="PRINT", help=", ".join(PRINTS))
    asked = parser.parse_args()
    if not shutil.which("prusa-slicer"):
        raise SystemExit("prusa-slicer is not installed.")
    asked.folder.mkdir(parents=True, exist_ok=True)
    for name in {each for made in PRINTS.values() for each in made.shapes}:
        write_stl(asked.folder / f"{name}.stl", shape(name))
    for name in asked.prints or PRINTS:
        command = command_of(name, asked.folder)
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        print(shlex.join(command), done.stderr.strip() if done.returncode else "", sep="\n", flush=True)


if __name__ == "__main__":
    main()
