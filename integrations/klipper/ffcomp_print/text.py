# What the virtual SD card reads instead of G-code.
#
# Copyright (C) 2026  The ffcomp authors
#
# This file may be distributed under the terms of the GNU GPLv3 license.
"""A file of motion in the guise of a G-code file, for the host's virtual SD card.

Lines of the print are themselves; each record of motion is a line `FFCOMP_MOTION N=…` of constant length. So the card's
pause, resume, cancel, progress and statistics are the host's own, and other commands take their turn between lines.
"""

from collections import deque

from .reader import Motion, MotionFileError, Text, open_motion, records

LINE = "FFCOMP_MOTION N=%09d"
AT_ONCE = 4  # lines; the host does other work between two reads
LEAD_S = 1.0  # of a path's beginning, at once too: with less in its queues the host ends what it has at rest
KEPT = 256  # lines, that a pause may go back to


class MotionText:
    """What the card asks of a file."""

    def __init__(self, path):
        self.name = path
        self._stream, self.header = open_motion(path)
        self._first = self._stream.tell()
        self.size = self.header["text_bytes"] + self.header["records"] * (len(LINE % 0) + 1)
        self._restart()

    def _restart(self):
        self._stream.seek(self._first)
        self._records = records(self._stream, self.header)
        self._delivered = deque()  # (where it begins, line) of the last lines that were handed out
        self._motions = {}
        self._end = self._number = self._ahead = 0
        self._path_s = LEAD_S  # of the path under way, as far as it was handed out; at rest nothing more is needed

    def motion(self, number):
        """The record that `FFCOMP_MOTION N=…` stands for; None if it is not near."""
        return self._motions.get(number)

    def read(self, _size=-1):
        """Some lines more; nothing at the end."""
        if self._ahead:  # after a pause: what was handed out, and not run
            lines = [line for _, line in list(self._delivered)[-self._ahead :]]
            self._ahead = 0
            return "".join(line + "\n" for line in lines)
        lines = []
        for record in self._records:
            lines.extend(record.lines if isinstance(record, Text) else [self._line(record)])
            if len(lines) >= (AT_ONCE if self._path_s >= LEAD_S else KEPT // 2):
                break
        for line in lines:
            self._delivered.append((self._end, line))
            self._end += len(line.encode()) + 1
        while len(self._delivered) > KEPT + len(lines):
            self._delivered.popleft()
        return "".join(line + "\n" for line in lines)

    def _line(self, record):
        self._number += 1
        self._motions[self._number] = record
        if isinstance(record, Motion):
            begun_s = 0.0 if record.rests_before else self._path_s
            self._path_s = LEAD_S if record.rests_after else begun_s + record.duration
        self._motions.pop(self._number - KEPT, None)
        return LINE % self._number

    def seek(self, place, whence=0):
        """Go back to a line that was handed out, or to the beginning; the host's log of a shutdown begins anywhere."""
        if whence == 0 and place == self._end:
            self._ahead = 0
        elif whence == 0 and self._delivered and self._delivered[0][0] <= place < self._end:
            self._ahead = sum(at >= place for at, _ in self._delivered)
        elif whence == 0 and place == 0:
            self._restart()
        else:
            raise MotionFileError("A print from a file of motion goes on where it was paused, or from its beginning.")
        return place

    def tell(self):
        """Where the next line begins."""
        return self._end

    def close(self):
        """Give up the file."""
        self._stream.close()
