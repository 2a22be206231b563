# Runs Kalico's host in batch mode, with the module of this folder and a scenario.
#
# Copyright (C) 2026  The ffcomp authors
#
# This file may be distributed under the terms of the GNU GPLv3 license.
"""Kalico's host in batch mode: `python batch.py SCENARIO.json`, by the Python of an environment that has Kalico.

Nothing of the host is changed on disk. The scenario's keys: config, board, output, log and result (paths); `start`,
lines of G-code; `print`, the command that begins a print; `at`, pairs of a number of `FFCOMP_MOTION` and the G-code to
run when it has been reached. The result: what the print took and where it ended.
"""

import json
import os
import re
import sys
import time
from pathlib import Path

import klippy.plugins
import klippy.printer as host
import klippy.serialhdl as serialhdl

HERE = Path(__file__).resolve().parent
LONGEST_S = 600.0


def find_module():
    """Let the host find the module here, as if it lay in klippy/plugins."""
    klippy.plugins.__path__.append(str(HERE))
    modules = host.Printer._iter_modules

    def also_here(prefix, path):
        yield from modules(prefix, path)
        if prefix == "klippy.plugins.":
            yield from (module for module in modules(prefix, HERE) if module.name == "ffcomp_print")

    host.Printer._iter_modules = staticmethod(also_here)


def write_all_steps():
    """Let the host end only when its writer has nothing left."""
    disconnect = serialhdl.SerialReader.disconnect

    def patient(reader):
        begun, quiet = time.time(), 0
        while reader.serialqueue is not None and quiet < 3 and time.time() - begun < LONGEST_S:
            waiting = re.findall(r"(?:ready_bytes|upcoming_bytes)=(\d+)", reader.stats(0.0))
            quiet = 0 if any(int(number) for number in waiting) else quiet + 1
            time.sleep(0.005)
        return disconnect(reader)

    serialhdl.SerialReader.disconnect = patient


class Scenario:
    """Runs when the host is ready, and closes its input at the end."""

    def __init__(self, wanted):
        self.wanted, self.number, self.messages = wanted, 0, []
        self.reading, self.writing = os.pipe()

    def attach(self):
        init = host.Printer.__init__

        def hooked(printer, *args, **kwargs):
            init(printer, *args, **kwargs)
            self.printer = printer
            printer.register_event_handler("klippy:ready", self.ready)

        host.Printer.__init__ = hooked

    def ready(self):
        self.gcode, self.reactor = self.printer.lookup_object("gcode"), self.printer.get_reactor()
        self.gcode.register_output_handler(self.messages.append)
        if self.gcode.ready_gcode_handlers.get("FFCOMP_MOTION") is not None:
            self.motion = self.gcode.register_command("FFCOMP_MOTION", None)
            self.gcode.ready_gcode_handlers["FFCOMP_MOTION"] = self.counted
        self.reactor.register_callback(self.run)

    def counted(self, gcmd):
        self.motion(gcmd)
        self.number += 1

    def run(self, _):
        toolhead, card = (self.printer.lookup_object(name) for name in ("toolhead", "virtual_sdcard"))
        result = {}
        try:
            for line in self.wanted["start"]:
                self.gcode.run_script(line)
            begun, cpu = toolhead.get_last_move_time(), time.process_time()
            self.gcode.run_script(self.wanted["print"])
            for number, script in self.wanted.get("at", []):
                while card.is_active() and self.number < number:
                    self.reactor.pause(self.reactor.NOW)
                for line in script.splitlines():
                    self.gcode.run_script(line)
            while card.is_active():
                self.reactor.pause(self.reactor.monotonic() + 0.01)
            ended = toolhead.get_last_move_time()
            toolhead.flush_step_generation()
            result = {"begin_s": begun, "end_s": ended, "cpu_s": time.process_time() - cpu, "records": self.number}
            result["position"] = list(toolhead.commanded_pos)
            steppers = [*toolhead.get_kinematics().get_steppers(), toolhead.get_extruder().extruder_stepper.stepper]
            result["steps"] = {s.get_name(): s.get_mcu_position() for s in steppers}
            result["state"] = self.printer.lookup_object("print_stats").get_status(0.0)["state"]
            result["limits"] = [
                *toolhead.get_max_velocity(),
                toolhead.square_corner_velocity,
                toolhead.min_cruise_ratio,
            ]
        except Exception as error:
            result["error"] = str(error)
        finally:
            result["said"] = self.messages
            Path(self.wanted["result"]).write_text(json.dumps(result))
            os.close(self.writing)


def main(path):
    """Run one scenario."""
    wanted = json.loads(Path(path).read_text())
    find_module()
    write_all_steps()
    scenario = Scenario(wanted)
    scenario.attach()
    source = "/dev/fd/%d" % scenario.reading
    sys.argv = ["klippy", wanted["config"], "-i", source, "-o", wanted["output"], "-d", wanted["board"]]
    sys.argv += ["-l", wanted["log"]]
    host.main()


if __name__ == "__main__":
    main(sys.argv[1])
