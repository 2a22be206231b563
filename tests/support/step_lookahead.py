"""A stand-in for how Klipper's host of 2025 releases motion: steps are made some time ahead, whatever is queued.

Written from its documentation of constants and from what was measured on it. The look-ahead keeps back what may still
have to brake; in the background steps are made 0.7 s ahead, and what is queued then ends at rest.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.support.klipper_host import FOLDER

PRIMING_S, KEPT_BACK_S, START_S = 1.0, 0.15, 0.25  # queued before anything is released; later; least lead at a start
STEPS_AHEAD_S, HIGH_S, LINE_S = 0.7, 1.0, 0.002


@dataclass
class StandIn:
    """The host's clock, its queue, and the blocks that it has ended at rest on the path."""

    print_t: float = 0.0
    now: float = 0.0
    primed: bool = False
    queue: list[Any] = field(default_factory=list)
    queued_s: float = 0.0
    stops: int = 0

    def note_time(self, t: float) -> None:
        """Take no note: what the module asks its player for."""

    def begin_of(self, t: float) -> float:
        return t

    def append(self, begin: float, nozzle: Any, thread: Any) -> float:
        return begin + float(nozzle[:, 0].sum())

    def add(self, item: Any) -> None:
        if self.queue:
            item.calc_junction(self.queue[-1])
        self.queue.append(item)
        self.queued_s += item.min_move_t
        if self.queued_s >= (KEPT_BACK_S if self.primed else PRIMING_S):
            self._release(all_of_it=False)
        while self.print_t - self.now > HIGH_S:
            self.now = self.print_t - HIGH_S
            self.background()

    def background(self) -> None:
        """Make steps, as whenever the host has a moment."""
        if self.primed and self.queue and self.print_t - self.now < STEPS_AHEAD_S:
            self._release(all_of_it=True)

    def _release(self, all_of_it: bool) -> None:
        starts, free, end = [0.0] * len(self.queue), 0, 0.0
        for k in range(len(self.queue) - 1, -1, -1):
            item = self.queue[k]
            starts[k] = min(item.max_start_v2, end + item.delta_v2)
            if not free and starts[k] == item.max_start_v2 < end + item.delta_v2:
                free = k  # nothing that may follow changes how this begins
            end = starts[k]
        count = len(self.queue) if all_of_it else free
        for k in range(count):
            self._go(self.queue[k], starts[k], starts[k + 1] if k + 1 < len(self.queue) else 0.0)
        del self.queue[:count]
        self.queued_s = 0.0

    def _go(self, item: Any, start: float, end: float) -> None:
        if not self.primed:
            self.primed, self.print_t = True, max(self.print_t, self.now + START_S)
        cruise = min(item.max_cruise_v2, 0.5 * (start + end + item.delta_v2))
        item.set_junction(start, cruise, end)
        self.print_t += item.accel_t + item.cruise_t + item.decel_t
        if hasattr(item, "motion") and end == 0.0 and not item.motion.rests_after:
            self.stops += 1


def played(path: Path, ahead_s: float | None, lead_s: float | None = None) -> StandIn:
    """Play a file of motion where moves before it are known so far ahead, s (None: it begins from rest)."""
    clock, text = _modules()
    host = StandIn(print_t=ahead_s or 0.0, primed=ahead_s is not None)
    before, text.LEAD_S = text.LEAD_S, text.LEAD_S if lead_s is None else lead_s
    file = text.MotionText(path)
    try:
        for batch in iter(file.read, ""):
            host.background()
            for line in batch.split("\n")[:-1]:
                host.now += LINE_S
                if line.startswith("FFCOMP_MOTION"):
                    for item in _items(clock, host, file.motion(int(line.partition("=")[2]))):
                        host.add(item)
    finally:
        text.LEAD_S = before
        file.close()
    host._release(all_of_it=True)
    return host


def _items(clock: Any, host: StandIn, record: Any) -> Iterator[Any]:
    if hasattr(record, "seconds"):
        yield clock.Rest(host, record.seconds)
        return
    if record.rests_before:
        yield clock.Gate(host, opens=True)
    yield clock.Block(host, record, record.places, record.places[:, 3], 1.0, 4.0)
    if record.rests_after:
        yield clock.Gate(host, opens=False)


def _modules() -> tuple[Any, Any]:
    if str(FOLDER) not in sys.path:
        sys.path.insert(0, str(FOLDER))
    from ffcomp_print import clock, text

    return clock, text
