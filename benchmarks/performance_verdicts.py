"""What docs/PERFORMANCE.md says of the time that a verdict takes; measured by hand, so it stands here as text."""

VERDICTS = """
### How long a verdict takes

`ffcomp diagnose` on straight axes simulates some thousand times under the same few commands. Eight lanes of 2400 rows,
CPU ms of a call and in brackets of its kernel, the best of twelve, before and after commands kept their splines and
whole rows stayed in registers (23 November 2026, on a machine with much other work):

| effect in the machine file | integration steps a row | before | after |
|---|---|---|---|
| none | 1 | 15.7 (6.7) | 3.9 (1.9) |
| none | 8 | 28.5 (18.8) | 9.8 (7.2) |
| dry friction | 1 | 16.9 (7.6) | 5.9 (3.5) |
| dry friction | 8 | 32.1 (23.0) | 18.1 (16.3) |

With a frame mode, a row of eight steps took 4.1 µs a lane, now 0.6. Motions are the same within 1e-8 for every effect.

Of whole verdicts only three could be measured, while the machine did the work of several others. A CoreXY with dry
friction: 65 s of CPU, now 42, the forces and creep alike to nine digits. Two cases of the blind test: a bed slinger
with play in its belts took 62 s until one effect was fitted, now 39; an axis with a hardening spring 57 s, now 25, for
less of the search is needed too since then. The aim, 20 s on straight axes, is therefore missed where an effect's shape
has to be searched: each contender is fitted again with exact steps, and one effect more is
looked for among all of them.
"""
