# Hands pieces of motion to the host's queues.
#
# Copyright (C) 2026  The ffcomp authors
#
# This file may be distributed under the terms of the GNU GPLv3 license.
"""Many pieces at once into a queue of the host, from which its kinematics makes steps.

One by one from Python they cost the host more than anything else of a print. So `pieces.c` is compiled beside this file
when it is first needed, as the host compiles its own; where there is no compiler, Python hands them over.
"""

import logging
import os
import subprocess

import numpy as np

HERE = os.path.dirname(os.path.realpath(__file__))
SOURCE, LIBRARY = os.path.join(HERE, "pieces.c"), os.path.join(HERE, "pieces-compiled.so")
COMPILER = "gcc"
DECLARED = "double ffcomp_append(void *append, void *queue, double t, size_t count, const double *rows);"
NUMBERS = 13  # that the host's trapq_append takes after the queue


def one_by_one(append, queue, t, rows):
    """Append rows (n, 9): duration, place (3), direction (3), speed, acceleration; returns when the last one ends."""
    for lasts, x, y, z, ux, uy, uz, v, a in rows.tolist():
        if v or a:
            append(queue, t, lasts, 0.0, 0.0, x, y, z, ux, uy, uz, v, 0.0, a)
        t += lasts
    return t


def appender(chelper, append):
    """A function as `one_by_one` for the host's own `trapq_append`, of its library; compiled if that is possible."""
    try:
        return _compiled(chelper.get_ffi()[0], append)
    except Exception as error:  # whatever is missing, the print is the same
        logging.info("ffcomp_print: pieces go one by one, which costs the host a little more (%s)", error)
        return one_by_one


def _compiled(hosts, append):
    """`append` is a function of the host's library, and `hosts` what knows of its kind."""
    import cffi

    if [each.cname for each in hosts.typeof(append).args[1:]] != ["double"] * NUMBERS:
        raise TypeError("this host's queue takes something else")
    if not os.path.exists(LIBRARY) or os.path.getmtime(LIBRARY) < os.path.getmtime(SOURCE):
        _compile()
    ffi = cffi.FFI()
    ffi.cdef(DECLARED)
    many, address = ffi.dlopen(LIBRARY).ffcomp_append, ffi.cast("void *", append)

    def all_at_once(of_queue, queue, t, rows):
        if of_queue != append:
            return one_by_one(of_queue, queue, t, rows)
        buffer = ffi.from_buffer("double[]", np.ascontiguousarray(rows))
        return many(address, ffi.cast("void *", queue), t, len(rows), buffer)

    return all_at_once


def _compile():
    new = "%s.%d" % (LIBRARY, os.getpid())
    subprocess.run(
        [COMPILER, "-O2", "-shared", "-fPIC", "-o", new, SOURCE], check=True, capture_output=True, timeout=60
    )
    os.replace(new, LIBRARY)
