"""The figures of benchmarks/PERFORMANCE.md, from the numbers that `performance.py` keeps."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.performance_page import AIM_MEMORY_MB, Numbers, stage_order
from benchmarks.performance_prints import LARGEST, REPEATED

BLUE, ORANGE, GREY = "#0072b2", "#d55e00", "#8a8f98"
DPI = 100


def draw(found: Numbers, folder: Path) -> None:
    for name, figure in FIGURES.items():
        if name in found:
            figure(found[name], folder)


def _figure(width: float, height: float) -> tuple[Any, Any]:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(width, height), dpi=DPI, constrained_layout=True)
    axes.grid(visible=True, which="major", color="#e4e6ea", linewidth=0.7)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    return figure, axes


def _saved(figure: Any, path: Path) -> None:
    from matplotlib import pyplot as plt

    figure.savefig(path, metadata={"Software": None})
    plt.close(figure)


def draw_lengths(found: Numbers, folder: Path) -> None:
    figure, axes = _figure(7.2, 3.6)
    prints = found["prints"]
    for name, colour in ((REPEATED, BLUE), (LARGEST, ORANGE)):
        mine = [r for label, r in prints.items() if label.startswith(name)]
        x = [r["print_s"] for r in mine]
        axes.loglog(x, [r["cpu_s"] for r in mine], "o-", color=colour, label=f"{name}, CPU s")
        axes.loglog(x, [r["peak_mb"] for r in mine], "s--", color=colour, alpha=0.6, label=f"{name}, memory MB")
    lengths = [r["print_s"] for r in prints.values()]
    span = np.array([min(lengths), max(lengths)])
    line = span / found["print_s_per_s"]
    axes.loglog(span, line, color=GREY, linewidth=1, label=f"{found['print_s_per_s']:.0f} print-seconds a second")
    axes.axhline(AIM_MEMORY_MB, color=GREY, linestyle=":", linewidth=1)
    axes.text(span[0], AIM_MEMORY_MB * 1.1, f"{AIM_MEMORY_MB:g} MB", color=GREY, fontsize=8)
    axes.set_xlabel("length of the print, s")
    axes.set_title(f"Time grows with the power {found['exponent']:.2f} of the length, memory not at all", fontsize=10)
    axes.legend(fontsize=8, frameon=False)
    _saved(figure, folder / "performance_length.png")


def draw_place(found: Numbers, folder: Path) -> None:
    figure, axes = _figure(7.2, 2.8)
    axes.semilogy(found["radius_mm"], found["ours_us"], "o-", color=BLUE)
    axes.set_ylim(1, 10)
    axes.set_xlabel("distance from the bed's middle, mm")
    axes.set_ylabel("µs a segment")
    axes.set_title("What a segment costs does not depend on the place", fontsize=10)
    _saved(figure, folder / "performance_place.png")


def draw_stages(found: Numbers, folder: Path) -> None:
    stages = found["stages"]
    order = stage_order(stages)
    figure, axes = _figure(7.2, 3.4)
    from matplotlib import colormaps

    colours = [colormaps["tab20"](k / 19) for k in range(len(order))]
    left = np.zeros(len(stages))
    for stage, colour in zip(order, colours, strict=True):
        us = np.array([1e6 * each["seconds"].get(stage, 0.0) / each["segments"] for each in stages.values()])
        axes.barh(list(stages), us, left=left, color=colour, label=stage)
        left += us
    axes.set_xlabel("µs of CPU time for each segment written")
    axes.set_title("A whole job by stage: no stage dominates", fontsize=10)
    axes.legend(fontsize=7, frameon=False, ncols=4, loc="upper center", bbox_to_anchor=(0.45, -0.2))
    _saved(figure, folder / "performance_stages.png")


FIGURES: Mapping[str, Callable[[Numbers, Path], None]] = {
    "lengths": draw_lengths,
    "place": draw_place,
    "where": draw_stages,
}
