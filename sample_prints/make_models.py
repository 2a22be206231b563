"""Write the three STL models of the sample prints: `python make_models.py [FOLDER]`.

Each model is a loft: a stack of outlines with the same number of corners, joined corner to corner, closed
below and above towards an inner outline (a hole) or towards the axis. All are drawn about the origin, in mm.
"""

from __future__ import annotations

import struct
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def wall(loops: FloatArray) -> FloatArray:
    """Triangles : (k, 3, 3) between loops : (layers, n, 3), counter-clockwise, rising."""
    low, high = loops[:-1], loops[1:]
    next_low, next_high = np.roll(low, -1, axis=1), np.roll(high, -1, axis=1)
    quads = [np.stack(corners, axis=-2) for corners in ([low, next_low, next_high], [low, next_high, high])]
    return np.concatenate([quad.reshape(-1, 3, 3) for quad in quads])


def loft(outer: FloatArray, inner: FloatArray | None = None) -> FloatArray:
    """A closed solid : (k, 3, 3) from outlines : (layers, n, 3) around a hole's, if there is one."""
    inside = outer * [0.0, 0.0, 1.0] if inner is None else inner
    skins = [wall(outer), wall(np.stack([outer[-1], inside[-1]])), wall(np.stack([inside[0], outer[0]]))]
    solid = np.concatenate(skins if inner is None else [*skins, wall(inner[::-1])])
    edges = np.diff(solid, axis=1)
    flat = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) == 0.0  # half of what meets on the axis
    return solid[~flat]


def write_stl(path: Path, triangles: FloatArray) -> None:
    """Binary STL; slicers work out the normals themselves."""
    record = np.zeros(len(triangles), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("tag", "<u2")])
    record["corners"] = triangles
    path.write_bytes(b"ffcomp sample print".ljust(80) + struct.pack("<I", len(record)) + record.tobytes())


def at_height(outline: FloatArray, z: float) -> FloatArray:
    return np.column_stack([outline, np.full(len(outline), z)])


def quarters(side: list[tuple[float, float]]) -> FloatArray:
    """One side's corners : (n, 2), repeated by quarter turns into a closed outline : (4 n, 2)."""
    turns = [np.linalg.matrix_power(np.array([[0, 1], [-1, 0]]), i) for i in range(4)]
    return np.concatenate([np.array(side) @ turn for turn in turns])


def ringing_tower() -> FloatArray:
    """A square of 40 mm, a notch, a rib and a step in every wall, bored round, a ledge half way up."""

    def outline(half: float) -> FloatArray:
        notch = [(half, -11.0), (half - 2.0, -10.0), (half - 2.0, -7.0), (half, -6.0)]
        rib = [(half, -1.0), (half + 1.0, -0.5), (half + 1.0, 0.5), (half, 1.0)]
        step = [(half, 7.0), (half - 0.5, 7.4), (half - 0.5, 13.0), (half, 13.4)]
        return quarters([(half, -half), *notch, *rib, *step])

    levels = [(19.0, 0.0), (19.0, 3.0), (20.0, 3.0), (20.0, 5.1)]
    outer = np.stack([at_height(outline(half), z) for half, z in levels])
    angle = np.arctan2(outer[0, :, 1], outer[0, :, 0])
    bore = 9.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    return loft(outer, np.stack([at_height(bore, z) for _, z in levels]))


def lobed_vase() -> FloatArray:
    """Seven lobes that twist as they rise; printed as one spiral."""
    angle = np.linspace(0, 2 * np.pi, 350, endpoint=False)

    def outline(share: float) -> FloatArray:
        radius = (24 + 8 * np.sin(np.pi * share)) * (1 + 0.16 * np.cos(7 * (angle - 0.9 * share)))
        return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])

    return loft(np.stack([at_height(outline(share), 18 * share) for share in np.linspace(0, 1, 37)]))


def far_star() -> FloatArray:
    """Four thin arms that reach 110 mm: the far places, where a delta's dynamics differ most."""
    arm = [(6.0, -6.0), (95.0, -5.0), (110.0, -2.0), (110.0, 2.0), (95.0, 5.0)]
    return loft(np.stack([at_height(quarters(arm), z) for z in (0.0, 1.0)]))


MODELS = {"ringing_tower": ringing_tower, "lobed_vase": lobed_vase, "far_star": far_star}


def main() -> None:
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
    for name, model in MODELS.items():
        write_stl(folder / f"{name}.stl", model())


if __name__ == "__main__":
    main()
