"""A residual that lies where a test wants it."""

from __future__ import annotations

from collections.abc import Mapping

from ffcomp.diagnosis.where import MOTIONS, ResidualBreakdown, ResidualSize, Split

Span = tuple[float, float]


def residual_at(
    size: ResidualSize, file: str, bands: Mapping[Span, float], places: Mapping[Span, float], motion: tuple[float, ...]
) -> ResidualBreakdown:
    """Return a residual with these shares of its excess; motion: backward, at rest, forward."""
    splits = (
        split("frequency", bands, spans=tuple(bands)),
        split("place", places, at=tuple(places)),
        split("motion", dict(zip(MOTIONS, motion, strict=True))),
    )
    return ResidualBreakdown(size, {"acc_x": size}, {file: size}, {each.title: each for each in splits})


def split(title: str, shares: Mapping[object, float], **about: tuple[Span, ...]) -> Split:
    even = (1 / len(shares),) * len(shares)
    return Split(title, tuple(map(str, shares)), tuple(shares.values()), (), even, **about)
