"""Repeats that lie apart in time are found, said and moved; repeats that do not repeat are refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffcomp.diagnosis.noise import noise_from_repeats
from ffcomp.diagnosis.problem import Candidate, Observation, Parameter, Repeats
from ffcomp.diagnosis.problems import check_repeating
from ffcomp.diagnosis.recording_clocks import (
    aligned,
    as_recorded,
    delay_parameters,
    repeats_of,
    with_stated_clock,
)
from ffcomp.errors import MeasurementError
from ffcomp.measurement.recording import Recording
from ffcomp.numerics.delay import delayed

RATE_HZ, N, NOISE = 1600.0, 2400, 0.02
T = np.arange(N) / RATE_HZ


def motion(late_s: float = 0.0) -> np.ndarray:
    """Tones that begin and end at rest, (n, 2)."""
    t = T - late_s
    window = np.where((t > 0.1) & (t < 1.2), np.sin(np.pi * (t - 0.1) / 1.1) ** 2, 0.0)
    tones = [np.sin(2 * np.pi * f * t + f) for f in (6.0, 17.0, 29.0, 48.0)]
    return np.column_stack([window * (tones[0] + tones[2]), window * (tones[1] + tones[3])])


def observed(measured: np.ndarray, repeat: int, seed: int = 0) -> Observation:
    noise = NOISE * np.random.default_rng([repeat, seed]).standard_normal(measured.shape)
    moving = np.gradient(motion(), axis=0)
    return Observation(f"x-{repeat}.csv", "x", (0.0, 0.0), RATE_HZ, ("acc_x", "acc_y"), measured + noise, moving)


def test_a_signal_is_moved_by_less_than_a_sample() -> None:
    np.testing.assert_allclose(delayed(motion(), 2.3e-4, RATE_HZ), motion(2.3e-4), atol=1e-4)
    drifting = delayed(motion(), 0.0, RATE_HZ, 2e-4)
    middle = (N - 1) / 2 / RATE_HZ
    np.testing.assert_allclose(drifting[1000], motion(2e-4 * (T[1000] - middle))[1000], atol=1e-4)
    gap = motion()
    gap[5] = np.nan
    assert np.isnan(delayed(gap, 1e-3, RATE_HZ)).sum() == 2


@pytest.mark.parametrize("late_ms", [-3.0, -0.4, 1.7])
def test_a_late_repeat_is_found_and_moved(late_ms: float) -> None:
    both = [observed(motion(), 1), observed(motion(1e-3 * late_ms), 2)]
    (found,) = repeats_of(both)
    assert found.apart and not found.differ
    assert 1e3 * (found.lag_s[1] - found.lag_s[0]) == pytest.approx(late_ms, abs=0.02)
    floor, raw = (noise_from_repeats(o) for o in (aligned(both, [found]), both))
    assert floor is not None and raw is not None
    white = 2 * NOISE**2 / RATE_HZ
    assert np.median(floor.density["acc_x"]) == pytest.approx(white, rel=0.3)
    assert raw.density["acc_x"][:30].mean() > 3 * floor.density["acc_x"][:30].mean()
    assert f"{abs(late_ms):.2g} ms late" in found.late()


def test_good_repeats_stay_as_they_are() -> None:
    both = [observed(motion(), n) for n in (1, 2, 3)]
    (found,) = repeats_of(both)
    assert not found.apart and not found.differ
    assert found.share < 0.05 and found.over_rest == pytest.approx(1.0, abs=0.3)
    assert aligned(both, [found]) == both
    check_repeating([found])


def test_a_signal_that_feels_nothing_of_the_motion_does_not_shift_the_others() -> None:
    """By its own noise it would weigh as much as they do; a lag that is none makes resonances differ."""
    for n in range(1, 9, 2):
        (found,) = repeats_of([observed(motion() * [1.0, 1e-4], repeat) for repeat in (n, n + 1)])
        assert 1e6 * (max(found.lag_s) - min(found.lag_s)) < 20.0  # or it would be 60


def test_missing_samples_of_one_are_no_difference() -> None:
    holes = motion()
    holes[600:1500:100] = holes[601:1501:100] = np.nan
    (found,) = repeats_of([observed(motion(), 1), observed(holes, 2)])
    assert not found.apart and not found.differ and found.over_rest == pytest.approx(1.0, abs=0.3)


def test_repeats_that_do_not_repeat_are_refused_with_files_and_remedy() -> None:
    stiffer = motion() * [1.0, 0.6]
    (found,) = repeats_of([observed(motion(), 1), observed(stiffer, 2)])
    assert found.differ
    with pytest.raises(MeasurementError, match=r"x-1.csv and x-2.csv") as error:
        check_repeating([found])
    assert "do not repeat" in str(error.value) and "record both again" in str(error.value)
    assert error.value.exit_code == 5


def test_loud_sensors_are_no_reason_to_refuse() -> None:
    """A third of the signals, but as much at rest."""
    loud = [
        replace(o, measured=motion() + 12 * (o.measured - motion())) for o in (observed(motion(), n) for n in (1, 2))
    ]
    (found,) = repeats_of(loud)
    assert found.share > 0.2 and not found.differ
    without_rest = [replace(o, speed=np.ones_like(o.speed)) for o in loud]
    (found,) = repeats_of(without_rest)  # the noise is then what is left where the motion has no frequencies
    assert found.over_rest is None and not found.differ
    stiffer = replace(loud[1], measured=loud[1].measured - 0.6 * motion() * [0.0, 1.0])
    assert repeats_of([without_rest[0], replace(stiffer, speed=np.ones_like(stiffer.speed))])[0].differ


def test_sensors_that_count_are_silent_at_rest_and_repeat_nevertheless() -> None:
    """Friction lets little through: some counts, which differ by one."""
    count = 0.05 * float(np.std(motion()))
    small = [
        replace(o, measured=count * np.round(0.1 * o.measured / count)) for o in (observed(motion(), n) for n in (1, 2))
    ]
    (found,) = repeats_of(small)
    assert found.share > 0.03 and not found.differ


def recording(**comments: str) -> Recording:
    gaps = np.zeros(N, dtype=bool)
    return Recording("x-1.csv", T, np.zeros((N, 3)), "nozzle", {}, {}, gaps, comments)


def test_a_clock_in_doubt_gets_parameters() -> None:
    one = observed(motion(), 1)
    assert delay_parameters([recording()], [one], []) == []
    found = {p.name: p.sd for p in delay_parameters([recording(delay_sd_s="3e-4", drift_sd="5e-5")], [one], [])}
    assert found == {"recording.x.delay_s": 3e-4, "recording.x.drift": 5e-5}
    apart = Repeats((-1e-3, 1e-3), True, 0.01, 1.0, experiment="y", members=(1, 2), files=("y-1.csv", "y-2.csv"))
    (by_hand,) = delay_parameters([recording()], [one], [apart])
    assert 1e-3 < by_hand.sd < 3e-3
    late = as_recorded({"recording.x.delay_s": 1e-3}, one, motion())
    np.testing.assert_allclose(late, motion(1e-3), atol=1e-4)


def test_signals_of_two_chips_are_on_two_clocks() -> None:
    """A bed slinger's: each is moved onto its own repeats, and each has a delay and a drift."""
    two = Recording(
        "x-1.csv", T, np.zeros((N, 3)), "nozzle", {}, {}, np.zeros(N, dtype=bool), {"clocks": "acc_x, acc_y"}
    )
    clocks = two.clocks_of(("acc_x", "acc_y", "pos_x"))
    assert clocks == ("", "acc_y", "") and recording().clocks_of(("acc_x", "acc_y")) == ("", "")

    late = motion()
    late[:, 1] = motion(4e-4)[:, 1]
    both = [replace(observed(x, n), clocks=clocks[:2]) for n, x in enumerate((motion(), late), 1)]
    head, bed = repeats_of(both)
    assert not head.apart and bed.apart and (head.signals, bed.signals) == (("acc_x",), ("acc_y",))
    assert bed.lag_s[1] - bed.lag_s[0] == pytest.approx(4e-4, abs=2e-5)
    together = aligned(both, [head, bed])
    np.testing.assert_array_equal(together[1].measured[:, 0], both[1].measured[:, 0])
    floor = noise_from_repeats(together)
    assert floor is not None
    assert np.median(floor.density["acc_y"]) == pytest.approx(2 * NOISE**2 / RATE_HZ, rel=0.3)

    stated = replace(two, comments={**two.comments, "delay_sd_s": "3e-4", "drift_sd": "5e-5"})
    named = [p.name for p in delay_parameters([stated, stated], both, [])]
    assert named == [f"recording.x{clock}.{what}" for clock in ("", ".acc_y") for what in ("delay_s", "drift")]
    moved = as_recorded({"recording.x.acc_y.delay_s": 4e-4}, both[0], motion())
    np.testing.assert_allclose(moved, late, atol=1e-4)


def test_what_is_late_on_the_firmwares_clock_is_the_machine() -> None:
    """No chip can tell its own clock from a machine that is late; a capture that the firmware dates can."""

    def candidate(name: str) -> Candidate:
        return Candidate(name, (Parameter(f"effects.{name}.size", 0.0, 1e-2),), {f"effects.{name}.size": 1e-4})

    def widths(*recordings: Recording) -> list[float]:
        named = (candidate(n) for n in ("sensor_time_offset", "command_delay"))
        return [with_stated_clock(each, recordings).amplitudes[0].sd for each in named]

    dated, logged = recording(delay_sd_s="3e-4"), recording(delay_sd_s="5e-5")
    assert widths(dated, logged) == [3e-4, 1e-2]
    assert widths(dated, recording()) == [1e-2, 1e-2]  # one of them was joined by hand
