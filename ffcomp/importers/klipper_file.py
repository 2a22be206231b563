"""Klipper's and Kalico's configuration files: sections, options, includes and the SAVE_CONFIG block.

The rules are those of the firmware's reader. Of an option that is given twice the last counts; an option of the
SAVE_CONFIG block counts only where the rest does not give it. `[include …]` is relative to the
file it stands in. Kalico also fills in `${section.option}`. Values are parsed only on demand, so macros
do no harm.
"""

from __future__ import annotations

import glob
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

from ffcomp.importers.text import decoded
from ffcomp.importers.values import PrinterConfigError, Value, plain_number

SAVED_HEAD = (
    "\n#*# <---------------------- SAVE_CONFIG ---------------------->\n"
    "#*# DO NOT EDIT THIS BLOCK OR BELOW. The contents are auto-generated.\n"
    "#*#\n"
)
SAVED_LINE = re.compile(r"#\*#(?: (?P<text>.*))?")
COMMENT = re.compile(r"#.*|(?:^|(?<=\s));.*")
HEADER = re.compile(r"\s*\[(?P<name>.+)\]")
DELIMITER = re.compile(r"[:=]")
REFERENCE = re.compile(r"\$\{(?:(?P<section>[^.:${}]+)[.:])?(?P<option>[^${}]+)\}")
DEEPEST_REFERENCE = 10
MOST_FILES = 1000


@dataclass(frozen=True)
class Option:
    """One option of a section."""

    lines: list[str]  # what follows the name, and indented lines below
    place: str  # file:line

    @property
    def text(self) -> str:
        """Value without surrounding space."""
        return "\n".join(self.lines).strip()


@dataclass
class KlipperConfig:
    """The options of a configuration and everything it includes; filled line by line."""

    name: str
    options: dict[tuple[str, str], Option] = field(default_factory=dict)  # (section, option in small letters)
    remarks: list[str] = field(default_factory=list)  # sentences about parts that were not read
    files: int = 0  # included so far
    alone: bool = False  # no other file is read

    def text(self, section: str, option: str) -> Option | None:
        """Return an option with Kalico's references filled in."""
        found = self.options.get((section, option))
        for _ in range(DEEPEST_REFERENCE):
            if found is None or not (reference := REFERENCE.search(found.text)):
                return found
            found = replace(found, lines=[self._filled(found, reference, section)])
        raise PrinterConfigError(f"{found.place if found else ''}: [{section}] {option} refers to itself.")

    def number(self, section: str, option: str, *, above: float = -math.inf) -> Value | None:
        """Parse the number of an option; None if it is not given."""
        found = self.text(section, option)
        if found is None:
            return None
        name = f"[{section}] {option}"
        return Value(plain_number(found.text, f"{found.place}: {name}", above=above), "read", f"{found.place} {name}")

    def _filled(self, option: Option, reference: re.Match[str], section: str) -> str:
        referred = (reference["section"] or section, reference["option"].lower())
        if referred not in self.options:
            name = f"[{referred[0]}] {referred[1]}"
            raise PrinterConfigError(f"{option.place}: {reference[0]} refers to {name}, which is not given.")
        return option.text[: reference.start()] + self.options[referred].text + option.text[reference.end() :]


def read_klipper(path: Path, alone: bool = False) -> KlipperConfig:
    """Read a `printer.cfg` with all it includes, or without if it is read alone.

    Raises
    ------
    PrinterConfigError
        For a line that is neither a section nor an option, a file that includes itself, a damaged SAVE_CONFIG block.
    """
    regular, head, block = decoded(path).partition(SAVED_HEAD)
    config, saved = KlipperConfig(path.name, alone=alone), KlipperConfig(path.name, alone=alone)
    first_line = (regular + head).count("\n") + 1
    _refuse_stray_marks(regular, path)
    _read(regular, 1, path, config, (path.resolve(),))
    _read(_unmarked(block, first_line, path), first_line, path, saved, ())
    remarks = [*config.remarks, *_overruled(config, saved)]
    return KlipperConfig(path.name, {**saved.options, **config.options}, remarks)


def _overruled(config: KlipperConfig, saved: KlipperConfig) -> Iterator[str]:
    """Report saved options that the rest of the configuration gives differently."""
    for (section, key), option in saved.options.items():
        regular = config.options.get((section, key), option)
        if regular.text != option.text:
            yield (
                f"{option.place}: the saved {key} = {option.text!r} of [{section}] does not count, because "
                f"{regular.place} says {regular.text!r}."
            )


def _refuse_stray_marks(regular: str, path: Path) -> None:
    """Raise for saved values above the block, or without its head."""
    for line_number, line in enumerate(regular.split("\n"), 1):
        if line.startswith("#*# "):
            raise PrinterConfigError(
                f"{path.name}:{line_number}: {line[:60]!r} is a saved value, but the head of the SAVE_CONFIG block "
                "does not stand above it as the firmware writes it: the firmware takes no notice of such values."
            )


def _unmarked(block: str, first_line: int, path: Path) -> str:
    """Strip the marks from the lines of the SAVE_CONFIG block."""
    lines = block.rstrip().split("\n") if block.strip() else []
    found = [SAVED_LINE.fullmatch(line) for line in lines]
    for line_number, (line, match) in enumerate(zip(lines, found, strict=True), first_line):
        if match is None:
            raise PrinterConfigError(
                f"{path.name}:{line_number}: {line[:60]!r} stands within the SAVE_CONFIG block, where every line must "
                "begin with #*#: the firmware takes no notice of such a block. Move the line up."
            )
    return "\n".join(match["text"] or "" for match in found if match)


def _read(text: str, first_line: int, path: Path, config: KlipperConfig, within: tuple[Path, ...]) -> None:
    section, key = "", None
    for line_number, line in enumerate(text.split("\n"), first_line):
        bare, place = COMMENT.sub("", line).rstrip(), f"{path.name}:{line_number}"
        if not bare:
            continue
        if bare[0].isspace() and key is not None:
            config.options[section, key].lines.append(bare.strip())
        elif header := HEADER.match(bare):
            section, key = header["name"].strip(), None
            if section.startswith("include "):
                _include(section.removeprefix("include ").strip(), place, path, config, within)
                section = ""
        else:
            key = _take(bare.strip(), section, place, config)


def _take(line: str, section: str, place: str, config: KlipperConfig) -> str:
    key, *text = (part.strip() for part in DELIMITER.split(line, maxsplit=1))
    if not text or not section:
        rule = "must stand in a section, after a line like [printer]" if text else "is no section and no option"
        raise PrinterConfigError(f"{place}: {line[:60]!r} {rule}.")
    config.options[section, key.lower()] = Option(text, place)
    return key.lower()


def _include(pattern: str, place: str, source: Path, config: KlipperConfig, within: tuple[Path, ...]) -> None:
    if config.alone:
        config.remarks.append(f"{place}: [include {pattern}]: only this file is read, not what it includes.")
        return
    files = list(_included(pattern, source))
    if not files and not glob.has_magic(pattern):
        config.remarks.append(f"{place}: [include {pattern}]: there is no such file; what it sets was not read.")
    for file in files:
        config.files += 1
        if file.resolve() in within or config.files > MOST_FILES:
            rule = f"more than {MOST_FILES} files are included" if config.files > MOST_FILES else "includes itself"
            raise PrinterConfigError(f"{place}: [include {pattern}]: {file.name}: {rule}.")
        _read(decoded(file), 1, file, config, (*within, file.resolve()))


def _included(pattern: str, source: Path) -> Iterator[Path]:
    names = sorted(glob.glob(str(Path(glob.escape(str(source.parent))) / pattern), recursive=True))
    return (Path(name) for name in names if Path(name).is_file())
