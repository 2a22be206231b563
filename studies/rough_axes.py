"""Diagnose rough axes: one large effect that the machine file lacks, and beside it what no file ever states.

    python -m studies.rough_axes SEED FOLDER         writes 27 cases
    python -m studies.rough_axes SEED FOLDER --ask   and diagnoses each; the answers beside the truth, 15 min of CPU

Robot joints, arms, motors and pendulums as laboratories publish them, on the axis of `validation.plants.forced_axis`:
friction differs by direction and by place, the drive fades, its gain has a ripple, the recorded torque a scale and
noise, the encoder digits, and other axes push. The controller holds its torque from sample to sample; some joints have
a load on a coupling. rad, N m, kg m².
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ffcomp.api.measurements import diagnose
from models.arrays import FloatArray
from validation.blind.effects import Rng
from validation.blind.real import toml_of
from validation.plants.forced_axis import AT_REST, AXIS, LOOP, SERVO, follow
from validation.plants.shapes import TANH, record_of

STEP_S, SECONDS, RUNS = 1 / 16000, 10.0, ("fit-a", "fit-b", "test-c")
DRY = ("coulomb_friction", "stribeck_friction", "bristle_friction")
PULL = ("pendulum_gravity", "ground_spring")  # of small swings they are one
TRUTH: Mapping[str, tuple[str, ...]] = {
    **{"joint": DRY, "arm": PULL, "cogging": ("cogging_force",), "swing": DRY, "drag": ("quadratic_drag",)},
    **{"loaded": ("friction_by_load",), "nothing": (), "outside": ()},
    **{"soft": ("belt_stiffness",), "gap": ("belt_backlash",)},  # of the coupling to a load
}
COUNT = {"joint": 4, "arm": 4, "cogging": 3, "soft": 3, "gap": 3}  # of 2 otherwise


def asked_for(rng: Rng, swing: float, hertz: float) -> FloatArray:
    """Return five tones, faded in: angle and acceleration, (2, n), every step."""
    t = STEP_S * np.arange(round(SECONDS / STEP_S))
    tones = (rng.normal() / k * np.sin(2 * np.pi * hertz * k / 5 * t + rng.uniform(0, 6.3)) for k in range(1, 6))
    q = np.sum(list(tones), axis=0)
    q *= swing / np.abs(q).max() * np.sin(np.pi * np.clip(t, 0.0, 0.5)) ** 2
    return np.stack([q, np.gradient(np.gradient(q, STEP_S), STEP_S)])


def coupled(rng: Rng, kind: str, inertia: float, force: float) -> tuple[dict[str, float], dict[str, float]]:
    """Return a load as fields of the plant, and what the machine file says of it."""
    if kind not in ("soft", "gap"):
        return {}, {}
    load, omega = inertia * rng.uniform(0.3, 0.8), 2 * np.pi * rng.uniform(8, 18)
    stiffness, damping = load * omega**2, 0.08 * load * omega
    play = rng.uniform(0.06, 0.24) * force / stiffness if kind == "gap" else 0.0
    wrong = rng.choice([1.5, 0.65]) if kind == "soft" else np.exp(0.02 * rng.normal())
    told = {
        "load_inertia_kg_m2": load * np.exp(0.03 * rng.normal()),
        "coupling_stiffness_n_m_per_rad": stiffness * wrong,
        "coupling_damping_n_m_s_per_rad": damping * np.exp(0.3 * rng.normal()),
    }
    fields = {"tool": load, "belt_k": stiffness, "belt_c": damping, "play": play, "flank": 0.02 * play or 1e-6}
    return fields, told


def write_case(seed: int, kind: str, folder: Path) -> None:
    """Write recordings, machine file and truth of one case."""
    rng = np.random.default_rng([seed, 977])

    def between(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    rate, inertia = float(rng.choice([200, 250, 500, 1000])), float(np.exp(rng.uniform(-4.6, 3.0)))
    hertz = 0.3 if kind == "cogging" else between(0.5, 2)
    swing = between(0.4, 1.6) / max(hertz, 1.0)
    force = inertia * 2 * np.pi**2 * hertz**2 * swing  # a usual torque
    free, stiff = kind in ("swing", "drag"), (2 * np.pi * between(4, 8)) ** 2 * inertia
    weight = {"arm": between(0.5, 3) * force, "loaded": between(1, 3) * force}.get(kind, 0.0)
    weight = between(20, 70) * inertia if free else weight
    fastest = swing * np.sqrt(weight / inertia) if free else np.pi * hertz * swing
    viscous = 2 * between(0.004, 0.02) * np.sqrt(weight * inertia) if free else between(0.05, 0.4) * force / fastest
    share = {"joint": (0.1, 0.6), "swing": (0.01, 0.03), "drag": (0.0, 0.0)}.get(kind, (0.05, 0.2))
    dry = between(*share) * (weight if free else force)
    small = (0.3 if kind == "nothing" else 1.0) * dry
    rubs = {"dry_kind": TANH, "dry": dry, "stick": between(0, 0.5) * dry, "stick_power": 2.0, "ground": viscous}
    rubs |= {"dry_v": between(0.005, 0.03) * fastest, "stick_v": between(0.02, 0.2) * fastest}
    rubs |= {"bump": between(0.0, 0.3) * small, "bump_at": between(-0.5, 0.5) * swing, "bump_wide": 0.3 * swing}
    rubs |= {"direction": between(-0.3, 0.3) * small / fastest}
    pulls = {"weight": weight, "weight_wave": 1.0, "drag": between(0.8, 2.5) * viscous / fastest * (kind == "drag")}
    pulls |= {
        "tooth": between(0.1, 0.25) * force * (kind == "cogging"),
        "tooth_wave": float(rng.choice([7, 12, 21, 42])),
    }
    pulls |= {"load": between(0.1, 0.35) * (kind == "loaded")}
    drive = {"fade": between(0, 0.05), "fade_s": 5.0, "commute": between(0, 0.02), "commute_wave": 40.0}
    drive |= {"limit": force * (kind == "outside"), "spin_wave": 2 * np.pi * between(0.3, 1.5)}
    load, told = coupled(np.random.default_rng([seed, 978]), kind, inertia, force)
    fields = {**AT_REST, "carriage": inertia, **rubs, **pulls, **({} if free else drive), **load}
    loop = [stiff, 1.4 * np.sqrt(stiff * inertia), 0.0, between(0.7, 1) * inertia] if not free else [0.0] * 4
    servo = dict(zip(LOOP.split(), [*loop, 1e-9, 1e-9, 1 / rate, 1e-9], strict=True))
    folder.mkdir(parents=True, exist_ok=True)
    digit, noise, scale = between(2e-5, 3e-4) * swing, between(0.002, 0.02) * force, between(0.97, 1.03)
    for name in RUNS:
        path, push = asked_for(rng, 0.0 if free else swing, hertz)
        path += between(0.6, 1.6) * free
        spin = {"spin": 0.0 if free else between(0, 0.03) * force}
        numbers, every = record_of(AXIS, fields | spin), round(1 / (rate * STEP_S))
        out = follow(path, push, 0 * path, STEP_S, every, numbers, record_of(SERVO, servo))
        torque, read = out[:, 3], out[:, :2] + 0.3 * digit * rng.normal(size=(len(out), 2))
        torque = torque if free else scale * torque + noise * rng.normal(size=len(out))
        angles = np.round(read / digit) * digit
        table = np.column_stack([np.arange(len(out)) / rate, torque, angles if told else angles[:, 1]])
        head = "t_s,torque_n_m," + ("pos_motor_rad,pos_q_rad" if told else "pos_q_rad")
        np.savetxt(folder / f"{name}.csv", table, fmt="%.8g", delimiter=",", header=head, comments="")
    known = {"pendulum_gravity": weight} if free or kind == "loaded" else {}
    if kind in ("cogging", "nothing", "outside", "soft", "gap"):
        known["coulomb_friction"] = dry * between(0.95, 1.05)
    axis = {"unit": "rad", "input": "force", "stiffness_n_m_per_rad": 0.0, **told}
    axis["inertia_kg_m2"] = inertia * np.exp((0.02 if free else 0.2) * rng.normal())
    axis["damping_n_m_s_per_rad"] = viscous * np.exp(0.3 * rng.normal())
    sd = {"axis.inertia_kg_m2": 0.05 if free else 0.5, "axis.damping_n_m_s_per_rad": 1.0}
    sd |= {f"axis.{name}": 0.5 if "damping" in name else 0.05 for name in told}
    effects = {name: {"torque_n_m": x} for name, x in known.items()}
    tables = {"kinematics": {"type": "axis"}, "axis": axis, "effects": effects, "uncertainty": sd}
    (folder / "machine.toml").write_text(toml_of(tables, folder.name), encoding="utf-8")
    (folder / "truth.json").write_text(json.dumps({"kind": kind, "right": TRUTH[kind]}), encoding="utf-8")


def ask(folder: Path) -> str:
    """Diagnose one case; return its truth and the answer, in a line."""
    truth: dict[str, Any] = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    answer = diagnose(sorted(folder.glob("fit-*.csv")), folder / "machine.toml", without_repeats=True).to_dict()
    names = [each["name"] for each in answer["effects"]] or [x["name"] for x in [answer["dominant"]] if x]
    beside = {*names} - {*truth["right"], *DRY}  # which every one of them has
    found = "right" if {*names} & {*truth["right"]} or not (names or truth["right"]) else "missed"
    right = f"{found}, wrong" if beside else found
    return f"{folder.name}: {right}, {answer['verdict']}: {' + '.join(names)}"


if __name__ == "__main__":
    for i, name in enumerate(kind for kind in TRUTH for _ in range(COUNT.get(kind, 2))):
        case = Path(sys.argv[2]) / f"{i:02d}-{name}"
        write_case(int(sys.argv[1]) + i, name, case)
        if "--ask" in sys.argv:
            print(ask(case), flush=True)
