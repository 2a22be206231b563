#!/bin/sh
# Draw the models and slice them again. Needs python3 with numpy and PrusaSlicer 2.5 (Debian: prusa-slicer).
set -eu
cd "$(dirname "$0")"
models=$(mktemp -d)
trap 'rm -r "$models"' EXIT

python3 make_models.py "$models"
# a round bed of 135 mm about the origin, as a polygon of 24 corners
bed=$(python3 -c "
from math import cos, pi, sin
print(','.join(f'{135 * cos(i * pi / 12):.2f}x{135 * sin(i * pi / 12):.2f}' for i in range(24)))")

for print in ringing_tower lobed_vase far_star; do
    prusa-slicer --export-gcode --loglevel 1 --load common.ini --load "$print.ini" --bed-shape "$bed" \
        --center 0,0 --output "$print.gcode" "$models/$print.stl"
done
