"""What a compensated file is held against by others: a reader, a clock and checks that share no code with ffcomp.

Nothing here imports `ffcomp`, `gcode` or `models`. A mistake in their understanding of a file is not repeated here,
unless the same mistake was made twice.
"""
