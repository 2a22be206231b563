"""Evaluate cartesian and CoreXY axes."""

from __future__ import annotations

from models.arrays import FloatArray
from models.printer.kernels.jit import compiled
from models.printer.kernels.record import (
    ACC,
    ETA,
    ETAD,
    LANES,
    MOTOR,
    MOTOR_RATE,
    NOW,
    PULL,
    QD,
    RATE,
    XD,
    Q,
    X,
    parameter_rows,
)
from models.printer.kernels.vectors import at

CARRIAGE_MASS, BELT_K, BELT_C, GUIDE_B = parameter_rows("carriage_mass", "belt_k", "belt_c", "guide_b")
(FIRST_SHARE,) = parameter_rows("first_share")
EXTRUDER_MASS, MOUNT_K, MOUNT_B = parameter_rows("extruder_mass", "mount_k", "mount_b")


@compiled
def axes(m: FloatArray) -> None:
    """Evaluate all rates behind the motors: two oscillators for each axis (`models/vibration/modal.py`)."""
    for l in range(LANES):
        for a in range(3):
            q, qd = at(m, NOW + Q + a, l), at(m, NOW + QD + a, l)
            eta, etad = at(m, NOW + ETA + a, l), at(m, NOW + ETAD + a, l)
            u, ud = at(m, MOTOR + a, l), at(m, MOTOR_RATE + a, l)
            share = at(m, FIRST_SHARE + a, l)
            k, c, b = at(m, BELT_K + a, l), at(m, BELT_C + a, l), at(m, GUIDE_B + a, l)
            p, pd = share * q - eta, share * qd - etad
            first = (k * (share * u - p) + c * (share * ud - pd) - b * pd) / at(m, CARRIAGE_MASS + a, l)
            p, pd = (1.0 - share) * q + eta, (1.0 - share) * qd + etad
            second = at(m, MOUNT_K + a, l) * ((1.0 - share) * u - p) - at(m, MOUNT_B + a, l) * pd
            second /= at(m, EXTRUDER_MASS, l)
            acceleration = first + second
            m[(RATE + Q + a) * LANES + l], m[(RATE + QD + a) * LANES + l] = qd, acceleration
            m[(RATE + ETA + a) * LANES + l] = etad
            m[(RATE + ETAD + a) * LANES + l] = share * second - (1.0 - share) * first
            m[(X + a) * LANES + l], m[(XD + a) * LANES + l], m[(ACC + a) * LANES + l] = q, qd, acceleration
            m[(PULL + a) * LANES + l] = k * (u - q)
