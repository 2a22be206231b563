"""A stand-in for `python -m ffcomp` under `ffcomp serve`: it writes what the verbs write, at once."""

from __future__ import annotations

import json
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


def compensate(words: list[str]) -> dict[str, Any]:
    text = Path(words[0]).read_text()
    print("ffcomp: 40 %, 7 s left", file=sys.stderr, flush=True)
    if "slow" in text:
        time.sleep(60)
    if "bad" in text:
        print("ffcomp: a.gcode, line 3: it cannot be followed.", file=sys.stderr)
        raise SystemExit(4)
    Path(value(words, "-o")).write_text("; compensated\n")
    track = {"contour_rms_um": 88.0, "contour_p99_um": 200.0}
    return {
        "print_time_s": 62.0,
        "original_print_time_s": 61.0,
        "warning_lines": ["<b>A warning</b> of a line."],
        "predicted": {"uncompensated": track, "compensated": {"contour_rms_um": 1.1, "contour_p99_um": 4.0}},
    }


def show(words: list[str]) -> dict[str, Any]:
    Path(value(words, "-o")).write_bytes(picture())
    return {}


def compare(words: list[str]) -> dict[str, Any]:
    Path(value(words, "--report")).write_text(PAGE)
    errors = {"none": 88.0, "mzv": 20.0, "fbs-lpv": 1.1}
    methods = {name: {"contour_rms_um": rms, "label": name.upper(), "warnings": []} for name, rms in errors.items()}
    return {"methods": methods, "ours": "fbs-lpv", "best_fixed": "mzv", "sampling": "all of it"}


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
    print("ffcomp: trying coulomb_friction", file=sys.stderr, flush=True)
    Path(value(words, "-o")).write_bytes((LIBRARY / "kossel.toml").read_bytes())
    Path(value(words, "--report")).write_text(PAGE)
    return {
        "said": ["Coulomb friction is missing.", "2.1 N on every guideway."],
        "gap": {"before": 0.4, "after": 0.11, "noise": 0.1},
        "print_gain": {"uncompensated_um": 90.0, "before_um": 20.0, "after_um": 3.0},
        "to_do": ["Use the better machine file."],
        "machine": value(words, "-o"),
    }


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
