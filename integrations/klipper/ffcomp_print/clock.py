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
        super().__init__(player, motion.duration, 2.0 * motion.duration * slowing, rate * rate)
        self.motion, self.places, self.filament, self.slowing = motion, places[:, :3], filament, slowing
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
            lasts = np.full(len(self.places) - 1, self.motion.spacing)
            end_t = self.player.append(begin, *_pieces(lasts, lasts, self.places, self.filament))
        else:
            end_t = self.player.append(begin, *self._slowed())
        self.player.note_time(end_t)

    def _slowed(self):
        """The pieces as the slower clock has them."""
        start, cruise, end = self.rates
        half = 2.0 * self.slowing
        marks = [(cruise**2 - start**2) / half, self.duration - (cruise**2 - end**2) / half]
        knots = self.motion.spacing * np.arange(len(self.places))
        along = np.unique(np.concatenate([knots, np.clip(marks, 0.0, knots[-1])]))
        along = along[np.diff(along, prepend=-1.0) > 1e-12]
        places = np.column_stack([np.interp(along, knots, axis) for axis in self.places.T])
        # the rate at each of these times: its square changes evenly along them
        squared = np.minimum(start**2 + half * along, end**2 + half * (self.duration - along))
        rates = np.sqrt(np.clip(squared, 0.0, cruise**2))
        steps = np.diff(along)
        lasts = steps / (0.5 * (rates[:-1] + rates[1:]))
        filament = np.interp(along, knots, self.filament)
        return _pieces(lasts, steps, places, filament, rates[:-1], np.diff(rates) / lasts)


def _pieces(lasts, steps, places, filament, rates=1.0, change=0.0):
    """Rows as `pieces.one_by_one` takes them, of the nozzle and of filament.

    Pieces between places (n + 1, 3) mm take `lasts` (n,) s, which are `steps` of the file's clock; its rate is that
    at their beginnings, and its change a second.
    """
    ways, pushed = np.diff(places, axis=0) / steps[:, None], np.diff(filament) / steps
    length = np.sqrt(np.einsum("ij,ij->i", ways, ways))
    moves = length > STILL_MM
    length[~moves] = 0.0
    nozzle, thread = np.zeros((2, len(ways), 9))
    nozzle[:, 0], nozzle[:, 1:4], nozzle[:, 4:7] = lasts, places[:-1], ways / np.where(moves, length, 1.0)[:, None]
    nozzle[:, 7], nozzle[:, 8] = length * rates, length * change
    # one of the filament's directions asks for pressure advance, where the nozzle travels
    thread[:, 0], thread[:, 1], thread[:, 4], thread[:, 5] = lasts, filament[:-1], 1.0, ways[:, :2].any(axis=1)
    thread[:, 7], thread[:, 8] = pushed * rates, pushed * change
    return nozzle, thread
