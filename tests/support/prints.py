"""A small print to compare methods on: squares with corners at speed, one feature inside another."""

from __future__ import annotations

HEAD = "G90\nM83\nG21\nM204 S5000\nG1 X-20 Y-20 Z0.2 F9000\n"


def squares(layers: int = 3, size: float = 40.0, speed: float = 100.0) -> bytes:
    lines = [HEAD]
    for layer in range(layers):
        z, feed = 0.2 * (layer + 1), 60 * speed
        lines.append(f";LAYER_CHANGE\n;Z:{z:.1f}\nG1 E-0.5 F2400\nG1 Z{z:.1f} F1200\n")
        for name, half in (("Perimeter", 0.5 * size - 1), ("External perimeter", 0.5 * size)):
            lines.append(f"G1 X{-half} Y{-half} F9000\nG1 E0.5 F2400\n;TYPE:{name}\n")
            for x, y in ((half, -half), (half, half), (-half, half), (-half, -half)):
                lines.append(f"G1 X{x} Y{y} E{2 * half * 0.033:.4f} F{feed}\n")
            lines.append("G1 E-0.5 F2400\n")
        lines.append("G1 E0.5 F2400\n")
    return "".join(lines).encode()
