// Hands many pieces of motion to the host's queue at once.
//
// Copyright (C) 2026  The ffcomp authors
//
// This file may be distributed under the terms of the GNU GPLv3 license.

#include <stddef.h>

// The host's own trapq_append, whose address pieces.py gives.
typedef void (*append_fn)(void *queue, double print_time, double accel_t, double cruise_t, double decel_t,
                          double x, double y, double z, double x_r, double y_r, double z_r,
                          double start_v, double cruise_v, double accel);

// Whether a row goes on as the one before it: in the same direction, at the same even speed.
static int
goes_on(const double *r)
{
    const double *before = r - 9;
    for (int k = 4; k < 8; k++)
        if (r[k] != before[k])
            return 0;
    return !r[8] && !before[8];
}

// Rows of nine: duration, place (3), direction (3), speed, acceleration. Returns when the last one ends.
double
ffcomp_append(append_fn append, void *queue, double t, size_t count, const double *rows)
{
    const double *end = rows + 9 * count;
    for (const double *r = rows; r < end;) {
        const double *first = r;
        double lasts = r[0];
        for (r += 9; r < end && goes_on(r); r += 9)
            lasts += r[0];
        if (first[7] || first[8])
            append(queue, t, lasts, 0., 0., first[1], first[2], first[3], first[4], first[5], first[6], first[7], 0.,
                   first[8]);
        t += lasts;
    }
    return t;
}
