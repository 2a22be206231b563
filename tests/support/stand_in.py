"""A stand-in for `python -m ffcomp` under `ffcomp serve`: it writes what the verbs write, at once."""

from __future__ import annotations

import json
import os
import struct
import sys
import time
import zlib
from pathlib import Path
from typing import Any

LIBRARY = Path(__file__).parents[2] / "models" / "library"
PAGE = "<!doctype html><title>report</title><p id='it'>A report</p><script>document.body.dataset.ran = 'yes'</script>"


def picture() -> bytes:
    """A small grey PNG."""
    head = struct.pack(">2I5B", 16, 8, 8, 0, 0, 0, 0)
    chunks = [(b"IHDR", head), (b"IDAT", zlib.compress((b"\0" + b"\xcc" * 16) * 8)), (b"IEND", b"")]
    made = [
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks
    ]
    return b"\x89PNG\r\n\x1a\n" + b"".join(made)


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
    Path(value(words, "-o")).write_bytes(picture())
    return {}


def compare(words: list[str]) -> dict[str, Any]:
    Path(value(words, "--report")).write_text(PAGE)
    return answer("FBS-LPV has the lowest error.", [["none", "88 µm"], ["FBS-LPV", "1.1 µm"]], [], [])


def record(words: list[str]) -> dict[str, Any]:
    target = Path(value(words, "-o"))
    target.write_text("G28\n")
    target.with_suffix(".json").write_text("{}")
    return {
        "experiments": [{}] * 4,
        "duration_s": 33.0,
        "repeats": 2,
        "flavor": "klipper",
        "captures": ["a"] * 8,
        "restores": ["Limits are put back."],
        "warnings": [],
    }


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
    estimate = {"value": 48.0, "sd": 1.0, "low": 46.4, "high": 49.6}
    if words[0] == "update":
        Path(value(words, "-o")).with_suffix(".updates.jsonl").write_text("{}\n")
        held_out = {"before": 0.2, "after": 0.05, "noise": 0.01}
        return {"layers": 3, "numbers": {"a": {"after": estimate}}, "held_out": held_out, "kept": ["b"]}
    return {"numbers": {"a": estimate}, "skipped": [], "advice": [], "output": value(words, "-o")}


def machines(words: list[str]) -> dict[str, Any]:
    target = Path(value(words, "-o"))
    target.write_bytes((LIBRARY / "kossel.toml").read_bytes())
    values = {"a.b": {"how": "read"}, "c.d": {"how": "assumed"}}
    told = {"name": target.stem, "kinematics": "delta", "firmware": "Klipper", "like": "kossel"}
    return told | {"values": values, "missing": {}, "notes": []}


def value(words: list[str], option: str) -> str:
    return words[words.index(option) + 1]


if __name__ == "__main__":
    verbs = {each.__name__: each for each in (compensate, show, compare, record, diagnose, identify, machines)}
    print(json.dumps(verbs[sys.argv[1]](sys.argv[2:])))
