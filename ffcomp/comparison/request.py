"""The request of `compare`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from ffcomp.errors import RequestError
from ffcomp.options import FLAVOR, MACHINE_NAME, OFFSET, PLANT, PLATE, SEGMENT_RATE, Offset
from ffcomp.request import ACCURACY, SPEED, Argument, MachineLike, Option, Request, silent

Layers = tuple[int, int | None]


def parse_share(text: str) -> float:
    """Read `10%` or `0.1`."""
    try:
        return float(text[:-1]) / 100 if text.endswith("%") else float(text)
    except ValueError:
        raise RequestError(f"{text!r}: a share such as 10% or 0.1.") from None


def parse_layers(text: str) -> Layers:
    """Read `10:20`, `5:`, `:3` or `7`."""
    first, colon, last = text.partition(":")
    try:
        begin = int(first) if first else 0
        return begin, (int(last) if last else None) if colon else (begin if text else None)
    except ValueError:
        raise RequestError(f"--layers {text!r}: two layer numbers with a colon between them, e.g. 10:20.") from None


@dataclass(frozen=True)
class CompareRequest(Request):
    """A print on which all methods are compared."""

    file: Annotated[str | Path, Argument("Sliced print. It is only read.", metavar="FILE")]
    machine: Annotated[MachineLike, MACHINE_NAME]
    plant: Annotated[MachineLike | None, PLANT] = None
    layers: Annotated[
        Layers,
        Option(
            "Evaluate these layers only, counted from 0, both included: 10:20, 5:, :3.",
            SPEED,
            metavar="FIRST:LAST",
            parse=parse_layers,
        ),
    ] = (0, None)
    sample: Annotated[
        float | None,
        Option(
            "Evaluate this share of the time, in evenly spread slices, e.g. 5%. Default: 2 minutes at most.",
            SPEED,
            metavar="SHARE",
            parse=parse_share,
            label="Comparison: share of the print, e.g. 10%",
        ),
    ] = None
    quality_um: Annotated[
        float,
        Option(
            "Find the highest acceleration that keeps 99 % of each method's contour error below this. 0: skip.",
            ACCURACY,
            metavar="UM",
            low=0.0,
        ),
    ] = 25.0
    only: Annotated[
        tuple[str, ...],
        Option(
            "Evaluate only these methods, besides none and ffcomp: mzv,ei-calibrated. Shapers: zv, mzv, zvd, ei, "
            "2hump_ei, 3hump_ei, and, compared only when named, zvdd, zvddd (Marlin), smooth_zv, smooth_mzv, "
            "smooth_ei, smooth_2hump_ei, smooth_zvd_ei, smooth_si (Kalico's other branches); each also with "
            "-z (z shaped too), and each of these with -calibrated; fbs-lti, fbs-robust; all.",
            SPEED,
            metavar="NAMES",
            parse=lambda text: tuple(filter(None, text.split(","))),
            label="Comparison: methods",
        ),
    ] = ()
    offset_mm: Annotated[Offset | None, OFFSET] = None
    flavor: Annotated[str, FLAVOR] = ""
    max_segments_per_second: Annotated[float, SEGMENT_RATE] = 250.0
    plate: Annotated[int | None, PLATE] = None
    progress: Annotated[
        Callable[[str, float], None], "Called with the current step and the share of all that is done."
    ] = silent

    def check(self) -> None:
        """Check shares and layers."""
        if self.sample is not None and not 0.0 < self.sample <= 1.0:
            raise RequestError(f"--sample {100 * self.sample:g}%: a share above 0 and up to 100%.")
        first, last = self.layers
        if first < 0 or (last is not None and last < first):
            layers = f"{first}:{'' if last is None else last}"
            raise RequestError(f"--layers {layers}: the first layer is 0, and the last must not be before the first.")
