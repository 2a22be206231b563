"""Motions as a firmware with input shapers plays them."""

from __future__ import annotations

from ffcomp import shapers
from ffcomp.shapers.apply import FrequencyOfPlace
from ffcomp.simulate.motion import Motion, Position


def shaped(motion: Motion, x: shapers.Shaper, y: shapers.Shaper) -> Motion:
    """The motion as a firmware with input shapers plays it: each axis convolved, no delay at constant speed."""
    return _changed(motion, lambda t: shapers.shape(motion.position, t, x, y))


def shaped_by_place(motion: Motion, frequency_of_place: FrequencyOfPlace, kind: str) -> Motion:
    """The motion shaped with the frequency of the place where the plan is at each time."""
    return _changed(motion, lambda t: shapers.scheduled_shape(motion.position, t, frequency_of_place, kind))


def _changed(motion: Motion, position: Position) -> Motion:
    return Motion(position, motion.begin_t, motion.end_t, motion.clock)
