"""A comparison at equal error, made up: for what is printed and drawn."""

from __future__ import annotations

import numpy as np

from ffcomp.comparison.result import Family, Party, Piece, Quickest, TimedMethod


def made_up_quickest(path: str = "print.gcode") -> Quickest:
    """Return one of a print that took 5 h 12 min."""
    party = Party("printer", "0" * 64)
    every = [
        timed("none", "no compensation", "none", 40_000.0, 80.0),
        timed("mzv", "MZV, best fixed", "best fixed", 19_000.0, 24.0),
        timed("fbs-lpv", "ffcomp, feeds kept", "inversion", 16_000.0, 20.0),
        timed("faster", "ffcomp, faster", "inversion", 12_000.0, 15.0),
    ]
    return Quickest(
        print_name=path,
        print_sha256="0" * 64,
        machine=party,
        plant=party,
        version="0",
        bound_um=30.0,
        max_flow_mm3_per_s=20.0,
        min_layer_time_s=5.0,
        sampling="6 slices of about 8 s that stand for the whole print were evaluated.",
        whole=False,
        sliced=timed("sliced", "as sliced", "none", 18_720.0, 400.0),
        methods={each.name: each for each in every},
        actuator_limit_s=10_000.0,
        seconds=1.0,
        mismatch="What was found is also played on 2 printers.",
    )


def timed(name: str, label: str, family: Family, seconds: float, p99_um: float) -> TimedMethod:
    """Return a method whose print takes so long."""
    path = np.linspace(0.0, 800.0, 200)
    piece = Piece(0.0, 8.0, p99_um, path, np.full(200, 100.0), np.linspace(0.0, p99_um, 200))
    own_feeds = name.startswith("faster")
    return TimedMethod(
        name,
        label,
        family,
        "as it is",
        seconds,
        {"External perimeter": 0.7 * seconds, "travel": 0.3 * seconds},
        p99_um / 3,
        p99_um,
        3 * p99_um,
        p99_um <= 30.0,
        (piece,),
        None if own_feeds else 1.5,
        None if own_feeds else 5000.0,
        {"flow": 0.6 * seconds, "error_bound": 0.4 * seconds} if own_feeds else {},
        (p99_um, 2 * p99_um),
        {"External perimeter": p99_um},
    )
