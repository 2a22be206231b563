"""From perfect readings to what a recorder writes: a subset of channels, coloured noise, counts, a CSV file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from validation.blind.real import FloatArray, Reading

SENSORS: Mapping[str, tuple[str, ...]] = {
    "all": ("acc_A", "acc_B", "acc_C", "acc_x", "acc_y", "acc_z"),
    "effector": ("acc_x", "acc_y", "acc_z"),
    "head-and-bed": ("acc_x", "acc_y"),
    "axis": ("acc_q", "pos_q"),
    "encoder": ("pos_q",),
    "encoder-and-chip": ("acc_q", "pos_q"),
    "two-encoders": ("pos_motor", "pos_q"),
}
BY_COUNTS = ("encoder", "encoder-and-chip", "two-encoders")  # whose noise is little more than their counts
UNITS = {"acc": "m_per_s2", "pos": "mm"}


@dataclass(frozen=True, eq=False)
class Sensors:
    """Which channels there are, and how they err. Half of the noise is white, the rest sits in one band."""

    channels: tuple[str, ...]
    level: Mapping[str, float]  # rms of a sample, in the channel's unit
    count: Mapping[str, float]  # smallest step of the recorder
    band_hz: tuple[float, float]
    rate_hz: float

    def spectrum(self, channel: str, f: FloatArray) -> FloatArray:
        """Variance of a sample per bin, (n,), mean 1/bin over all bins = level², counts' own rounding included."""
        inside = (f >= self.band_hz[0]) & (f <= self.band_hz[1])
        share = (self.band_hz[1] - self.band_hz[0]) / (self.rate_hz / 2)
        white = self.level[channel] ** 2 / 2 + self.count[channel] ** 2 / 12
        return np.asarray(white + inside * self.level[channel] ** 2 / 2 / share)

    def record(self, reading: Reading, rng: np.random.Generator) -> dict[str, FloatArray]:
        """Every channel with its noise, rounded to counts."""
        found = {}
        for channel, true in self.perfect(reading).items():
            spoiled = true + self._noise(channel, len(true), rng)
            found[channel] = np.round(spoiled / self.count[channel]) * self.count[channel]
        return found

    def perfect(self, reading: Reading) -> dict[str, FloatArray]:
        """Every channel at the recorder's rate, without noise."""
        every = round(1 / (self.rate_hz * (reading.t[1] - reading.t[0])))
        columns = {
            "acc": dict(zip("ABCxyz", np.hstack([reading.carriage, reading.nozzle]).T, strict=True)),
            "pos": dict(zip("ABCxyz", np.hstack([reading.carriage_mm, reading.nozzle_mm]).T, strict=True)),
        }
        where = {"q": "x", "motor": "A"}
        return {name: columns[name[:3]][where.get(name[4:], name[4:])][::every] for name in self.channels}

    def _noise(self, channel: str, n: int, rng: np.random.Generator) -> FloatArray:
        f = np.fft.rfftfreq(n, 1 / self.rate_hz)
        inside = (f >= self.band_hz[0]) & (f <= self.band_hz[1])
        share = (self.band_hz[1] - self.band_hz[0]) / (self.rate_hz / 2)
        coloured = np.fft.irfft(np.fft.rfft(rng.standard_normal(n)) * inside / np.sqrt(share), n)
        return np.asarray(self.level[channel] * np.sqrt(0.5) * (rng.standard_normal(n) + coloured))


def draw_sensors(rng: np.random.Generator, subset: str, rate_hz: float) -> Sensors:
    """Accelerometers of 0.1 to 0.25 m/s², each its own, counted in 0.0383 (±2 g, 3.9 mg) or finer; 2 µm positions.

    Encoders have half a count of noise.
    """
    channels = SENSORS[subset]
    loud, count = float(rng.uniform(0.1, 0.25)), float(rng.choice([0.0383, 0.0096]))
    low = float(rng.uniform(20.0, 60.0))
    uneven = rng.uniform(0.75, 1.3, len(channels)).tolist()
    kinds = [name[:3] for name in channels]
    place, step = 2e-3, 1e-3
    if subset in BY_COUNTS:
        step = float(rng.choice([5e-4, 1e-3, 2e-3]))
        place = 0.5 * step
    return Sensors(
        channels,
        {c: (loud if k == "acc" else place) * u for c, k, u in zip(channels, kinds, uneven, strict=True)},
        {c: count if k == "acc" else step for c, k in zip(channels, kinds, strict=True)},
        (low, low + float(rng.uniform(25.0, 60.0))),
        rate_hz,
    )


def commands_of(command: FloatArray, axes: str) -> dict[str, FloatArray]:
    """Return the columns of a command, (n, axes) mm, by their names in a run."""
    return {f"cmd_{axis}_mm": command[:, i] for i, axis in enumerate(axes)}


def columns_of(measured: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Return what each channel said by its column in a run."""
    return {f"{name}_{UNITS[name[:3]]}": values for name, values in measured.items()}


def csv_of(times: FloatArray, given: Mapping[str, FloatArray], measured: Mapping[str, FloatArray]) -> str:
    """Return the text of a run, by column: what drove the machine, and what was measured."""
    names = ["t_s", *given, *measured]
    formats = ["%.7f"] + ["%.6f"] * len(given) + ["%.7f" if "rad" in name else "%.4f" for name in measured]
    rows = np.column_stack([times, *given.values(), *measured.values()])
    row_format = ",".join(formats) + "\n"
    return ",".join(names) + "\n" + "".join(row_format % tuple(row) for row in rows.tolist())
