"""An invented comparison: squares in three layers, whose corners start decaying waves across the next side."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from ffcomp.comparison.result import Comparison, EqualQuality, Family, Method, Peaks, Samples
from models.file import load_machine

MACHINE = load_machine("mp-delta-pro")
SAMPLE_S = 1e-3
SIDE, SPEED, LAYERS = 40.0, 80.0, 3  # mm, mm/s
RING_HZ, DECAY_PER_S = 42.0, 12.0
SIDE_N = round(SIDE / SPEED / SAMPLE_S)
FEATURES = ("other", "Perimeter", "External perimeter")
NASTY = '"><script>alert(1)</script><img src=x onerror=alert(2)>'


def samples(amplitude_mm: float) -> Samples:
    """Once round a square in each layer; the last side is travel. Each corner is overshot and rings on."""
    corners = 0.5 * SIDE * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]])
    s = np.arange(SIDE_N) / SIDE_N
    wave = amplitude_mm * np.exp(-DECAY_PER_S * SAMPLE_S * np.arange(SIDE_N))
    wave = wave * np.sin(2 * np.pi * RING_HZ * SAMPLE_S * np.arange(SIDE_N) + 0.5 * np.pi)
    wanted, across = [], []
    for layer in range(LAYERS):
        for a, b in pairwise(corners):
            along = (b - a) / SIDE
            wanted.append(np.column_stack([a + s[:, None] * (b - a), np.full(SIDE_N, 0.2 * (layer + 1))]))
            across.append(np.column_stack([along[1] * wave, -along[0] * wave, 0 * wave]))
    across[0] = 0 * across[0]  # it comes from rest
    count = 4 * LAYERS * SIDE_N
    side = np.arange(count) // SIDE_N
    return Samples(
        due=SAMPLE_S * np.arange(count),
        reference=np.concatenate(wanted),
        late=np.concatenate(wanted),
        nozzle=np.concatenate(wanted) + np.concatenate(across),
        contour=np.linalg.norm(np.concatenate(across), axis=1),
        layer=side // 4,
        feature=1 + side % 2,
        extruding=side % 4 != 3,
    )


def method(name: str, label: str, family: Family, amplitude_um: float, **about: Any) -> Method:
    s = about.pop("samples", None) or samples(1e-3 * amplitude_um)
    given: dict[str, Any] = {
        "tuning": "x 40.0 Hz, y 41.0 Hz: as a test sets it.",
        "track": s.track(np.ones(len(s.due), dtype=bool), float(s.due[-1]), 6e3),
        "extruding": s.track(s.extruding, float(s.due[-1]), 6e3),
        "by_layer": s.by(s.layer),
        "by_feature": {FEATURES[k]: error for k, error in s.by(s.feature).items()},
        "peaks": Peaks(120.0, 6000.0, True),
    }
    return Method(name, label, family, samples=s, **(given | about))


def comparison(
    none_um: float = 200.0, best_um: float = 20.0, ours_um: float = 2.0, name: str = "prints/square.gcode", **about: Any
) -> Comparison:
    judged = [
        method("none", "no compensation", "none", none_um),
        method("mzv-calibrated", "MZV, calibrated", "calibrated", 1.5 * best_um),
        method("mzv", "MZV, best fixed", "best fixed", best_um),
        method("fbs-lpv", "ffcomp", "inversion", ours_um),
    ]
    given: dict[str, Any] = {
        "print_sha256": "ab" * 32,
        "print_time_s": 3725.0,
        "sampling": "The whole print was evaluated, 6 s.",
        "machine": MACHINE,
        "plant": MACHINE,
        "settings": {"bandwidth of the inversion": "100 Hz"},
        "version": "9.8.7",
        "features": FEATURES,
        "methods": {each.name: each for each in judged},
        "compensated": "fbs-lpv",
        "quality_bound_um": 25.0,
        "acceleration_mm_per_s2": 5000.0,
    }
    return Comparison(print_name=name, **(given | about))


def changed(found: Comparison, name: str, **about: Any) -> Comparison:
    """The comparison with one method altered."""
    return replace(found, methods={**found.methods, name: replace(found.methods[name], **about)})


def everything(name: str = "prints/square.gcode") -> Comparison:
    """With all that can be asked for."""
    found = comparison(name=name)
    for key, factor in (("none", 1.1), ("mzv-calibrated", 1.4), ("mzv", 1.4), ("fbs-lpv", 2.5)):
        quality = EqualQuality(1e3 * (4 - factor), 3000.0 + 100 * factor, 24.0, capped=False, reached=key != "none")
        found = changed(found, key, equal_quality=quality)
    return found


@cache
def whole_page() -> bytes:
    """The page of a comparison that has everything."""
    with TemporaryDirectory() as folder:
        everything().write_report(Path(folder) / "report.html")
        return (Path(folder) / "report.html").read_bytes()
