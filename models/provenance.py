"""What a machine file's `[provenance]` says of its parameters: which are assumed, and whether the modes are."""

from __future__ import annotations

from pathlib import Path

from models.machine import Machine

ASSUMED = "assumed"  # beginning of the provenance of an assumed value
START = "as a start"  # part of the provenance of a value that is only near the true one

SOURCES = "sources"  # the table in [provenance] of what origins are called by


def is_assumed(origin: str) -> bool:
    """Tell whether a provenance marks an assumed value."""
    return origin.startswith(ASSUMED) or START in origin


def assumed_modes(machine: Machine) -> str | None:
    """Return the sentence that a machine's modes are assumed, and what to do; None if its file does not say so.

    A compensation can only be as good as the modes it is made for, so everything that uses them says this sentence.
    """
    keys = machine.vibration.frequency_keys
    assumed = [key for key in keys if is_assumed(str(machine.provenance.get(key, "")))]
    if not assumed:
        return None
    name = Path(machine.path).stem or machine.name
    part = "" if len(assumed) == len(keys) else f" in part ({', '.join(assumed)})"
    return (
        f"The modes of {name} are assumed{part}, not measured, so how much less your printer vibrates is not known: "
        "measure yours with `ffcomp record plan --for identify`, then `ffcomp identify fit`."
    )


def sources(machine: Machine) -> dict[str, str]:
    """Return the addresses of the sources that origins begin with, by their titles."""
    named = machine.provenance.get(SOURCES, {})
    return {str(title): str(address) for title, address in named.items()} if isinstance(named, dict) else {}


def identity(machine: Machine) -> dict[str, str | None]:
    """Return the machine as every JSON object names it."""
    return {"name": machine.name, "sha256": machine.sha256, "assumed": assumed_modes(machine)}
