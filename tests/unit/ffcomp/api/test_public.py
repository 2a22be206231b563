"""`import ffcomp`: light, complete, callable by the verbs' names whatever was imported before, and documented."""

from __future__ import annotations

import inspect
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ffcomp
from ffcomp.errors import RequestError
from models.errors import MachineFileError

ROOT = Path(__file__).parents[4]
PRINT = ROOT / "docs" / "examples" / "print.gcode"


def python(code: str) -> str:
    """What a fresh interpreter prints."""
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    return answer.stdout.strip()


def test_a_print_imports_nothing_that_it_does_not_need(tmp_path: Path) -> None:
    """Each costs every user's every print 0.05 s and more."""
    unneeded = ("scipy.optimize", "scipy.spatial", "scipy.signal", "models.printer.printer", "matplotlib", "cvxpy")
    code = f"import ffcomp, sys; ffcomp.compensate({str(PRINT)!r}, 'mp-delta-pro', {str(tmp_path / 'out.gcode')!r})"
    assert python(f"{code}; print(*[m for m in {unneeded!r} if m in sys.modules])") == ""


def test_a_print_from_file_to_figure(tmp_path: Path) -> None:
    target = tmp_path / "out.gcode"
    machine = ffcomp.load_machine("mp-delta-pro")
    result = ffcomp.compensate(PRINT, machine, target)
    assert result.compensated is not None and result.uncompensated is not None
    assert result.compensated.contour_rms_um < 0.2 * result.uncompensated.contour_rms_um
    assert result.to_dict()["segments"] == result.segments > 0
    assert result.plot().get_axes()

    before, after = (ffcomp.simulate(path, machine, to_s=4.0) for path in (PRINT, target))
    assert after.track.contour_rms_um < 0.2 * before.track.contour_rms_um
    assert after.time_s.shape == after.error_um.shape and after.nozzle_mm.shape == after.reference_mm.shape
    assert np.sqrt(np.mean(after.error_um**2)) == pytest.approx(after.track.contour_rms_um)
    assert after.plot().get_axes()

    times = ffcomp.estimate(target, machine)
    assert times.time_s == pytest.approx(result.print_time_s, rel=1e-3)

    with pytest.raises(RequestError, match="already"):
        ffcomp.compensate(target, machine, tmp_path / "again.gcode")


def test_nothing_is_written_without_an_output(tmp_path: Path) -> None:
    before = PRINT.read_bytes()
    result = ffcomp.compensate(PRINT, "mp-delta-pro", predict=False)
    assert result.output is None and result.compensated is None and PRINT.read_bytes() == before
    with pytest.raises(RequestError, match="output"):
        result.plot()


def test_frequency_responses_are_those_of_the_model() -> None:
    found = ffcomp.frf("mp-delta-pro", [(0.0, 0.0), (-80.0, 0.0)], frequency_hz=np.array([10.0, 40.0]))
    assert found.values.shape == (2, 2, 3, 3) and found.positions_mm.tolist() == [[0, 0], [-80, 0]]
    answers = found.objects()
    assert [answer["position_mm"][:2] for answer in answers] == [[0, 0], [-80, 0]]
    magnitude = answers[1]["response"]["values"][0][0]["magnitude"]
    assert magnitude == pytest.approx(np.abs(found.values[1, :, 0, 0]))
    control = found.to_control()[0]
    assert np.asarray(control(2j * np.pi * 40.0)) == pytest.approx(found.values[0, 1])
    assert found.plot().get_axes()


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda: ffcomp.diagnose([], "mp-delta-pro"), "no recordings"),
        (lambda: ffcomp.gap((), "mp-delta-pro"), "no recordings"),
        (lambda: ffcomp.identify([], "mp-delta-pro"), "no data"),
        (lambda: ffcomp.compensate([], "mp-delta-pro"), "no files"),
        (lambda: ffcomp.compensate([PRINT, PRINT], "mp-delta-pro"), "a single print"),
        (lambda: ffcomp.frf("mp-delta-pro", (0, 0, 0)), r"the shape \(3,\)"),
        (lambda: ffcomp.frf("mp-delta-pro", 5), "positions_mm = 5: it must be"),
        (lambda: ffcomp.frf("mp-delta-pro", "middle"), "holds numbers"),
        (lambda: ffcomp.frf("mp-delta-pro", (0, np.nan)), "must be finite"),
        (lambda: ffcomp.frf("mp-delta-pro", frequency_hz=[0.0, 5.0]), "above 0 Hz"),
        (lambda: ffcomp.estimate(PRINT, "mp-delta-pro", offset_mm=(1.0,)), r"offset_mm = \(1.0,\): it must be"),
        (lambda: ffcomp.identify("a.csv", "kossel", known={"effector.total_mass_kg": 0.6}), "known = {.*}: it must be"),
        (lambda: ffcomp.compensate(PRINT, "kossel", max_error_um={"": "x"}), "max_error_um = {'': 'x'}: it must be"),
        (lambda: ffcomp.gap([3], "mp-delta-pro"), "a recording that has been read"),
        (lambda: ffcomp.estimate(PRINT, 3), "3: There is no machine of this name"),
    ],
)
def test_what_cannot_be_used_is_a_sentence(call: Callable[[], object], sentence: str) -> None:
    with pytest.raises((RequestError, MachineFileError), match=sentence):
        call()


@pytest.mark.parametrize("name", [name for name in ffcomp.__all__ if name != "__version__"])
def test_every_name_is_a_documented_function(name: str) -> None:
    function = getattr(ffcomp, name)
    assert inspect.isfunction(function) and name in dir(ffcomp)
    assert function.__doc__ and "Parameters" in function.__doc__ and "Raises" in function.__doc__
    described = function.__doc__.split("Parameters")[1]
    assert all(each in described for each in inspect.signature(function).parameters if each != "progress"), name
    assert inspect.signature(function).return_annotation not in (None, inspect.Signature.empty)


@pytest.mark.parametrize("name", sorted({*ffcomp.__all__} - {"__version__", "load_machine"}))
def test_every_argument_of_a_wrong_type_is_a_sentence_that_names_it(name: str) -> None:
    verb: Any = getattr(ffcomp, name)
    options = inspect.signature(verb).parameters
    right = {key: "none" for key, each in options.items() if each.default is each.empty}
    checked_later = {"machine", "plant", "recordings", "positions_mm", "frequency_hz", "settings"}  # by the verb
    for option in [each for each in options if each not in checked_later]:
        with pytest.raises(RequestError, match=option if option != "rate_hz" else "rate"):
            verb(**right | {option: object()})
