"""Machine files: finding, reading, showing and starting them.

Machines are named by name (the user's own folder first, then the library) or by path (ends in `.toml` or contains a
folder separator). The user's file wins, so a machine can be refitted under its old name.

Defaults: `[carriage.drive]` an ideal drive; `[effector] force_map` virtual work;
`[limits]` all but velocity and acceleration, and `[steps]`, as in `MotionLimits` and `Steps`; `[firmware]` unknown;
`[uncertainty] default` 0.02; no effects.
"""

from __future__ import annotations

import hashlib
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomlkit

from models.effects.catalogue import key_in_file
from models.errors import MachineFileError
from models.finding import LIBRARY as LIBRARY
from models.finding import machine_paths as machine_paths
from models.machine import Machine
from models.quantities import Quantities
from models.schema.documents import DEFAULT_UNCERTAINTY as DEFAULT_UNCERTAINTY
from models.schema.documents import AnyDocument, validated
from models.schema.straight import quantities_of
from models.schema.table import did_you_mean

# Klipper's printer.cfg, RepRapFirmware's config.g, Marlin's answer to M503; a line of a machine file
_CONFIGURATION = re.compile(
    rb"^\[(?:printer|mcu|stepper_\w+|include [^\]]+)\][ \t\r]*$|^(?:\w+:)?[ \t]*M(?:92|201|203|550|665|669)[ \t]",
    re.MULTILINE,
)
_FORMAT = re.compile(rb"^format[ \t]*=", re.MULTILINE)


def find_machine(name_or_path: str | Path) -> Path:
    """Return the file for a name or a path (see the top of this module)."""
    path, name = Path(name_or_path), str(name_or_path)
    if path.suffix == ".toml" or len(path.parts) > 1:
        if not path.is_file():
            raise MachineFileError(name, ["There is no such file."]) from FileNotFoundError(name)
        return path
    known = machine_paths()
    if name not in known and path.is_file():
        return path
    if name not in known:
        hint, names = did_you_mean(name, known), ", ".join(known)
        raise MachineFileError(name, [f"There is no machine of this name.{hint} Known machines: {names}."])
    return known[name]


def find_by_sha256(digits: str, name: str, more: Iterable[Path] = ()) -> Path:
    """Return the file whose hash begins with these digits, among the named ones and `more`.

    `name` is for the message if it is missing.
    """
    for path in (*machine_paths().values(), *more):
        try:
            if hashlib.sha256(path.read_bytes()).hexdigest().startswith(digits):
                return path
        except OSError:  # deleted since it was used
            continue
    rule = f"No machine file here has the hash {digits}…; name the file with --machine."
    raise MachineFileError(name, [rule])


def load_machine(name_or_path: str | Path) -> Machine:
    """Return the printer of that name or in that file.

    MachineFileError: with every mistake in the file, or if it describes one axis by itself.
    """
    document, sha256, path = _read(name_or_path)
    return document.printer(sha256, path)


def machine_of_text(text: str, path: str) -> Machine:
    """Return the printer that a machine file's text describes, as `load_machine` does; `path` is for messages."""
    data = text.encode("utf-8")
    return _parsed(data, path).printer(hashlib.sha256(data).hexdigest(), path)


def load_plant(name_or_path: str | Path) -> Machine:
    """Return the printer or the single axis of that name or in that file; MachineFileError with every mistake in it."""
    document, sha256, path = _read(name_or_path)
    return document.machine(sha256, path)


def _read(name_or_path: str | Path) -> tuple[AnyDocument, str, str]:
    """Return the checked document, its hash and its path."""
    path = find_machine(name_or_path)
    data = path.read_bytes()
    return _parsed(data, str(path)), hashlib.sha256(data).hexdigest(), str(path)


def _parsed(data: bytes, path: str) -> AnyDocument:
    if _CONFIGURATION.search(data) and not _FORMAT.search(data):
        remedy = f"ffcomp machines import {path} -o my-printer.toml makes a machine file from it"
        raise MachineFileError(path, [f"This is a printer's configuration; {remedy}."])
    try:
        document = tomllib.loads(data.decode("utf-8"))
    except UnicodeDecodeError as error:
        problem = f"Byte {error.start} is not UTF-8 text, which TOML files must be."
        raise MachineFileError(path, [problem]) from None
    except tomllib.TOMLDecodeError as error:
        raise MachineFileError(path, [f"This is not valid TOML: {error}."]) from None
    return validated(document, path)


@dataclass(frozen=True)
class Entry:
    """One value of a machine file, with its provenance."""

    key: str  # table.key
    value: Any
    unit: str
    provenance: str  # 'default' if the file omits the value, '' if its origin is unknown


def entries(path: Path) -> list[Entry]:
    """Every value that describes the machine, defaults included, in the order of the file format."""
    document = _parsed(path.read_bytes(), str(path))
    stated = dict(flat(document.model_dump(exclude_unset=True)))
    values = flat(document.model_dump(exclude={"format", "name", "uncertainty", "provenance"}))

    quantities = document.quantities

    def entry(key: str, value: Any) -> Entry:
        written = _as_written(key, quantities)
        origin = str(document.provenance.get(written, "")) if key in stated else "default"
        return Entry(written, quantities.value(key, value), quantities.unit_of(quantities.key(key)), origin)

    return [entry(key, value) for key, value in values if value is not None]


def _as_written(key: str, quantities: Quantities) -> str:
    """Return the key as written in the file: forces of effects may be per kilogram."""
    table, _, rest = key.partition(".")
    effect, _, parameter = rest.partition(".")
    if table == "effects":
        return f"{table}.{effect}.{key_in_file(effect, parameter, quantities)}"
    return quantities.key(key)


def flat(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield every value of nested tables by its keys, joined with dots."""
    for key, value in table.items():
        if isinstance(value, dict):
            yield from flat(value, f"{prefix}{key}.")
        else:
            yield prefix + key, value


def starting_text(name: str, source: Path) -> str:
    """Return the text of a new machine file: `source` under a new name, with a note of its origin."""
    data = source.read_bytes()
    document = tomlkit.parse(data.decode("utf-8"))
    document["name"] = name
    document.setdefault("provenance", tomlkit.table())["started_from"] = (
        f"{source.stem} sha256:{hashlib.sha256(data).hexdigest()}"
    )
    return (
        f"# {name}, started from the machine file {source.stem!r}. Every number is that machine's, and its\n"
        f"# provenance with it, until you change both.\n\n{tomlkit.dumps(document)}"
    )


def check_text(text: str, path: str) -> None:
    """Raise MachineFileError with every mistake in a machine file's text; `path` is for messages."""
    _parsed(text.encode("utf-8"), path)


def updated_text(
    source: Path,
    values: Mapping[str, Any],
    *,
    name: str | None = None,
    uncertainty: Mapping[str, float] | None = None,
    provenance: Mapping[str, Any] | None = None,
) -> str:
    """Return the text of `source` with numbers replaced; comments, order and everything else stay.

    values : `table.key` or, for one element of a list, `table.key[i]` -> the new value; in the file's units, or, for an
        axis with units of its own, in internal units.
    uncertainty, provenance : entries to add to those tables, replacing what is there under the same key.
    """
    document = tomlkit.parse(source.read_bytes().decode("utf-8"))
    quantities = quantities_of(document)
    if name is not None:
        document["name"] = name
    for key, value in values.items():
        path, _, index = key.removesuffix("]").partition("[")
        *tables, last = path.split(".")
        table: Any = document
        for part in tables:
            table = table.setdefault(part, tomlkit.table())
        if last not in table:
            inside = quantities.inside(last)
            in_file = inside in table  # the file of a rotary axis may use internal keys
            value = quantities.value(last, value)
            last = inside if in_file else quantities.key(last)
        if index:
            table[last][int(index)] = value
        else:
            table[last] = value
    for title, entries_ in (("uncertainty", uncertainty), ("provenance", provenance)):
        table = document.setdefault(title, tomlkit.table())
        for key, value in (entries_ or {}).items():
            table[key if key in table else quantities.key(key)] = value
    return tomlkit.dumps(document)
