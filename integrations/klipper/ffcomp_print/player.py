# Plays the motion that ffcomp has computed, inside Klipper's or Kalico's host.
#
# Copyright (C) 2026  The ffcomp authors
#
# This file may be distributed under the terms of the GNU GPLv3 license.
"""The commands, and what joins the motion to the host: its queues, its limits, its offsets, its excluded objects."""

import os
import sys

import numpy as np

from .clock import Block, Gate, Rest
from .pieces import appender
from .reader import ANY_HEIGHT, MotionFileError, Wait
from .text import MotionText

NEAR_MM = 1e-4  # of a place: the same
SOON_S = 1e-6
ROUNDING = 1e-9
OFFSET_MM_PER_S = 2.0  # at which a new Z offset is taken up
MESH_EVERY = 8  # pieces: between them the mesh's height changes evenly


class Player:
    """`FFCOMP_PRINT FILE=…` and what it needs."""

    def __init__(self, config):
        self.printer = config.get_printer()
        self.printer.load_object(config, "virtual_sdcard")
        self.gcode_move = self.printer.load_object(config, "gcode_move")
        self.stop_s = config.getfloat("stop_time", 0.25, above=0.02, maxval=2.0)
        self.travel_speed = config.getfloat("travel_speed", 100.0, above=0.0)
        self.speed_share = config.getfloat("velocity_share", 1.25, minval=1.0, maxval=2.0)
        self.most_accel = config.getfloat("max_accel", 50000.0, above=0.0)
        self.text = self.toolhead = None
        gcode = self.printer.lookup_object("gcode")
        gcode.register_command("FFCOMP_PRINT", self.cmd_FFCOMP_PRINT, desc="Print a file of motion (ffcomp)")
        gcode.register_command("FFCOMP_MOTION", self.cmd_FFCOMP_MOTION, desc="A part of such a file; not for people")
        gcode.register_command("FFCOMP_FACTORS", self.cmd_FFCOMP_FACTORS, desc="A part of such a file; not for people")
        self.printer.register_event_handler("klippy:connect", self._connect)
        self._forget()

    def _connect(self):
        self.toolhead = self.printer.lookup_object("toolhead")
        host = sys.modules[type(self.toolhead).__module__]
        self.into_queue = appender(getattr(host, "chelper", None), self.toolhead.trapq_append)

    def _forget(self):
        self.offset = [0.0, 0.0, 0.0]  # mm, of the machine's coordinates from the file's
        self.tail_t = 0.0
        self.lift, self.lifted = np.zeros(3), False
        self.checked = None  # a box, all of which the machine reaches
        self.most_e = self.skipped_retraction = None
        self.last_e = 0.0
        self.own_speed = self.own_flow = 1.0  # the file's M220 and M221, which its motion contains

    # Beginning a print

    def cmd_FFCOMP_PRINT(self, gcmd):
        """Begin to print a file, as the virtual SD card prints one; from the card itself, in place of its file."""
        card = self.printer.lookup_object("virtual_sdcard")
        inside = card.is_cmd_from_sd()
        if card.is_active() and not inside:
            raise gcmd.error("A print is under way.")
        text = self._opened(gcmd, card)
        try:
            self._check(gcmd, text.header)
        except Exception:
            text.close()
            raise
        self._forget()
        self.text = text
        if inside:
            card.current_file.close()
            card.set_file_position(0)  # the card goes there next: in the file that it has then
        else:
            card._reset_file()
            card.file_position = 0
            card.print_stats.set_current_file(os.path.basename(text.name))
            self.printer.send_event("virtual_sdcard:load_file")
        card.current_file, card.file_size = text, text.size
        if not inside:
            card.do_resume()

    def _opened(self, gcmd, card):
        folder = os.path.realpath(card.sdcard_dirname)
        path = os.path.realpath(os.path.join(folder, gcmd.get("FILE").lstrip("/")))
        if os.path.commonpath([folder, path]) != folder:
            raise gcmd.error("FILE must lie in the folder of [virtual_sdcard].")
        try:
            return MotionText(path)
        except (OSError, MotionFileError) as error:
            raise gcmd.error("%s cannot be played: %s" % (os.path.basename(path), error)) from None

    def _check(self, gcmd, header):
        """Refuse what this printer's own settings do not allow; nothing is ever opened for a file."""
        speed, most = header["peak_velocity_mm_per_s"], self.toolhead.get_max_velocity()[0] * self.speed_share
        if speed > most:
            raise gcmd.error(
                "The file goes up to %.0f mm/s, and [printer] max_velocity with [ffcomp_print] velocity_share allow"
                " %.0f." % (speed, most)
            )
        accel = header["peak_acceleration_mm_per_s2"]
        if accel > self.most_accel:
            raise gcmd.error(
                "The file's command accelerates with up to %.0f mm/s^2, and [ffcomp_print] max_accel is %.0f."
                % (accel, self.most_accel)
            )
        shaper = self.printer.lookup_object("input_shaper", None)
        if header["compensated"] and shaper is not None and any(s.get_shaper()[0] > 1 for s in shaper.get_shapers()):
            raise gcmd.error(
                "The input shaper is on, and the file is compensated already: run"
                " SET_INPUT_SHAPER SHAPER_FREQ_X=0 SHAPER_FREQ_Y=0 first."
            )
        self._check_transforms(gcmd.error)
        self.slowing = min(1.0 / self.stop_s, 0.5 * self.toolhead.get_max_velocity()[1] / max(speed, 1.0))

    def _check_transforms(self, error):
        mesh, exclude = (self.printer.lookup_object(name, None) for name in ("bed_mesh", "exclude_object"))
        transform = self.gcode_move.move_transform
        if exclude is not None and transform is exclude:
            transform = exclude.next_transform
        if transform not in (None, self.toolhead, mesh):
            name = type(transform).__name__
            raise error("%s changes where moves go, and a file of motion cannot follow it: switch it off." % name)

    # Playing

    def cmd_FFCOMP_MOTION(self, gcmd):
        """Queue a record of the file."""
        record = self.text.motion(gcmd.get_int("N")) if self.text is not None else None
        if record is None:
            raise gcmd.error("FFCOMP_MOTION is a part of a print: FFCOMP_PRINT FILE=… prints one.")
        if isinstance(record, Wait):
            self._queue(Rest(self, record.seconds), None)
        elif self._is_excluded():
            self._skip(record)
        elif (part := self._after_skipped(record)) is not None:
            self._play(part, gcmd.error)

    def cmd_FFCOMP_FACTORS(self, gcmd):
        """Note which factors the file's motion contains: the host has them, too, from the file's own lines."""
        self.own_speed, self.own_flow = gcmd.get_float("SPEED", above=0.0), gcmd.get_float("FLOW", above=0.0)

    def _is_excluded(self):
        exclude = self.printer.lookup_object("exclude_object", None)
        return exclude is not None and exclude.current_object in exclude.excluded_objects

    def _skip(self, motion):
        if self.skipped_retraction is None:
            self.skipped_retraction = self._retraction()
        self._note_filament(motion)

    def _after_skipped(self, motion):
        """The motion; after an excluded object from where filament flows again, None if that is later."""
        if self.skipped_retraction is None:
            return motion
        rising = np.flatnonzero(np.diff(motion.places[:, 3]) > 0.0)
        first = int(rising[0]) if len(rising) else len(motion.places) - 1
        self._note_filament(motion.part(0, first))
        return motion.part(first, None) if len(rising) else None

    def _retraction(self):
        """How far the filament is drawn back in the file, mm."""
        return 0.0 if self.most_e is None else self.most_e - self.last_e

    def _note_filament(self, motion):
        filament = motion.places[:, 3]
        high = float(filament.max())
        self.most_e = high if self.most_e is None else max(self.most_e, high)
        self.last_e = float(filament[-1])

    def _play(self, motion, error):
        self._check_transforms(error)
        drawn = 0.0
        if self.skipped_retraction is not None:
            drawn, self.skipped_retraction = self._retraction() - self.skipped_retraction, None
        mesh = self._mesh(motion.places)
        start = motion.places[0, :3] if mesh is None else motion.places[0, :3] + mesh[0]
        self._find_height(motion, start)
        self._join(start + self.lift, drawn)
        if motion.rests_before:
            self._queue(Gate(self, opens=True), None)
        places = self._placed(motion, mesh)
        self._check_places(places)
        flow = self.gcode_move.extrude_factor / self.own_flow
        pushed = motion.places[:, 3] - motion.places[0, 3]
        filament = self.toolhead.commanded_pos[3] + (pushed if flow == 1.0 else pushed * flow)
        self._check_filament(filament, error)
        rate = self.gcode_move.speed_factor * 60.0 / self.own_speed
        rate = 1.0 if rate > 1.0 - ROUNDING else rate
        block = Block(self, motion, places, filament, rate, self.slowing)
        self._queue(block, [*places[-1, :3].tolist(), float(filament[-1])])
        self._note_filament(motion)
        if motion.rests_after:
            self._queue(Gate(self, opens=False), None)

    def _find_height(self, motion, start):
        """Where the file does not know its Z, after a macro, the nozzle stays at the height at which that left it."""
        if not motion.flags & ANY_HEIGHT:
            self.lift = np.zeros(3)
            self.lifted = False
        elif motion.rests_before or not self.lifted:
            self.lift = np.array([0.0, 0.0, self.toolhead.commanded_pos[2] - start[2] - self.offset[2]])
            self.lifted = True

    def _mesh(self, places):
        """What the bed mesh adds, (n + 1, 3) mm; None: it adds nothing."""
        mesh = self.printer.lookup_object("bed_mesh", None)
        if mesh is None or mesh.z_mesh is None:
            return None
        added = np.zeros((len(places), 3))
        at = sorted({*range(0, len(places), MESH_EVERY), len(places) - 1})
        target = mesh.fade_target
        heights = [
            mesh.get_z_factor(z) * (mesh.z_mesh.calc_z(x, y) - target) + target for x, y, z in places[at, :3].tolist()
        ]
        added[:, 2] = np.interp(np.arange(len(places)), at, heights)
        return added

    def _join(self, start, drawn):
        """Go to where the motion begins, if the nozzle is elsewhere."""
        now, wanted = self.toolhead.commanded_pos, self.gcode_move.homing_position[:3]
        if _near(now, start + self.offset) and not drawn:
            return
        self.offset = list(wanted)
        if _near(now, start + wanted) and not drawn:
            return
        if drawn > 0.0:
            self._extrude(-drawn)
        goal = (start + wanted).tolist()
        high = max(goal[2], now[2])
        for place in ([*now[:2], high], [*goal[:2], high], goal):
            self.toolhead.move([*place, *self.toolhead.commanded_pos[3:]], self.travel_speed)
        if drawn < 0.0:
            self._extrude(-drawn)
        self.gcode_move.reset_last_position()

    def _extrude(self, length):
        now = list(self.toolhead.commanded_pos)
        now[3] += length
        self.toolhead.move(now, 30.0)

    def _placed(self, motion, mesh):
        """Where the machine is to go; the motion's own places if they are the same.

        A new offset is taken up slowly, so that babysteps may come at any time.
        """
        wanted = self.gcode_move.homing_position[:3]
        if mesh is None and not any(wanted) and not any(self.offset) and not self.lift.any():
            return motion.places
        old = np.array(self.offset)
        most = OFFSET_MM_PER_S * motion.duration
        new = old + np.clip(np.array(wanted) - old, -most, most)
        self.offset = new.tolist()
        places = motion.places[:, :3] + (np.linspace(old, new, len(motion.places)) + self.lift)
        return places if mesh is None else places + mesh

    def _check_places(self, places):
        """The kinematics' own check, of the outermost places, unless all lie in a box that has been checked."""
        low, high = places[:, :3].min(axis=0), places[:, :3].max(axis=0)
        if self.checked is not None:
            low, high = np.minimum(low, self.checked[0]), np.maximum(high, self.checked[1])
            if (low == self.checked[0]).all() and (high == self.checked[1]).all():
                return
        try:  # what the machine reaches has no dents: with its corners a box is inside
            for x in (low[0], high[0]):
                for y in (low[1], high[1]):
                    for z in (low[2], high[2]):
                        self._check_place([float(x), float(y), float(z)])
            self.checked = low, high
        except self.printer.command_error:
            far = int((places[:, 0] ** 2 + places[:, 1] ** 2).argmax())
            for k in {far, *places[:, :3].argmin(axis=0).tolist(), *places[:, :3].argmax(axis=0).tolist()}:
                self._check_place(places[k, :3].tolist())

    def _check_place(self, place):
        here = self.toolhead.commanded_pos
        move_of = sys.modules[type(self.toolhead).__module__].Move
        move = move_of(self.toolhead, here, [*place, *here[3:]], self.travel_speed)
        if move.is_kinematic_move and move.move_d:
            self.toolhead.get_kinematics().check_move(move)

    def _check_filament(self, filament, error):
        extruder = self.toolhead.get_extruder()
        if filament[0] == filament[-1] and not np.ptp(filament):
            return
        heater = getattr(extruder, "heater", None)
        if heater is None:
            raise error("Extrude when no extruder present")
        if not heater.can_extrude:
            raise error("Extrude below minimum temp")

    def _queue(self, item, place):
        toolhead = self.toolhead
        if place is not None:
            toolhead.commanded_pos[:4] = place
        if toolhead.lookahead.add_move(item):
            toolhead._process_lookahead(lazy=True)
        if toolhead.print_time > toolhead.need_check_pause:
            toolhead._check_pause()
        if place is not None:
            self.gcode_move.reset_last_position()

    # Called when the look-ahead lets items go

    def note_time(self, print_time):
        """Remember where the queues have come to."""
        self.tail_t = print_time

    def begin_of(self, print_time):
        """When a block begins: exactly when the one before it has ended, or the host knows of a gap between them."""
        return self.tail_t if abs(print_time - self.tail_t) < SOON_S else print_time

    def append(self, begin, nozzle, thread):
        """Hand pieces to the queues from which the host's kinematics makes steps; returns when the last one ends."""
        end = self.into_queue(self.toolhead.trapq_append, self.toolhead.get_trapq(), begin, nozzle)
        extruder = self.toolhead.get_extruder()
        if extruder.get_trapq() is not None:
            self._append_filament(extruder, begin, thread)
        return end

    def _append_filament(self, extruder, begin, thread):
        stepper = extruder.extruder_stepper
        advance = getattr(stepper, "pressure_advance", 0.0)  # the queue asks whether to advance: not zero
        lasts, e, v, a = thread[-1, [0, 1, 7, 8]].tolist()
        thread[:, 5] *= advance * ((thread[:, 7] > 0.0) | (thread[:, 8] > 0.0))
        thread[:, 6] = 1.0 if getattr(stepper, "per_move_pressure_advance", False) else 0.0
        self.into_queue(extruder.trapq_append, extruder.get_trapq(), begin, thread)
        extruder.last_position = e + (v + 0.5 * a * lasts) * lasts


def _near(one, other):
    return all(abs(a - b) < NEAR_MM for a, b in zip(one, other))
