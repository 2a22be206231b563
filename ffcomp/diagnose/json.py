"""Write a diagnosis as the JSON object of `ffcomp diagnose`."""

from __future__ import annotations

from typing import Any

from ffcomp.diagnose.print_gain import PrintGain
from ffcomp.diagnose.result import DiagnosisResult
from ffcomp.diagnose.sentences import said
from ffcomp.diagnose.what_to_do import what_to_do


def diagnosis_json(
    found: DiagnosisResult, written: str | None, report: str | None, seconds: float, gain: PrintGain | None = None
) -> dict[str, Any]:
    """Return the JSON object ffcomp-diagnose/1.

    written, report : paths of the machine file and of the page; None: not written
    seconds : that the diagnosis took
    gain : of prints by the better file; None: not predicted
    """
    named = found.effects if found.verdict == "effects" else {}
    return {
        "schema": "ffcomp-diagnose/1",
        "verdict": found.verdict,
        "finding": found.finding,
        "said": said(found),
        "effects": [
            {
                "name": name,
                "parameters": found.parameters(name),
                "confidence": found.confidence[name],
                "evidence": found.gained,
            }
            for name in named
        ],
        "refused": {"effects": list(found.effects), "because": list(found.rejections)} if found.rejections else None,
        "invisible": list(found.invisible),
        "retuned": {key: {"from": a, "to": b} for key, (a, b) in found.retuned.items()},
        "separate": [each.to_dict() for each in found.separations],
        "confusable_with": [{"name": name, "separate_by": how} for name, how in found.confounded_with],
        "late_s": dict(found.late_s),
        "left_out": found.left_out,
        "unproven_at": list(found.unproven),
        "or_file_off": {key: {"from": a, "to": b} for key, (a, b) in found.file_off.items()},
        "cut_short": found.cut_short,
        "to_do": what_to_do(found),
        "print_gain": None if gain is None else gain.to_dict(),
        "gap": {
            "before": found.before.nrms,
            "after": found.after.nrms,
            "noise": found.before.noise_nrms,
            "held_out": {"before": found.held_out[0], "after": found.held_out[1], "noise": found.before.noise_nrms},
        },
        "machine": written,
        "report": report,
        "seconds": seconds,
    }
