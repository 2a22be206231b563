"""`identify scan` on one page: pictures -> the page in them -> centre lines -> the fit -> a machine file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ffcomp.errors import MeasurementError, RequestError
from ffcomp.identification.machine_fit import MachineFit, Origin, hash_of, number_facts
from ffcomp.identification.page.fit import SAME_RING, SCALE, STRONG, PageFit, fit_page, machine_unknowns
from ffcomp.identification.page.lines import read_lines
from ffcomp.identification.page.picture import find_page, read_picture
from ffcomp.identification.request import ScanRequest
from ffcomp.identification.uncertainty import Estimate
from ffcomp.numerics.serialise import keys
from ffcomp.numerics.stages import Stage
from ffcomp.record.plan import Page, Plan, load_plan
from ffcomp.result import Fact
from ffcomp.shapers.calibration import shaper_advice
from models.file import machine_of_text
from models.machine import Machine

FAR = 2.5  # of a prior's standard deviations
USUAL_S = (4.0, 4.0, 12.0)  # of CPU: reading, where to begin, the fit


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class ScanFit(MachineFit):
    """A machine's numbers from pictures of a page that it drew."""

    method = "scan"
    schema = "ffcomp-identify-scan/1"
    json_keys = MachineFit.json_keys | keys(
        "noise_um",
        numbers="result.estimates",
        kept="result.kept",
        places="result.places",
        bead="result.bead",
        explained="result.explained",
        lines="result.count",
    )

    result: PageFit

    @property
    def noise_um(self) -> float:
        """Roughness of the typical line."""
        return 1e3 * self.result.rough_mm

    @property
    def headline(self) -> str:
        """How much of the lines' waves the machine explains."""
        return (
            f"The machine explains {100 * self.result.explained:.0f} % of the waves of {len(self.result.lines)} lines, "
            f"which are rough by {self.noise_um:.0f} µm."
        )

    @property
    def found(self) -> list[Fact]:
        """Modes at each place, and every parameter."""
        fit, facts = self.result, list[Fact]()
        if self.origin.start.vibration.position_dependent:
            for place in fit.places:
                x, y = place.position_mm
                words = "; ".join(f"{mode.frequency_hz} Hz, ζ {mode.damping_ratio}" for mode in place.modes)
                facts.append((f"at {x:.0f}, {y:.0f} mm", words))
        facts += number_facts(fit.estimates)
        return [*facts, ("Friction", "dry friction of the guides is in the file too")] if fit.friction else facts


def fit_pictures(start: Machine, request: ScanRequest, progress: Callable[[str], None] = lambda _: None) -> ScanFit:
    """Fit a machine file's numbers to pictures of the page of a plan.

    Raises RequestError for a plan of another machine, or one that is no page; MeasurementError for a picture that
    cannot be used; each sentence says what to do.
    """
    plan = load_plan(request.plan)
    page = _checked(start, plan, request)
    sights = []
    for path in request.pictures:
        progress(Stage(1, f"reading {path.name}"))
        sights.append(find_page(read_picture(path), plan))
    lines = read_lines(sights, plan)
    result = fit_page(start, lines, page.line_width_mm, progress)
    hashes = [hash_of(path) for path in request.pictures]
    name = request.name or (request.output.stem if request.output is not None else f"{Path(start.path).stem}-scanned")
    origin = Origin(start, name, hashes)
    text = _file_text(origin, result)
    fit = ScanFit(origin=origin, text=text, advice=_advice(start, result), result=result)
    return replace(fit, shapers=tuple(shaper_advice(machine_of_text(text, name))))


def _file_text(origin: Origin, result: PageFit) -> str:
    """Write the file of the numbers that a picture of a page gives."""
    parameters: dict[str, Estimate | list[Estimate]] = {**result.estimates}
    others: dict[str, Any] = {f"effects.coulomb_friction.{key}": value for key, value in result.friction.items()}
    notes = dict[str, str]()
    for key in (f"axes.{axis}" for axis in result.second):
        for kind in ("frequency_hz", "damping_ratio"):
            names = (f"{key}.{kind}[{i}]" for i in range(2))
            parameters[f"{key}.{kind}"] = [result.estimates[name] for name in names if parameters.pop(name)]
        del parameters[f"{key}.share[1]"]
        share = result.estimates[f"{key}.share[1]"]
        others[f"{key}.share"] = [round(1.0 - share.value, 3), round(share.value, 3)]
        notes[f"{key}.share"] = origin.note([share], "scan")
    return origin.text_of(
        parameters,
        "scan",
        others,
        notes,
        lines=len(result.lines),
        explained_share=float(f"{result.explained:.3g}"),
        hardly_determined=list(result.kept),
    )


def _checked(start: Machine, plan: Plan, request: ScanRequest) -> Page:
    if plan.page is None:
        raise MeasurementError(
            str(request.plan), ["This is no plan of a page: ffcomp record plan --for scan makes one."]
        )
    if plan.machine != start.name and plan.machine_sha256 != start.sha256:
        raise RequestError(
            f"The page of {request.plan} is for {plan.machine!r}, and -m {request.machine} is {start.name!r}: give the "
            "machine that the page was planned for."
        )
    return plan.page


def _advice(start: Machine, result: PageFit) -> list[str]:
    sentences = list(result.doubts)
    if start.vibration.position_dependent:
        sentences.append(
            f"A picture shows ratios of masses, stiffnesses and dampings, not their scale: {SCALE} is unchanged. "
            "A compensation does not need it."
        )
    far = [
        each.name
        for each in machine_unknowns(start)
        if each.name not in result.kept and abs(np.log(result.estimates[each.name].value / each.start)) > FAR * each.sd
    ]
    if far:
        sentences.append(
            f"{', '.join(far)}: further from the starting file's than it says that it knows them. A page cannot tell "
            "another printer of the same kind: check that the file, the G-code and the page are of one printer."
        )
    if result.kept:
        sentences.append(
            f"The picture hardly determines {', '.join(result.kept)}: their intervals are nearly the starting file's."
        )
    for axis in "xy":
        ring, share = result.bead[f"ring_{axis}"], result.bead.get(f"second_{axis}")
        if share is not None and axis not in result.second:
            ring = Estimate(1.0 + share.value, share.sd, 1.0 + share.low, 1.0 + share.high)
        if ring.low > 1.0 + STRONG or ring.high < SAME_RING:
            sentences.append(
                f"{axis} rings {ring.value:.2f} times ({ring.low:.2f} to {ring.high:.2f}) as much as the file's modes "
                "would: it has another, quicker mode, which is strong and hardly shows on the page. Measure it with an "
                "accelerometer on the nozzle (ffcomp identify fit)."
            )
    return sentences
