# Plays the motion that ffcomp has computed, inside Klipper's or Kalico's host.
#
# Copyright (C) 2026  The ffcomp authors
#
# This file may be distributed under the terms of the GNU GPLv3 license.
"""The section `[ffcomp_print]` of printer.cfg, and the command `FFCOMP_PRINT FILE=…`."""

from .player import Player


def load_config(config):
    """Create the player; the host calls this for `[ffcomp_print]`."""
    return Player(config)
