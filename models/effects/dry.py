"""Declare the parameters that dry friction shares: its width at reversals, its hold at rest, how far it bends."""

from __future__ import annotations

from models.effects.effect import Parameter, Size

PRESLIDING = Parameter(
    "presliding_mm",
    "mm",
    "s₀: way in which contacts bend before they slide, in place of creep and hold; 0: those",
    (0, 10),
    (0.005, 0.05),
    0.005,
    size="per_tower",
    role="shape",
    default=0.0,
    logarithmic=True,
    instead_of=("creep_mm_per_s", "hold_per_s"),
)


def reversal_parameters(size: Size) -> tuple[Parameter, Parameter]:
    """Declare v₀ and κ of F = ℓ tanh(v/v₀ + φ) (`models/printer/kernels`), optional in a machine file."""
    return (
        Parameter(
            "creep_mm_per_s",
            "mm/s",
            "v₀: much slower than this, friction falls with speed",
            (0.05, 1000),
            (0.2, 5),
            0.05,
            size,
            "shape",
            default=0.5,
            logarithmic=True,
        ),
        Parameter(
            "hold_per_s",
            "1/s",
            "κ: how quickly it takes hold of what rests; 0: never, all loads creep",
            (0, 1e6),
            (0, 1000),
            5.0,
            size,
            "shape",
            default=50.0,
            logarithmic=True,
        ),
    )
