# What stands in the host's look-ahead queue for motion that is already planned.
#
# Copyright (C) 2026  The ffcomp authors
#
# This file may be distributed under the terms of the GNU GPLv3 license.
"""Planned motion in the host's look-ahead queue.

The look-ahead plans how fast a move goes along its length. Here the length is the file's own time, the speed is the
rate at which its clock runs (1 as it was computed), and the acceleration is how quickly that rate may change. So the
look-ahead itself does what a pause needs: where nothing follows, it lets the clock run down to a stop on the path, and
up again from there. In the file's own rests the clock may stop and start at once: `Gate` says so.
"""

import math

import numpy as np

ANY_CHANGE = 1e12  # of the squared rate: at a rest the clock may jump
STILL_MM = 1e-9
LONGEST_S = 0.002  # of what a piece of an accelerated path is taken to be straight, while the clock slows down


class Item:
    """What the look-ahead asks of a move; times in s of the file's clock, rates without unit, squared as `v2`."""

    is_kinematic_move = False  # the host then plans the moves beside it to and from rest, and queues none itself
    axes_d = axes_r = (0.0,) * 16
    junction_deviation = next_junction_v2 = 0.0
    accel = 1.0
    continues = False  # at the rate at which the item before it ends

    def __init__(self, player, duration, delta_v2, most_v2=1.0):
        self.player, self.duration = player, duration
        self.min_move_t = self.move_d = duration
        self.delta_v2 = self.smooth_delta_v2 = self.mcr_delta_v2 = delta_v2
        self.max_cruise_v2 = most_v2
        self.max_start_v2 = self.max_smoothed_v2 = self.max_mcr_start_v2 = 0.0
        self.accel_t = self.decel_t = 0.0
        self.cruise_t = duration
        self.timing_callbacks = [self._ended]

    def calc_junction(self, before):
        """Say how fast the clock may run where this begins; the host's own moves end at rest there."""
        if self.continues and isinstance(before, Item):
            self.max_start_v2 = min(self.max_cruise_v2, before.max_cruise_v2, before.max_start_v2 + before.delta_v2)
        self.max_smoothed_v2 = self.max_mcr_start_v2 = self.max_start_v2

    def set_junction(self, start_v2, cruise_v2, end_v2):
        """Take the rates that the look-ahead has found; a rest has none."""

    def limit_speed(self, speed, accel):
        """Nothing: the path was planned with the limits."""

    def limit_next_junction_speed(self, speed):
        """Nothing: likewise."""

    def _ended(self, print_time):
        self.player.note_time(print_time)


class Gate(Item):
    """A rest of no length: the clock may stop or start there at once."""

    def __init__(self, player, opens):
        super().__init__(player, 0.0, ANY_CHANGE)
        self.continues = not opens  # one that opens begins at rest, one that closes ends there


class Rest(Item):
    """A rest that takes its time."""

    def __init__(self, player, seconds):
        super().__init__(player, seconds, ANY_CHANGE)


class Block(Item):
    """A part of the path, some hundred milliseconds long."""

    continues = True

    def __init__(self, player, motion, places, filament, rate, slowing):
        """`places` (n + 1, 3) mm and `filament` (n + 1,) mm are the motion's own, where the machine is to have them."""
        duration = float(motion.durations.sum())
        super().__init__(player, duration, 2.0 * duration * slowing, rate * rate)
        self.motion, self.places, self.filament, self.slowing = motion, places, filament, slowing
        self.rates = (rate, rate, rate)

    def set_junction(self, start_v2, cruise_v2, end_v2):
        """Take the rates at the beginning, along the path and at the end, and tell how long each part lasts."""
        start, cruise, end = (math.sqrt(max(v2, 0.0)) for v2 in (start_v2, cruise_v2, end_v2))
        self.rates = (start, cruise, end)
        up, down = (cruise_v2 - start_v2) / (2.0 * self.slowing), (cruise_v2 - end_v2) / (2.0 * self.slowing)
        self.accel_t, self.decel_t = (cruise - start) / self.slowing, (cruise - end) / self.slowing
        even = max(self.duration - up - down, 0.0)
        self.cruise_t = even / cruise if cruise else 0.0

    def _ended(self, print_time):
        begin = self.player.begin_of(print_time - self.accel_t - self.cruise_t - self.decel_t)
        start, cruise, end = self.rates
        if start == cruise == end == 1.0:
            end_t = self.player.append(begin, *_as_planned(self.motion, self.places, self.filament))
        else:
            end_t = self.player.append(begin, *self._slowed())
        self.player.note_time(end_t)

    def _slowed(self):
        """The pieces as the slower clock has them."""
        start, cruise, end = self.rates
        half = 2.0 * self.slowing
        marks = [(cruise**2 - start**2) / half, self.duration - (cruise**2 - end**2) / half]
        along, places, filament = _straight(self.motion, self.places[:, :3], self.filament, marks)
        # the rate at each of these times: its square changes evenly along them
        squared = np.minimum(start**2 + half * along, end**2 + half * (self.duration - along))
        rates = np.sqrt(np.clip(squared, 0.0, cruise**2))
        steps = np.diff(along)
        kept = steps > 1e-12
        mean = 0.5 * (rates[:-1] + rates[1:])
        lasts = steps[kept] / mean[kept]
        change = (rates[1:] - rates[:-1])[kept] / lasts
        ways = [np.diff(each, axis=0)[kept] / _tall(steps[kept], each) for each in (places, filament)]
        return _pieces(lasts, places[:-1][kept], ways[0], filament[:-1][kept], ways[1], rates[:-1][kept], change)


def _tall(steps, places):
    return steps[:, None] if places.ndim > 1 else steps


def _straight(motion, places, filament, marks):
    """A path as straight pieces with the marks (s since its beginning) among their ends: times, places, filament."""
    ends = np.concatenate([[0.0], np.cumsum(motion.durations)])
    times = [ends, np.clip(marks, 0.0, ends[-1])]
    if not motion.straight:
        times.append(np.arange(0.0, ends[-1], LONGEST_S))
    times_at = np.unique(np.concatenate(times))
    k = np.clip(np.searchsorted(ends, times_at, side="right") - 1, 0, len(motion.durations) - 1)
    since = times_at - ends[k]
    along = (motion.speeds[k] + 0.5 * motion.accelerations[k] * since) * since
    whole = (motion.speeds + 0.5 * motion.accelerations * motion.durations) * motion.durations
    share = along / np.where(whole > 0.0, whole, 1.0)[k]
    moved = [each[:-1][k] + np.diff(each, axis=0)[k] * _tall(share, each) for each in (places, filament)]
    return times_at, moved[0], moved[1]


def _as_planned(motion, places, filament):
    if places is motion.places and motion.straight:
        return _at_one_speed(motion, filament)
    whole = (motion.speeds + 0.5 * motion.accelerations * motion.durations) * motion.durations
    whole = np.where(whole > 0.0, whole, 1.0)
    ways = np.diff(places, axis=0) / whole[:, None]
    pushed = np.diff(filament) / whole
    return _pieces(motion.durations, places[:-1], ways, filament[:-1], pushed, motion.speeds, motion.accelerations)


def _at_one_speed(motion, filament):
    """What `_pieces` gives for straight segments that are where the file has them: most of a print, so quickly."""
    ways, places = motion.directions, motion.places
    length = np.sqrt(np.einsum("ij,ij->i", ways[:, :3], ways[:, :3]))
    moves = length > STILL_MM
    nozzle, thread = np.zeros((len(ways), 9)), _thread(motion.durations, filament[:-1], moves)
    nozzle[:, 0], nozzle[:, 1:4], nozzle[:, 7] = motion.durations, places[:-1, :3], np.where(moves, length, 0.0)
    nozzle[:, 4:7] = ways[:, :3] / np.where(moves, length, 1.0)[:, None]
    thread[:, 7] = ways[:, 3]
    return nozzle, thread


def _pieces(durations, places, ways, filament, pushed, speeds, accelerations):
    """Rows as `pieces.one_by_one` takes them: unit directions, so that speeds are mm/s; of filament signed."""
    places, ways = places[:, :3], ways[:, :3]  # of the file's own the fourth is the filament
    length = np.sqrt((ways * ways).sum(axis=1))
    moves = length > STILL_MM
    along = np.where(moves, length, 0.0)
    units = ways / np.where(moves, length, 1.0)[:, None]
    nozzle = np.column_stack([durations, places, units, along * speeds, along * accelerations])
    thread = _thread(durations, filament, ways[:, :2].any(axis=1))
    thread[:, 7], thread[:, 8] = pushed * speeds, pushed * accelerations
    return nozzle, thread


def _thread(durations, filament, travels):
    """Rows of filament, without speeds; one of its directions asks for pressure advance, where the nozzle `travels`."""
    rows = np.zeros((len(durations), 9))
    rows[:, 0], rows[:, 1], rows[:, 4], rows[:, 5] = durations, filament, 1.0, travels
    return rows
