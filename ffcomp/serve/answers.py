"""What a job found, as the page shows it: a sentence, facts, warnings; made of the JSON that the verbs print."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

Found = Mapping[str, Any]
Answer = dict[str, Any]


def answer_of(kind: str, found: Found) -> Answer:
    """Return what the page shows of one job.

    Returns
    -------
    dict
        `lead`, a sentence; `facts`, pairs of a name and a value; `warnings` and `to_do`, sentences; `machine`, whether
        the job has made a machine file that can be kept.
    """
    empty: Answer = {"lead": "", "facts": [], "warnings": [], "to_do": [], "machine": False}
    make = _ANSWERS.get(kind)
    return empty | (make(found) if make else {})


def _compensate(found: Found) -> Answer:
    if found.get("already"):
        return {"lead": str(found["already"])}
    if "prints" in found and "print_time_s" not in found:
        return {"lead": f"{len(found['prints'])} prints in one file are compensated."}
    assumed = (found.get("machine") or {}).get("assumed")
    warnings = [*([str(assumed)] if assumed else []), *map(str, found.get("warning_lines", []))]
    return {"lead": _error_sentence(found), "facts": _print_facts(found), "warnings": warnings}


def _error_sentence(found: Found) -> str:
    predicted = found.get("predicted") or {}
    before, after = (predicted.get(name) for name in ("uncompensated", "compensated"))
    if not before or not after or not after["contour_rms_um"]:
        return "The print is compensated."
    was, now = before["contour_rms_um"], after["contour_rms_um"]
    return (
        f"Contour error {was:.0f} → {now:.1f} µm rms, {was / now:.0f} times less: predicted with the machine "
        "file's own model."
    )


def _print_facts(found: Found) -> list[list[str]]:
    share = found.get("compensated_share") or {}
    facts = [["Print time", f"{clock(found['print_time_s'])}, was {clock(found['original_print_time_s'])}"]]
    if predicted := (found.get("predicted") or {}).get("compensated"):
        facts.append(["99 % of it within", f"{predicted['contour_p99_um']:.1f} µm"])
    if "path" in share:
        facts.append(["Compensated", f"{100 * share['path']:.1f} % of the path"])
    facts += [[name, str(found[key])] for name, key in (("Firmware", "flavor"),) if key in found]
    if "offset_reason" in found:
        facts.append(["Place", str(found["offset_reason"])])
    if "compute_time_s" in found:
        facts.append(["Took", clock(found["compute_time_s"])])
    return facts


def _compare(found: Found) -> Answer:
    methods = found["methods"]
    own, best = methods[found["ours"]], methods[found["best_fixed"]]
    errors = [
        ["No compensation", f"{methods['none']['contour_rms_um']:.0f} µm rms"],
        [f"Best input shaper ({best['label']})", f"{best['contour_rms_um']:.1f} µm rms"],
        ["ffcomp", f"{own['contour_rms_um']:.1f} µm rms"],
    ]
    times = best["contour_rms_um"] / max(own["contour_rms_um"], 1e-9)
    lead = f"ffcomp leaves {times:.1f} times less contour error than the best input shaper, on the simulated printer."
    return {"lead": lead, "facts": [*errors, ["Evaluated", str(found["sampling"])]], "warnings": own["warnings"]}


def _plan(found: Found) -> Answer:
    repeats = f", each made {found['repeats']} times" if "repeats" in found else ""
    lead = f"{len(found['experiments'])} experiments, {clock(found['duration_s'])}{repeats}."
    facts = [["Firmware", str(found["flavor"])]]
    if "captures" in found:
        facts.append(["Captures", f"{len(found['captures'])} files will be written"])
    to_do = [
        "Put the accelerometer on the nozzle holder and nothing on the bed, heaters off; print moves.gcode, and stay "
        "beside it.",
        "Drop the captures that it writes (on Klipper: /tmp/*.csv on the printer's computer) at step 2.",
        *map(str, found.get("restores", [])),
    ]
    return {"lead": lead, "facts": facts, "warnings": list(found["warnings"]), "to_do": to_do}


def _diagnose(found: Found) -> Answer:
    said = [str(each) for each in found["said"]]
    gap = found["gap"]
    facts = [
        ["Disagreement before", f"{100 * gap['before']:.0f} %"],
        ["after", f"{100 * gap['after']:.0f} %"],
        ["of noise alone", f"{100 * gap['noise']:.0f} %"],
    ]
    if gain := found.get("print_gain"):
        facts.append(
            ["A sample print", f"{gain['before_um']:.0f} → {gain['after_um']:.0f} µm rms with the better file"]
        )
    return {
        "lead": said[0] if said else "",
        "facts": facts,
        "warnings": said[1:],
        "to_do": list(found["to_do"]),
        "machine": bool(found["machine"]),
    }


def _fit(found: Found) -> Answer:
    numbers = [
        [key, _interval(each)] for key, each in (found.get("numbers") or {}).items() if isinstance(each, Mapping)
    ]
    axes = [fact for axis, each in (found.get("axes") or {}).items() for fact in _axis_facts(axis, each)]
    lead = "The machine file is fitted to the measurements." if found["output"] else "Nothing could be fitted."
    warnings = [*map(str, found["skipped"]), *map(str, found["advice"])]
    return {"lead": lead, "facts": numbers + axes, "warnings": warnings, "machine": bool(found["output"])}


def _axis_facts(axis: str, found: Found) -> list[list[str]]:
    modes = [
        [f"{axis} axis", f"{_interval(mode['frequency_hz'])} Hz, damping ratio {_interval(mode['damping_ratio'])}"]
        for mode in found.get("modes", [])
    ]
    return [*modes, [f"{axis} axis", str(found.get("verdict", ""))]]


def _interval(estimate: Found) -> str:
    value, low, high = (estimate.get(name) for name in ("value", "low", "high"))
    if not all(isinstance(each, int | float) for each in (value, low, high)):
        return str(value)
    return f"{value:.4g} ({low:.4g} to {high:.4g})"


def _import(found: Found) -> Answer:
    if "values" not in found:  # a machine file that was checked
        return {"lead": f"{found['machine']['name']} can be used.", "warnings": list(found.get("notes", []))}
    origins = [each["how"] for each in found["values"].values()]
    assumed = origins.count("assumed")
    lead = f"{found['name']}: a {found['kinematics']} machine, from a {found['firmware']} configuration."
    facts = [["From the configuration", f"{len(origins) - assumed} values"], ["Assumed", f"{assumed} values"]]
    warnings = [f"{key} is missing: {why}" for key, why in found["missing"].items()]
    if assumed:
        like = f" as of {found['like']}" if found["like"] else ""
        warnings.append(f"How it vibrates is assumed{like}: no configuration tells it. Measure, under Measure.")
    return {"lead": lead, "facts": facts, "warnings": [*warnings, *map(str, found["notes"])]}


_ANSWERS: dict[str, Callable[[Found], Answer]] = {
    "compensate": _compensate,
    "compare": _compare,
    "plan": _plan,
    "excite": _plan,
    "diagnose": _diagnose,
    "fit": _fit,
    "import": _import,
}


def clock(seconds: float) -> str:
    """Return a duration as people say it."""
    if seconds < 60.0:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s"
