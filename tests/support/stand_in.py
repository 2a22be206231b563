"""A stand-in for `python -m ffcomp` under `ffcomp serve`: it writes what the verbs write, at once."""

from __future__ import annotations

import base64
import json
import os
import sys
import time
from pathlib import Path
from typing import Any

LIBRARY = Path(__file__).parents[2] / "models" / "library"
PICTURE = b'<svg xmlns="http://www.w3.org/2000/svg" width="640" height="400"><rect width="9" height="9"/></svg>'
IMAGE = f'<img src="data:image/svg+xml;base64,{base64.b64encode(PICTURE).decode()}">'
RAN = "<script>document.body.dataset.ran = 'yes'</script>"
PAGE = f"<!doctype html><title>report</title><p id='it'>A report</p>{IMAGE}{RAN}"


def tell(stage: str, share: float | None = None, left_s: float | None = None) -> None:
    """Write an event as the verbs do."""
    with open(os.environ["FFCOMP_EVENTS"], "a", encoding="utf-8") as file:
        file.write(json.dumps({"stage": stage, "share": share, "left_s": left_s}) + "\n")


def answer(headline: str, facts: list[list[str]], warnings: list[str], next_steps: list[str]) -> dict[str, Any]:
    """Return what every verb's JSON holds of what it found."""
    return {"answer": {"headline": headline, "facts": facts, "warnings": warnings, "next_steps": next_steps}}


def compensate(words: list[str]) -> dict[str, Any]:
    text = Path(words[0]).read_text()
    tell("compensating", 0.4, 7.0)
    if "slow" in text:
        time.sleep(60)
    if "bad" in text:
        print("ffcomp: a.gcode, line 3: it cannot be followed.", file=sys.stderr)
        raise SystemExit(4)
    Path(value(words, "-o")).write_text("; compensated\n")
    return answer("Compensated.", [["Contour error", "88 → 1.1 µm rms"]], ["<b>A warning</b> of a line."], [])


def show(words: list[str]) -> dict[str, Any]:
    Path(value(words, "--report")).write_text(PAGE)
    return {}


def compare(words: list[str]) -> dict[str, Any]:
    Path(value(words, "--report")).write_text(PAGE)
    return answer("FBS-LPV has the lowest error.", [["none", "88 µm"], ["FBS-LPV", "1.1 µm"]], [], [])


def record(words: list[str]) -> dict[str, Any]:
    target = Path(value(words, "-o"))
    target.write_text("G28\n")
    target.with_suffix(".json").write_text("{}")
    next_steps = ["Limits are put back.", "Then: ffcomp identify fit CAPTURES --plan moves.json"]
    return answer("4 experiments, 33.0 s.", [["Captures", "8 files"]], [], next_steps)


def diagnose(words: list[str]) -> dict[str, Any]:
    assert Path(value(words, "--plan")).name == "moves.json"
    tell("trying coulomb_friction")
    Path(value(words, "-o")).write_bytes((LIBRARY / "kossel.toml").read_bytes())
    Path(value(words, "--report")).write_text(PAGE)
    told = answer("Coulomb friction is missing.", [["force_n", "2.1"]], [], ["Use the better machine file."])
    return told | {"machine": value(words, "-o")}


def identify(words: list[str]) -> dict[str, Any]:
    plan = Path(value(words, "--plan")).name if "--plan" in words else ""
    assert plan == {"fit": "moves.json", "scan": "moves.json", "update": "recorded.gcode", "ringing": ""}[words[0]]
    assert words[0] != "ringing" or "--x-hz=48" in words
    Path(value(words, "-o")).write_bytes((LIBRARY / "kossel.toml").read_bytes())
    if words[0] == "update":
        Path(value(words, "-o")).with_suffix(".updates.jsonl").write_text("{}\n")
        return answer("3 layers: 5 % of their motion is unexplained.", [["a", "48"]], [], [])
    if words[0] == "fit":
        Path(value(words, "--report")).write_text(PAGE)
    numbers = [[f"carriage.number_{k}", "48 (46.4 to 49.6)"] for k in range(16)]
    warnings = ["The mass is weak. Weigh it: --known effector.total_mass_kg=0.3."]
    return answer("The model explains 9 of 9 responses.", numbers, warnings, ["Look at it: ffcomp machines show x"])


def machines(words: list[str]) -> dict[str, Any]:
    target = Path(value(words, "-o"))
    target.write_bytes((LIBRARY / "kossel.toml").read_bytes())
    lead = f"{target.stem}: a delta machine, from a Klipper configuration."
    return answer(lead, [["From the configuration", "1"], ["Assumed", "1"]], [], ["Then: ffcomp machines check x.toml"])


def value(words: list[str], option: str) -> str:
    return words[words.index(option) + 1]


if __name__ == "__main__":
    verbs = {each.__name__: each for each in (compensate, show, compare, record, diagnose, identify, machines)}
    print(json.dumps(verbs[sys.argv[1]](sys.argv[2:])))
