"""Monte-Carlo plants in several processes: the same numbers, to the last bit. On a cluster: tests/e2e/test_batch.py."""

from __future__ import annotations

from functools import partial

import pytest

from ffcomp.compare.parallel import in_processes
from ffcomp.compensate.batch import workers
from tests.support.mismatch import SEEDS, study, tuned


def test_the_numbers_do_not_depend_on_the_processes() -> None:
    (alone, _), (together, told) = study(), study(2)
    assert alone == together
    for method in tuned():
        spread, _ = alone[method.name]
        assert spread is not None and len(set(spread.contour_rms_um)) == SEEDS  # every plant is its own
    assert alone["mzv"][1] is not None
    assert told == sorted(told) and told[-1] == pytest.approx(1.0)


def test_what_fails_in_a_process_is_raised_here() -> None:
    with workers(2) as at_once, pytest.raises(ZeroDivisionError):
        in_processes([partial(divmod, 1, k) for k in (2, 1, 0)], at_once, "dividing", lambda what, share: None)
