"""What two ways of handing pieces to the host's queue leave in it; a program for the Python that has Kalico.

`python host_pieces.py FOLDER LIBRARY`: the module's folder, and where to compile to. Prints JSON.
"""

from __future__ import annotations

import json
import sys

sys.path.insert(0, sys.argv[1])

import numpy as np
from ffcomp_print import pieces
from klippy import chelper

ffi, host = chelper.get_ffi()
pieces.LIBRARY = sys.argv[2]


def rows() -> np.ndarray:
    """Forty pieces: some go on as the one before, some rest, some slow down."""
    made, place = np.zeros((40, 9)), 0.0
    for k, row in enumerate(made):
        speed = (3.0, 3.0, 5.0, 0.0)[k // 2 % 4]
        row[:] = 0.004, place, 0.0, 0.0, 1.0, 0.0, 0.0, speed, -50.0 if k % 11 == 5 and speed else 0.0
        place += (row[7] + 0.5 * row[8] * row[0]) * row[0]
    return np.asfortranarray(made)  # as columns that were put side by side may come


def left_by(put: object) -> dict[str, object]:
    queue = host.trapq_alloc()
    end = put(host.trapq_append, queue, 1.0, rows())  # type: ignore[operator]
    host.trapq_finalize_moves(queue, end + 1.0, 0.0)
    found = ffi.new("struct pull_move[]", 100)
    count = host.trapq_extract_old(queue, found, 100, 0.0, end + 1.0)
    moves = sorted((m.print_time, m.move_t, m.start_x, m.start_v, m.accel, m.x_r) for m in found[0:count])
    return {"end": end, "moves": moves, "compiled": put is not pieces.one_by_one}


found = [left_by(pieces.one_by_one), left_by(pieces.appender(chelper, host.trapq_append))]
pieces.LIBRARY, pieces.COMPILER = f"{sys.argv[2]}.none", "no-such-compiler"
found.append(left_by(pieces.appender(chelper, host.trapq_append)))
print(json.dumps(found))
