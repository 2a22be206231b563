"""Rough axes: one large effect that the machine file lacks, and beside it what no file ever states.

Robot joints, arms, motors and pendulums as laboratories publish them: dry friction differs by direction and by place,
and drifts as it warms; the gain has a ripple, the torque a scale and noise, the encoder digits, and other axes push.
The controller holds its torque from sample to sample; some joints have a load on a coupling. Equations and integration
(semi-implicit Euler, 50 µs) are this file's own.

    python -m validation.rough_axis SEED FOLDER         write the cases
    python -m validation.rough_axis SEED FOLDER --ask   and diagnose each; the answers beside the truth
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit

from models.arrays import FloatArray
from validation.blind.real import toml_of

STEP_S, SECONDS, RUNS = 5e-5, 10.0, ("fit-a", "fit-b", "test-c")
DRY = ("coulomb_friction", "stribeck_friction", "bristle_friction")
PULL = ("pendulum_gravity", "ground_spring")  # of small swings they are one
KINDS = (
    ("joint",) * 4
    + ("arm",) * 4
    + ("cogging",) * 3
    + ("swing", "drag") * 2
    + ("loaded", "nothing", "outside") * 2
    + ("soft", "gap") * 3
)
TRUTH = {"joint": DRY, "arm": PULL, "cogging": ("cogging_force",), "swing": DRY, "drag": ("quadratic_drag",)}
TRUTH |= {"loaded": ("friction_by_load",), "nothing": (), "outside": ()}
TRUTH |= {"soft": ("belt_stiffness",), "gap": ("belt_backlash",)}  # of the coupling to a load


@njit(cache=True)
def _run(
    ref: FloatArray, push: FloatArray, dt: float, begin: float, p: FloatArray, load: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return torque and angles of motor and load at every sample, (n,) each.

    ref : (n, 3) angle, speed and acceleration asked for.
    load : inertia, stiffness, damping and play of its coupling; the first is 0 without one.
    """
    inertia, viscous, dry, extra, creep, fading, uneven, drift, by_place, weight, lines, line, drag, share = p[:14]
    stiff, damp, ahead, ripple = p[14:]
    n, substeps = len(ref), round(dt / STEP_S)
    torques, angles, ends, q, v, end, w = np.zeros(n), np.zeros(n), np.zeros(n), begin, 0.0, begin, 0.0
    for i in range(n):
        torque = ahead * ref[i, 2] + stiff * (ref[i, 0] - q) + damp * (ref[i, 1] - v)
        torques[i], angles[i], ends[i] = torque, q, end
        for _ in range(substeps):
            acting = torque * (1.0 + ripple * np.sin(40.0 * q))
            level = (dry + extra * np.exp(-((v / fading) ** 2))) * (1.0 + drift * i / n)
            level = level * (1.0 + by_place * np.sin(5.0 * q)) + share * abs(acting)
            friction = level * np.tanh(v / creep) * (1.0 + uneven * np.sign(v))
            held = weight * np.sin(q) + lines * np.sin(line * q) + push[i]
            if load[0] > 0.0:
                twist = q - end
                stretch = np.sign(twist) * max(abs(twist) - 0.5 * load[3], 0.0)
                pull = load[1] * stretch + (load[2] * (v - w) if stretch != 0.0 else 0.0)
                held += pull
                w += STEP_S * pull / load[0]
                end += STEP_S * w
            v += STEP_S * (acting - friction - viscous * v - drag * v * abs(v) - held) / inertia
            q += STEP_S * v
    return torques, angles, ends


def _asked(rng: np.random.Generator, dt: float, swing: float, hertz: float) -> FloatArray:
    """Return five tones, faded in: angle, speed and acceleration, (n, 3)."""
    t = np.arange(0.0, SECONDS, dt)
    tones = (rng.normal() / k * np.sin(2 * np.pi * hertz * k / 5 * t + rng.uniform(0, 6.3)) for k in range(1, 6))
    q = np.sum(list(tones), axis=0)
    q *= swing / np.abs(q).max() * np.sin(np.pi * np.clip(t, 0.0, 0.5)) ** 2
    v = np.gradient(q, dt)
    return np.column_stack([q, v, np.gradient(v, dt)])


def _load(rng: np.random.Generator, kind: str, inertia: float, force: float) -> tuple[FloatArray, dict[str, float]]:
    """Return a load as `_run` takes it, and what the machine file says of it."""
    if kind not in ("soft", "gap"):
        return np.zeros(4), {}
    load, omega = inertia * rng.uniform(0.3, 0.8), 2 * np.pi * rng.uniform(8, 18)
    stiffness, damping = load * omega**2, 0.08 * load * omega
    play = rng.uniform(0.06, 0.24) * force / stiffness if kind == "gap" else 0.0
    wrong = rng.choice([1.5, 0.65]) if kind == "soft" else np.exp(0.02 * rng.normal())
    told = {
        "load_inertia_kg_m2": load * np.exp(0.03 * rng.normal()),
        "coupling_stiffness_n_m_per_rad": stiffness * wrong,
        "coupling_damping_n_m_s_per_rad": damping * np.exp(0.3 * rng.normal()),
    }
    return np.array([load, stiffness, damping, play]), told


def write_case(seed: int, kind: str, folder: Path) -> None:
    """Write recordings, machine file and truth of one case."""
    rng = np.random.default_rng([seed, 977])

    def between(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    dt, inertia = 1 / float(rng.choice([200, 250, 500, 1000])), float(np.exp(rng.uniform(-4.6, 3.0)))
    hertz = between(0.5, 2)
    hertz = 0.3 if kind == "cogging" else hertz
    swing = between(0.4, 1.6) / max(hertz, 1.0)
    speed = np.pi * hertz * swing
    force = inertia * 2 * np.pi * hertz * speed  # a usual torque
    free, stiff = kind in ("swing", "drag"), (2 * np.pi * between(4, 8)) ** 2 * inertia
    weight = {"arm": between(0.5, 3) * force, "loaded": between(1, 3) * force}.get(kind, 0.0)
    weight = between(20, 70) * inertia if free else weight
    fastest = swing * np.sqrt(weight / inertia) if free else speed
    viscous = 2 * between(0.004, 0.02) * np.sqrt(weight * inertia) if free else between(0.05, 0.4) * force / speed
    share = {"joint": (0.1, 0.6), "swing": (0.01, 0.03), "drag": (0.0, 0.0)}.get(kind, (0.05, 0.2))
    dry = between(*share) * (weight if free else force)
    lines = between(0.1, 0.25) * force if kind == "cogging" else 0.0
    drag = between(0.8, 2.5) * viscous / fastest if kind == "drag" else 0.0
    even = 0.3 if kind == "nothing" else 1.0
    rubs = [dry, between(0, 0.5) * dry, between(0.005, 0.03) * fastest, between(0.02, 0.2) * fastest]
    rubs += [even * between(low, 0.15) for low in (-0.15, -0.15, 0.0)]
    pulls = [weight, lines, float(rng.choice([7, 12, 21, 42])), drag, between(0.1, 0.35) if kind == "loaded" else 0.0]
    servo = [0.0] * 4
    if not free:
        servo = [stiff, 1.4 * np.sqrt(stiff * inertia), between(0.7, 1) * inertia, between(0, 0.02)]
    p = np.array([inertia, viscous, *rubs, *pulls, *servo])
    load, coupled = _load(np.random.default_rng([seed, 978]), kind, inertia, force)
    folder.mkdir(parents=True, exist_ok=True)
    digit, noise, scale = between(2e-5, 3e-4) * swing, between(0.002, 0.02) * force, between(0.97, 1.03)
    for name in RUNS:
        ref, t = _asked(rng, dt, 0.0 if free else swing, hertz), np.arange(0.0, SECONDS, dt)
        push = 0.0 * t if free else between(0, 0.03) * force * np.sin(2 * np.pi * between(0.3, 1.5) * t)
        if kind == "outside":  # a push that depends on time and direction together
            push += 0.3 * force * np.sin(19.5 * t) * np.sign(ref[:, 1])
        torque, q, end = _run(ref, push, dt, between(0.6, 1.6) if free else float(ref[0, 0]), p, load)
        told = torque if free else scale * torque + noise * rng.normal(size=len(t))
        q = np.round((q + 0.3 * digit * rng.normal(size=len(t))) / digit) * digit
        columns, head = [t, told, q], "t_s,torque_n_m,pos_q_rad"
        if coupled:
            end = np.round((end + 0.3 * digit * rng.normal(size=len(t))) / digit) * digit
            columns, head = [*columns, end], "t_s,torque_n_m,pos_motor_rad,pos_q_rad"
        table = np.column_stack(columns)
        np.savetxt(folder / f"{name}.csv", table, fmt="%.8g", delimiter=",", header=head, comments="")
    known = {"pendulum_gravity": weight} if free or kind == "loaded" else {}
    if kind in ("cogging", "nothing", "outside", "soft", "gap"):
        known["coulomb_friction"] = dry * between(0.95, 1.05)
    axis = {"unit": "rad", "input": "force", "stiffness_n_m_per_rad": 0.0, **coupled}
    axis["inertia_kg_m2"] = inertia * np.exp((0.02 if free else 0.2) * rng.normal())
    axis["damping_n_m_s_per_rad"] = viscous * np.exp(0.3 * rng.normal())
    sd = {"axis.inertia_kg_m2": 0.05 if free else 0.5, "axis.damping_n_m_s_per_rad": 1.0}
    sd |= {f"axis.{name}": 0.5 if "damping" in name else 0.05 for name in coupled}
    effects = {name: {"torque_n_m": x} for name, x in known.items()}
    tables = {"kinematics": {"type": "axis"}, "axis": axis, "effects": effects, "uncertainty": sd}
    (folder / "machine.toml").write_text(toml_of(tables, folder.name))
    (folder / "truth.json").write_text(json.dumps({"kind": kind, "right": TRUTH[kind], "numbers": p.tolist()}))


def ask(folder: Path) -> str:
    """Diagnose one case; return its truth and the answer, in a line."""
    from ffcomp.api.measurements import diagnose

    truth: dict[str, Any] = json.loads((folder / "truth.json").read_text())
    answer = diagnose(sorted(folder.glob("fit-*.csv")), folder / "machine.toml", without_repeats=True).to_dict()
    names = [each["name"] for each in answer["effects"]] or [x["name"] for x in [answer["dominant"]] if x]
    beside = {*names} - {*truth["right"], *DRY}  # which every one of them has
    found = "right" if {*names} & {*truth["right"]} or not (names or truth["right"]) else "missed"
    right = f"{found}, wrong" if beside else found
    return f"{folder.name}: {right}, {answer['verdict']}: {' + '.join(names)}"


if __name__ == "__main__":
    for i, kind in enumerate(KINDS):
        case = Path(sys.argv[2]) / f"{i:02d}-{kind}"
        write_case(int(sys.argv[1]) + i, kind, case)
        if "--ask" in sys.argv:
            print(ask(case), flush=True)
