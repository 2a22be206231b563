"""Measurements along one axis of a cartesian machine, each as data that its modes are fitted to.

A datum has two nuisance parameters of its own, which are fitted along with the modes: a gain and a floor, or a gain and
a delay. Its `model` says how the modes H(f) (see `modal_fit.py`) show in it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from ffcomp.inference.problem import Observation
from ffcomp.measurement.frf import CARRIAGES_AS_AXES, FrequencyResponse
from ffcomp.measurement.modal import WindowedPower, single_modes
from ffcomp.measurement.swept import SweptBand, cut_off
from models.arrays import ComplexArray, FloatArray, IntArray

NO_FLOOR = 10.0  # ln of a share of the smallest power
LONGEST_DELAY_MS = 100.0
DELAYS_MS = np.linspace(-40.0, 40.0, 161)  # tried: a capture that is upside down is aligned half a period wrong
USUAL_AVERAGES = 400  # segments of half a second or so, half overlapping, of a test that takes two minutes
FLOOR_SHARE = 0.1
COARSE = 0.3  # model error while the modes are looked for
BLOCK_HZ = 5.0  # a model's error keeps its sign over about so wide a band
WRONG_SCALE = 0.15  # of a sensor's gain


def closed_form(modes: FloatArray, frequency_hz: FloatArray) -> ComplexArray:
    """Evaluate H at any frequencies; modes (m, 3), columns frequency Hz, damping ratio, share."""
    return np.asarray(np.tensordot(modes[:, 2], single_modes(modes[:, 0], modes[:, 1], frequency_hz), axes=1))


def blocks_of(frequency_hz: FloatArray) -> IntArray:
    """Return the block of each line, (k,), within which a model errs alike."""
    return np.asarray((frequency_hz // BLOCK_HZ).astype(np.int64))


def observed_response(response: FrequencyResponse) -> Observation:
    """Return real, then imaginary parts, (2 k,), each with half of the variance."""
    power = np.abs(response.value) ** 2
    noise = response.variance + 1e-16 * np.mean(power)  # noise-free data: finite weights all the same
    return Observation(
        measured=np.concatenate([response.value.real, response.value.imag]),
        noise=np.tile(noise / 2, 2),
        size=np.tile(power / 2, 2),
        blocks=np.tile(blocks_of(response.frequency_hz), 2),
    )


@dataclass(frozen=True, eq=False)
class Spectrum:
    """The spectrum of a resonance test along the axis it excited; nuisance parameters are ln g and ln c."""

    source: str
    axis: str
    frequency_hz: FloatArray  # (k,) evenly spaced
    value: FloatArray  # (k,) power spectral density
    averages: int = USUAL_AVERAGES  # segments behind it
    remark: str = ""
    swept: SweptBand | None = None  # None: not known, or as wide as firmware's own tests

    @property
    def level(self) -> FloatArray:
        """(k,) the factor that levels the value of an axis that does not vibrate."""
        return np.asarray(1.0 / self.frequency_hz**2)

    @property
    def unit(self) -> str:
        """Unit of the levelled value."""
        return "power / f², of any scale"

    @property
    def limits(self) -> FloatArray:
        """(2, 2) lowest and highest ln g and ln c."""
        lowest = float(np.log(self.value.min()))
        return np.array([[-np.inf, np.inf], [lowest - NO_FLOOR, lowest + 1.0]])

    @cached_property
    def lines(self) -> WindowedPower:
        """What its lines show of a response."""
        return WindowedPower(self.frequency_hz, float(self.frequency_hz[1] - self.frequency_hz[0]))

    def begin(self, modes: FloatArray) -> FloatArray:
        """Estimate ln g and ln c with given modes."""
        return self.begin_at(self.lines.power(closed_form(modes, self.lines.fine_hz)))

    def begin_at(self, power: FloatArray) -> FloatArray:
        """Estimate ln g and ln c with a given power (k,) through the window."""
        floor = float(np.log(self.value.min())) - 1.0
        return np.array([np.average(np.log(self.value / power), weights=1 / self.observed.variance(1.0)), floor])

    def model(self, modes: FloatArray, nuisance: FloatArray) -> FloatArray:
        """Predict the power through the window."""
        return self.shown(self.lines.power(closed_form(modes, self.lines.fine_hz)), nuisance)

    def shown(self, power: FloatArray, nuisance: FloatArray) -> FloatArray:
        """Return what is measured of a power (k,) through the window."""
        return np.asarray(np.exp(nuisance[0]) * power + np.exp(nuisance[1]))

    @cached_property
    def observed(self) -> Observation:
        """The logarithms of the spectrum, (k,), and how far they may be off."""
        answer = self.value / self.frequency_hz**2  # of the axis to even accelerations
        noise = self.value.min() / self.value  # at most: it is even, and there is some motion everywhere
        return Observation(
            measured=np.log(self.value),
            noise=(2 * noise + noise**2) / self.averages,
            size=1 + FLOOR_SHARE * answer.max() / answer,
            blocks=blocks_of(self.frequency_hz),
        )

    def rows(self, modes: FloatArray, nuisance: FloatArray) -> FloatArray:
        """Predict the logarithms: (k,)."""
        return np.log(self.model(modes, nuisance))

    def remarks(self, nuisance: FloatArray) -> list[str]:
        """Pass on the remark made while reading."""
        return [self.remark] if self.remark else []

    def around_peak(self, factor: float) -> Spectrum:
        """Cut out what lies within a factor of the highest power per frequency."""
        peak = self.frequency_hz[int(np.argmax(self.value / self.frequency_hz))]
        near = (self.frequency_hz > peak / factor) & (self.frequency_hz < peak * factor)
        return replace(self, frequency_hz=self.frequency_hz[near], value=self.value[near])

    def beyond(self, frequency_hz: float, damping_ratio: float) -> str:
        """Say that the sweep ended before it passed a mode; '' if it did pass it, or if its end is not known."""
        if self.swept is None or not cut_off(self.frequency_hz, self.value, frequency_hz, damping_ratio):
            return ""
        return self.swept.remedy


@dataclass(frozen=True, eq=False)
class Response(FrequencyResponse):
    """A frequency response along an axis; nuisance parameters are the gain and the delay in ms."""

    @property
    def axis(self) -> str:
        """The measured axis."""
        return self.output[-1]

    @property
    def direct(self) -> bool:
        """Whether the axis answers its own command."""
        return self.input[-1] == self.axis

    @property
    def level(self) -> FloatArray:
        """(k,) the factor that levels the value of an axis that does not vibrate."""
        omega2 = (2 * np.pi * self.frequency_hz) ** 2
        return np.asarray(1.0 / omega2 if self._accelerates else np.ones_like(omega2))

    @property
    def unit(self) -> str:
        """Unit of the levelled value."""
        return f"{self.input} to {self.output}, mm/mm"

    @property
    def limits(self) -> FloatArray:
        """(2, 2) lowest and highest gain and delay."""
        return np.array([[-np.inf, np.inf], [-LONGEST_DELAY_MS, LONGEST_DELAY_MS]])

    @property
    def _accelerates(self) -> bool:
        return self.output.startswith("acc_")

    def begin(self, modes: FloatArray) -> FloatArray:
        """Estimate gain and delay with given modes."""
        h = self.model(modes, np.array([1.0, 0.0]))
        weight = 1 / self.observed.variance(COARSE)[: len(h)]
        turned = np.exp(1e-3 * np.outer(DELAYS_MS, self.s))
        gain = (turned @ (weight * h.conj() * self.value)).real / float(np.sum(weight * np.abs(h) ** 2))
        best = int(np.argmax(np.abs(gain)))
        return np.array([gain[best], DELAYS_MS[best]])

    def model(self, modes: FloatArray, nuisance: FloatArray) -> ComplexArray:
        """Predict the response."""
        h = closed_form(modes, self.frequency_hz) * (self.s**2 if self._accelerates else 1.0)
        return np.asarray(nuisance[0] * np.exp(-1e-3 * nuisance[1] * self.s) * h)

    @cached_property
    def observed(self) -> Observation:
        """Real, then imaginary parts, (2 k,), and how far they may be off."""
        return observed_response(self)

    def rows(self, modes: FloatArray, nuisance: FloatArray) -> FloatArray:
        """Predict real, then imaginary parts: (2 k,)."""
        h = self.model(modes, nuisance)
        return np.concatenate([h.real, h.imag])

    def beyond(self, frequency_hz: float, damping_ratio: float) -> str:
        """Say nothing: phase and gain show where the mode lies."""
        return ""

    def remarks(self, nuisance: FloatArray) -> list[str]:
        """Describe a reversed sensor, a wrong scale or an unknown delay."""
        gain, delay_ms = nuisance
        what = f"{Path(self.source).name}, {self.input} to {self.output}"
        if gain < 0:
            return [f"{what}: it moves against its command. A sensor on a bed that moves does; else turn --axes-map."]
        if abs(gain - 1) > WRONG_SCALE:
            return [f"{what}: at rest it answers {gain:.2f} times its command, not once; is the sensor's scale right?"]
        if not self.clock and delay_ms > 0.5:
            return [
                f"{what}: it comes {delay_ms:.1f} ms late, which modes do not explain (see the effect command_delay)."
            ]
        return []


Datum = Spectrum | Response  # one file's view of one axis


def usable(responses: Iterable[FrequencyResponse]) -> tuple[list[Response], list[str]]:
    """Select the responses of axes to commands, their own or another's; describe the others in sentences."""
    kept: list[Response] = []
    left_out = []
    for each in responses:
        commanded, answers = (name.translate(CARRIAGES_AS_AXES) for name in (each.input, each.output))
        response = replace(each, input=commanded, output=answers)
        if response.setup != "assembly" or not response.input.startswith("cmd_"):
            left_out.append(
                f"{response.source}: {response.input} to {response.output} ({response.setup}) does not describe an "
                "axis; give the response of the whole printer to a command, such as cmd_x to acc_x."
            )
        elif not any(
            (response.input, response.output) == (other.input, other.output)
            and np.array_equal(response.value, other.value)
            for other in kept
        ):  # a simulated carriage is the nozzle, to the last digit
            kept.append(Response(**vars(response)))
    return kept, left_out
