"""Moves as text: as few digits as keep the path, nothing that has not changed.

Positions have 4 decimals of a millimetre (3 would bend short segments), filament 5; both are held as whole numbers of
those units, so nothing drifts in relative modes and equality means equal text.
"""

from __future__ import annotations

from gcode.program import Frame

XYZ_DECIMALS_MM, XYZ_DECIMALS_INCH, E_DECIMALS = 4, 6, 5


class MoveWriter:
    """Writes G1 lines for toolhead coordinates in the coordinates, units and modes of the file."""

    def __init__(self) -> None:
        self.reset(Frame(), (0.0, 0.0, 0.0), 0.0)

    def reset(self, frame: Frame, xyz: tuple[float, float, float], e: float) -> None:
        """The nozzle is at xyz (mm), the filament at e (mm), and nothing is known of the modal feed."""
        self._at = [*xyz, e]
        self.take(frame)

    def take(self, frame: Frame) -> None:
        """From here on coordinates are written as `frame` says; the nozzle has not moved."""
        self._decimals = XYZ_DECIMALS_MM if frame.unit_mm == 1.0 else XYZ_DECIMALS_INCH
        grain = 10.0**-self._decimals * frame.unit_mm
        self._base, self._grain = frame.base, (grain, grain, grain, 10.0**-E_DECIMALS * frame.flow * frame.unit_mm)
        self._relative, self._relative_e = not frame.absolute, not frame.absolute_e
        self._feed_unit = frame.feed_factor * frame.unit_mm
        self._last = [round((a - b) / g) for a, b, g in zip(self._at, self._base, self._grain, strict=True)]
        self._feed = b""

    def move(self, x: float, y: float, z: float, e: float, feed: float) -> bytes:
        """The line that moves there; empty when nothing changes. mm; `feed` mm/min of the toolhead."""
        base, grain, last = self._base, self._grain, self._last
        now = [
            round((x - base[0]) / grain[0]),
            round((y - base[1]) / grain[1]),
            round((z - base[2]) / grain[2]),
            round((e - base[3]) / grain[3]),
        ]
        if now == last:
            return b""
        line = b"G1"
        for axis, name in enumerate((b" X", b" Y", b" Z")):
            if now[axis] != last[axis]:
                line += name + _decimal(now[axis] - last[axis] if self._relative else now[axis], self._decimals)
        if now[3] != last[3]:
            line += b" E" + _decimal(now[3] - last[3] if self._relative_e else now[3], E_DECIMALS)
        text = b"%.4f" % (feed / self._feed_unit)
        text = text.rstrip(b"0").rstrip(b".")
        if text != self._feed:
            line += b" F" + text
            self._feed = text
        self._last = now
        self._at = [n * g + b for n, g, b in zip(now, grain, base, strict=True)]
        return line + b"\n"


def _decimal(number: int, decimals: int) -> bytes:
    """A whole number of 10^-decimals as text: b"-0.05", b"12", never b"-0"."""
    sign = b"-" if number < 0 else b""
    whole, part = divmod(abs(number), 10**decimals)
    if not part:
        return sign + b"%d" % whole
    return sign + b"%d." % whole + (b"%0*d" % (decimals, part)).rstrip(b"0")
