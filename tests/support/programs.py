"""What the planner's tests plan: moves through given points, and random but repeatable G-code."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gcode.program import Moves
from models.arrays import FloatArray

RADIUS_MM = 139.0  # of the random places: reaches into both slow zones of the oracle's printer


def moves_through(points: ArrayLike, speed: ArrayLike = 100.0, **columns: ArrayLike) -> Moves:
    """Moves from each point (n+1, 2 to 4) to the next; columns of `Moves` not named are the machine's own."""
    places = np.atleast_2d(np.asarray(points, dtype=np.float64))
    places = np.pad(places, ((0, 0), (0, 4 - places.shape[1])))
    n = len(places) - 1
    whole: dict[str, Any] = {"line": np.arange(n), "start": places[:-1], "end": places[1:]}
    whole |= {"speed": np.broadcast_to(np.asarray(speed, dtype=np.float64), (n,)), "frame": np.zeros(n, dtype=np.int64)}
    for name in ("velocity_limit", "acceleration", "square_corner_velocity", "minimum_cruise_ratio"):
        whole[name] = np.broadcast_to(np.asarray(columns.get(name, np.nan), dtype=np.float64), (n,))
    return Moves(**whole)


def random_program(seed: int, sections: int) -> bytes:
    """`sections` stretches of a few dozen moves each, of random kinds, under random limits."""
    rng = np.random.default_rng(seed)
    writer = _Writer(rng)
    for _ in range(sections):
        writer.settings()
        rng.choice([writer.print_lines, writer.curve, writer.zigzag, writer.travel, writer.heights])()
        rng.choice([writer.filament, writer.dwell, writer.nothing], p=[0.3, 0.2, 0.5])()
    return ("\n".join(writer.lines) + "\n").encode()


class _Writer:
    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.at = np.array([0.0, 0.0, 10.0])
        self.lines = ["M83", "G92 E0"]

    def nothing(self) -> None:
        """No extra line."""

    def go(self, to: FloatArray, filament: float = 0.0, feed: float | None = None) -> None:
        reach = max(1.0, float(np.hypot(*to[:2])) / RADIUS_MM)
        self.at = np.array([to[0] / reach, to[1] / reach, np.clip(to[2], 0.0, 60.0)])
        words = [f"{axis}{value:.4f}" for axis, value in zip("XYZ", self.at, strict=True)]
        words += [f"E{filament:.5f}"] if filament else []
        words += [f"F{feed:.1f}"] if feed else []
        self.lines.append(" ".join(["G1", *words]))

    def feed(self) -> float:
        return float(np.exp(self.rng.uniform(np.log(600), np.log(30000))))

    def settings(self) -> None:
        rng = self.rng
        words = {
            "VELOCITY": rng.uniform(20, 500),
            "ACCEL": np.exp(rng.uniform(np.log(300), np.log(30000))),
            "SQUARE_CORNER_VELOCITY": rng.choice([0.1, 1.0, 5.0, 40.0]),
            "MINIMUM_CRUISE_RATIO": rng.choice([0.0, 0.3, 0.5, 0.9]),
        }
        chosen = [f"{name}={value:.3f}" for name, value in words.items() if rng.random() < 0.4]
        if chosen:
            self.lines.append(" ".join(["SET_VELOCITY_LIMIT", *chosen]))
        elif rng.random() < 0.5:
            self.lines.append(f"M204 S{rng.uniform(300, 10000):.1f}")

    def print_lines(self) -> None:
        for _ in range(30):
            step = self.rng.normal(scale=self.rng.choice([0.01, 1.0, 30.0]), size=2)
            to = self.at + np.array([*step, 0.0])
            self.go(to, filament=0.05 * float(np.hypot(*step)), feed=self.feed() if self.rng.random() < 0.2 else None)

    def curve(self) -> None:
        """Many short moves that bend a little; the filament per mm wavers, as rounded numbers make it."""
        angle, length = self.rng.uniform(0, 7), np.exp(self.rng.uniform(np.log(0.02), np.log(2.0)))
        bend = self.rng.normal(scale=0.15)
        for i in range(60):
            angle += bend
            to = self.at + length * np.array([np.cos(angle), np.sin(angle), 0.0])
            self.go(to, filament=round(0.05 * length, 3), feed=self.feed() if i == 0 else None)

    def zigzag(self) -> None:
        """Straight back and forth: exact reversals, and exact continuations."""
        step = np.array([*self.rng.uniform(-3, 3, size=2).round(1), 0.0])
        for i in range(20):
            self.go(self.at + step * self.rng.choice([-1.0, 1.0, 1.0]), feed=self.feed() if i % 5 == 0 else None)

    def travel(self) -> None:
        """Far moves, also along the rim, some of them retracting on the way."""
        for _ in range(6):
            angle, radius = self.rng.uniform(0, 7), self.rng.choice([40.0, 120.0, 130.0, 138.0])
            to = np.array([radius * np.cos(angle), radius * np.sin(angle), self.at[2]])
            self.go(to, filament=self.rng.choice([0.0, -1.5, 0.8]), feed=self.feed())

    def heights(self) -> None:
        """Layer changes, hops while moving, filament while only Z moves."""
        for _ in range(6):
            step = self.rng.normal(size=3) * [self.rng.choice([0.0, 2.0]), self.rng.choice([0.0, 2.0]), 1.0]
            self.go(self.at + step, filament=self.rng.choice([0.0, 0.01, -0.2]), feed=self.feed())

    def filament(self) -> None:
        self.lines.append(f"G1 E{self.rng.uniform(-3, 3):.4f} F{self.feed():.1f}")

    def dwell(self) -> None:
        self.lines += [f"G4 P{self.rng.integers(0, 300)}"] * int(self.rng.integers(1, 3))
