"""What to do to the printer, and what to record next, by what was found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ffcomp.diagnose.result import DiagnosisResult
from ffcomp.diagnose.sentences import finding_of
from ffcomp.diagnose.words import joined

BELTS = ("belt_", "cogging", "torque_angle", "command_delay")  # effects of belts and motors, not of carriages
UNEVEN = 1.3  # times the mean of three: the one to begin with
REMEDIES: Mapping[str, str] = {
    "coulomb_friction": "Clean and oil the rails{where}; check that no belt rubs and no carriage is over-tightened.",
    "stribeck_friction": "Clean and oil the rails{where}: they stick at rest; a thinner oil, or fresh bearings, help.",
    "guide_damping": "Check the rails{where} for stiff grease and tight carriages; warm grease damps less.",
    "belt_stiffness": "Check the belts' tension{where}, and tension them alike (same note when plucked).",
    "belt_hardening": "Tension the belts{where}: a belt that stiffens as it is pulled hangs loose, or a clamp gives.",
    "belt_position_stiffness": "Check the belts' tension at both ends of the travel{where}, and pulleys out of line.",
    "belt_backlash": "Look for play{where}: loose pulley screws, worn arms or joints, a belt clamp that gives.",
    "command_delay": "Nothing to mend: the firmware or drives act late{where}. With it in the file it is compensated.",
    "cogging": "Calibrate the drivers' microsteps or lower the current{where}; stiffer mounts do not help.",
    "torque_angle": "Raise the motor current within what the motors bear, or lower accelerations.",
    "effector_mass": "Weigh the effector with all that moves with it (fan, cables, camera) and write that in the file.",
    "arm_inertia": "Weigh an arm's tube and its ends apart, and write the ends' share in the file.",
    "center_of_mass": "Weigh where the effector balances, or move what hangs to one side nearer to the middle.",
    "extruder_mount": "Tighten the extruder's mount, its screws and dampers; print a stiffer bracket.",
    "joint_friction": "Clean and oil the arms' joints; let their springs pull less.",
    "frame_mode": "Stiffen the frame: tighten its corners, brace it, and stand it on something heavy.",
    "gantry_racking": "Square and tension the gantry: equal belts, tight carriages at both ends of its beam.",
    "growing_bed": "Nothing to mend: a print weighs. With it in the file every layer is compensated for its own mass.",
    "toolhead_mode": "Check the screws of the toolhead and of the beam that carries it; a stiffer beam varies less.",
    "arm_geometry": "Measure the arms and calibrate the delta (radius, arm length) in the firmware.",
    "force_map": "Nothing to mend: the machine file distributes the loads otherwise. It is a choice of the model.",
    "sensor_gain": "Nothing to mend on the printer: calibrate the accelerometer, or its unit.",
    "sensor_misalignment": "Nothing to mend on the printer: mount the accelerometer along the axes.",
    "sensor_time_offset": "Nothing to mend on the printer: join captures by the firmware's clock (ffcomp record join).",
    "bristle_friction": "Nothing to mend: contacts bend before they slide. Seals and wipers bend most.",
    "cogging_force": "Look for what repeats along the travel: magnets, a screw's balls, a rack's or a belt's teeth.",
    "friction_by_direction": "Look for what resists one way only: a cable chain, a wiper's lip, a preload, a slope.",
    "ground_spring": "Look for what pulls to one place: hoses, cables, a bellows, a counterweight.",
    "quadratic_drag": "Look for what is pushed aside at speed: air in a closed space, oil, coolant.",
    "sensor_clock_drift": "Nothing to mend on the printer: join captures by the firmware's clock (ffcomp record join).",
}


def what_to_do(found: DiagnosisResult) -> list[str]:
    """Return steps in order: to the printer first, then to the file, then what to record."""
    finding, apart = finding_of(found), [each.sentence() for each in found.separations]
    if finding == "effects":
        return [*(_remedy(found, name) for name in found.effects), *_afterwards(found), *apart]
    if finding == "nothing":
        return ["Nothing to mend, as far as these recordings go. Record again when prints change."]
    if finding in ("cannot_tell", "recording"):
        return ["Record again as said above before anything is changed on the printer or in its file."]
    return [
        *apart,
        "Do not add the nearest effect to the file by hand: it is wrong where it was not fitted.",
        "Look for something loose, rubbing, worn or bent where the gap is largest.",
        f"Record other motions, each twice, at more places at least 20 mm apart{_at(found)}."
        if found.left_out != "windows"
        else "Record other motions: slower and faster, shorter and longer, near rest and over the whole travel.",
    ]


def _remedy(found: DiagnosisResult, name: str) -> str:
    names = found.belts if name.startswith(BELTS) else found.carriages
    return REMEDIES[name].format(where=_first_of(names, found.effects[name]))


def _first_of(names: Sequence[str], table: Mapping[str, Any]) -> str:
    """Name the towers or axes that stand out, where there is a value for each."""
    lists = [x for x in table.values() if isinstance(x, list) and len(x) == len(names)]
    if not lists:
        return ""
    sizes = [abs(float(x)) for x in lists[0]]
    high = [t for t, size in zip(names, sizes, strict=True) if size > UNEVEN * sum(sizes) / len(sizes)]
    return f", first of {joined(high)}" if high else ""


def _afterwards(found: DiagnosisResult) -> list[str]:
    if found.left_out == "windows":
        return ["Compare the better machine file (-o better.toml) with new runs (ffcomp gap)."]
    steps = [
        "Until then, compensate with the better machine file (-o better.toml), and compare it with new recordings."
    ]
    if found.left_out != "places":
        steps.append("Record the same motions at two more places, at least 20 mm apart, and diagnose again.")
    elif found.unproven:
        steps.append(f"Record louder motions at {joined(list(found.unproven))} and diagnose again.")
    return steps


def _at(found: DiagnosisResult) -> str:
    return f", also near {joined(list(found.unproven))}" if found.unproven else ""
