"""All parameters of a delta from frequency responses: fit, decide on the drive, advise on weak parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ffcomp.identification.output_error import DAMPING, DRIVE, STIFFNESS, TOTAL_MASS, WEAK_SD, Fitted, fit_machine
from ffcomp.measurement.frf import FrequencyResponse
from ffcomp.numerics.stages import Stage
from models.kinds import delta_vibration, with_parts
from models.machine import Machine, value_of, with_values
from models.vibration.substructures import Drive

WEAK_SCALE = 0.05  # relative sd of all masses, stiffnesses and dampings together
SCALED = ("carriage.mass_kg", "carriage.belt_stiffness_n_per_m", "effector.nozzle_mass_kg")
TURNED_DEG = 0.5  # a larger angle is reported
DRIVE_COSTS = 10.0  # of −2 ln of the evidence, that a drive filter must gain over an ideal drive
NEUTRAL_DRIVE = Drive(4.0e5, 0.0, 250.0)  # 100 Hz, where a search for a drive begins
MASSES = ("carriage.mass_kg", "effector.nozzle_mass_kg", "effector.extruder_mass_kg")


def identify(
    start: Machine,
    responses: Sequence[FrequencyResponse],
    known: Mapping[str, tuple[float, float]] | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> Fitted:
    """Fit the output error; a starting machine with an ideal drive is tried with a drive filter too.

    Raises MeasurementError, SolverError as `fit_machine`.
    """
    commanded = any(r.input.startswith("cmd_") for r in responses)
    method = _with_drive if commanded else fit_machine
    fitted = method(start, responses, known, progress=progress)
    kept, others = fitted.kept, [name for name in fitted.beside_scale if name not in fitted.kept]
    if kept and others:
        has_drive = delta_vibration(start).carriage.drive is not None
        before = {name: value_of(start, name) for name in kept if name not in DRIVE or has_drive}
        held = {name: value for name, value in (known or {}).items() if name not in kept}
        # the others had made up for those that are put back: of belt and guide damping, the sum is sharp
        again = fit_machine(with_values(fitted.machine, before), responses, held, unknowns=others, starts=[{}])
        ratio = {name: e.value / fitted.estimates[name].value for name, e in again.estimates.items()}
        both = (fitted.estimates, fitted.beside_scale)
        moved, beside = ({name: e.scaled(ratio.get(name, 1.0)) for name, e in each.items()} for each in both)
        fitted = replace(fitted, machine=again.machine, estimates=moved, beside_scale=beside)
        fitted = replace(fitted, predictions=again.predictions, model_errors=again.model_errors)
    return replace(fitted, advice=(*fitted.advice, *advice_on(fitted)))


def _with_drive(
    start: Machine,
    responses: Sequence[FrequencyResponse],
    known: Mapping[str, tuple[float, float]] | None,
    progress: Callable[[str], None],
) -> Fitted:
    """Fit with a drive filter; where the starting file has none, drop it again unless it is significant."""
    if delta_vibration(start).carriage.drive is not None:
        return fit_machine(start, responses, known, progress=progress)
    driven = with_parts(start, carriage=replace(delta_vibration(start).carriage, drive=NEUTRAL_DRIVE))
    fitted = fit_machine(driven, responses, known, progress=progress)
    progress(Stage(5, "the same without a drive filter"))
    values = {name: e.value for name, e in fitted.estimates.items() if name not in (*DRIVE, TOTAL_MASS)}
    ideal = fit_machine(start, responses, known, starts=[values, {}], progress=progress)
    return fitted if fitted.evidence < ideal.evidence - DRIVE_COSTS else ideal


# ---- advice --------------------------------------------------------------------------------------


def advice_on(fitted: Fitted) -> list[str]:
    """Write a sentence for each group of parameters that is weak or not determined at all."""
    poor = {*fitted.weak, *fitted.kept}
    sentences = _of_rotation(fitted)
    if scale_is_weak(fitted):
        poor = {n for n, e in fitted.beside_scale.items() if n not in DRIVE and e.relative_sd > WEAK_SD} | {
            n for n in poor if n in DRIVE
        }
        poor -= set(MASSES)
        sentences.append(
            f"All masses, stiffnesses and dampings together are known to ± {100 * fitted.common_scale_sd:.0f} % only: "
            "motion shows their ratios, and the intervals are those of the ratios. Compensation needs no more. For "
            f"forces, weigh the effector and give --known {TOTAL_MASS}=KG."
        )
    if poor & set(MASSES):  # parameters that are weak only with the masses need no measurement of their own
        poor -= {
            n for n, others in fitted.weak.items() if n not in (*fitted.kept, *MASSES) and set(others) & set(MASSES)
        }
    highest = max(float(r.frequency_hz[-1]) for r in fitted.responses)
    if poor & set(MASSES):
        sentences.append(
            "The masses are weak: motion alone does not separate a heavy machine on stiff belts from a light one on "
            f"soft belts. Weigh the effector and give --known {TOTAL_MASS}=KG, or measure a carriage with a known mass "
            "added."
        )
    for axis, stiffness, damping in zip("xyz", STIFFNESS, DAMPING, strict=True):
        if poor & {stiffness, damping}:
            sentences.append(
                f"The extruder's mount along {axis} is weak: excite {axis} at the centre beyond {highest:.0f} Hz, or "
                f"strike the effector along {axis} and measure its acceleration along {axis}."
            )
    if poor & {"carriage.belt_damping_n_s_per_m", "carriage.guide_damping_n_s_per_m"}:
        sentences.append(
            "Belt and guide damping are weak one by one (their sum may be sharp): measure a carriage by itself, "
            "without the effector, up to twice its natural frequency."
        )
    if poor & set(DRIVE):
        sentences.append("The drive is weak: excite the carriages up to 200 Hz, smaller if it must be, but longer.")
    return sentences


def scale_is_weak(fitted: Fitted) -> bool:
    """Return whether the common scale of masses, stiffnesses and dampings is the main uncertainty."""
    beside = float(np.median([fitted.beside_scale[name].relative_sd for name in SCALED if name in fitted.beside_scale]))
    return fitted.common_scale_sd > max(WEAK_SCALE, 2 * beside)


def _of_rotation(fitted: Fitted) -> list[str]:
    """Say how far the accelerometer is turned, where it is."""
    turned = {axis: e for axis, e in fitted.rotation_deg.items() if abs(e.value) > max(TURNED_DEG, 2 * e.sd)}
    if not turned:
        return []
    listed = " and ".join(f"{e.value:+.1f} ± {e.sd:.1f}° about {axis}" for axis, e in turned.items())
    return [f"The accelerometer is turned by {listed} against the printer's axes; the fit allows for it."]
