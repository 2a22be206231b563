"""What the proof that two checkouts answer alike lets pass, and what it does not."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest

from validation.same_outputs import Verdict, all_runs, compare_arrays, compare_file, compare_json, compare_text

ANSWER = {"schema": "x/1", "rms_um": 1.25, "warnings": ["line 3: slowed to 89 % of its speed"], "places": [1, 2]}


def judged(**changes: Any) -> Verdict:
    return compare_json(ANSWER, ANSWER | changes, 1e-9, Verdict())


@pytest.mark.parametrize(
    "changes",
    [{}, {"new": 1}, {"rms_um": 1.25 * (1 + 1e-11)}, {"warnings": ["slower in line 3: 89 %"]}],
    ids=str,
)
def test_these_answers_are_the_same(changes: dict[str, Any]) -> None:
    assert not judged(**changes).differs


@pytest.mark.parametrize(
    "changes",
    [
        {"rms_um": 1.25 * (1 + 1e-6)},
        {"rms_um": float("nan")},
        {"rms_um": None},
        {"rms_um": "1.25"},
        {"schema": "x/2"},
        {"warnings": ["slower in line 3: 88 %"]},
        {"warnings": []},
        {"places": [1, 2, 3]},
        {"places": [2, 1]},
    ],
    ids=str,
)
def test_these_answers_differ(changes: dict[str, Any]) -> None:
    assert judged(**changes).differs


def test_a_missing_key_differs() -> None:
    assert compare_json(ANSWER, {"schema": "x/1"}, 1e-9, Verdict()).differs == 3


def test_only_what_a_whole_answer_took_is_the_clocks() -> None:
    assert not compare_json([{"seconds": 1.0}], [{"seconds": 2.0}], 1e-9, Verdict()).differs
    assert compare_json([{"slowed": {"seconds": 1.0}}], [{"slowed": {"seconds": 2.0}}], 1e-9, Verdict()).differs


def test_text_tells_the_line_and_the_largest_number() -> None:
    verdict = compare_text(b"G1 X1.5\nG1 X2\nG1 X3\n", b"G1 X1.5\nG1 X2.25\nG1 X3\nM84\n")
    assert (verdict.differs, verdict.largest) == (3, 0.25)  # an end without a line's end counts as one
    assert verdict.first.startswith("line 2:")


def test_arrays_must_agree_in_type_and_value() -> None:
    def archive(**arrays: Any) -> bytes:
        out = io.BytesIO()
        np.savez(out, **arrays)
        return out.getvalue()

    old = archive(tick=np.arange(3))
    assert not compare_arrays(old, archive(tick=np.arange(3), more=np.zeros(2))).differs
    assert compare_arrays(old, archive(tick=np.arange(3.0))).differs
    assert compare_arrays(old, archive(tick=np.array([0, 1, 5]))).largest == 3
    assert compare_arrays(old, archive(tock=np.arange(3))).differs


def test_messages_may_change_and_files_may_not() -> None:
    assert not compare_file(("message", "message"), "compensate", b"old", b"new").differs
    assert compare_file(("gcode", "gcode"), "compensate", b"old", b"new").differs
    assert compare_file(("json", "message"), "compensate", b"{}", b"").differs


def test_every_command_has_its_own_name_and_files() -> None:
    runs = all_runs()
    assert len({run.name for run in runs}) == len(runs)
    written = [name for run in runs for name in run.writes]
    assert len(set(written)) == len(written)
