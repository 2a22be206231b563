"""Runs to break, and where the measured data is."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.support.data import DATA, needed

RATE = 1600.0


@pytest.fixture(scope="session")
def data() -> Path:
    return needed(DATA)


@pytest.fixture
def columns() -> dict[str, np.ndarray]:
    """One second of a smooth motion of all carriages, measured well."""
    generator = np.random.default_rng(2)
    t = np.arange(1600) / RATE
    table = {"t_s": t}
    for axis, phase in zip("ABC", (0.0, 1.0, 2.0), strict=True):
        table[f"cmd_{axis}_mm"] = 300 + 0.5 * np.sin(2 * np.pi * 11 * t + phase)
    for axis, phase in zip("ABC", (0.0, 1.0, 2.0), strict=True):
        acceleration = -0.5e-3 * (2 * np.pi * 11) ** 2 * np.sin(2 * np.pi * 11 * t + phase)
        table[f"acc_{axis}_m_per_s2"] = (
            np.round((acceleration + 0.1 * generator.standard_normal(1600)) / 0.0383) * 0.0383
        )
    return table


Written = Callable[..., Path]


@pytest.fixture
def written(tmp_path: Path) -> Written:
    """Writes columns as a run's CSV; NaN becomes an empty field."""

    def write(table: dict[str, np.ndarray], name: str = "run-1.csv", head: str = "") -> Path:
        rows = np.column_stack(list(table.values()))
        lines = [",".join("" if np.isnan(v) else f"{v:.9g}" for v in row) for row in rows]
        path = tmp_path / name
        path.write_text(head + ",".join(table) + "\n" + "\n".join(lines) + "\n", encoding="utf-8")
        return path

    return write
