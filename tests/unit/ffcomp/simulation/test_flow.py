"""What flows along a plan: the closed form of a ramp, and the loop of the tests' own extruder."""

from __future__ import annotations

from dataclasses import replace

from ffcomp.report.show import show_figure
from ffcomp.simulation.forecast import NO_FORECAST
from ffcomp.simulation.preview import preview
from models.file import load_machine
from tests.unit.ffcomp.compensation.test_program import FREE, written


def test_show_draws_the_flow_where_the_machine_file_states_the_pressure() -> None:
    file = written(FREE)
    machine = load_machine("mp-delta-pro")
    with_flow = preview(file.text, "squares", replace(machine, pressure=FREE))
    without = preview(file.text, "squares", machine)
    assert without.flows is None and with_flow.flows is not None
    drawn = [show_figure(each, NO_FORECAST, "squares") for each in (without, with_flow)]
    labels = [[axes.get_ylabel() for axes in figure.axes] for figure in drawn]
    assert ["filament, mm/s" in each for each in labels] == [False, True]
