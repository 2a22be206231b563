"""docs/reference/json.md: the tables of keys, written from the code that makes the objects.

An object is a dataclass, or functions whose dictionaries hold its keys. What a key means stands once, as the comment at
its field or entry: `# a sentence`, `# text or null: a sentence`, `# number [unit]: a sentence`, `# .* ERROR` of objects
by name, `# [] ERROR` of a list of objects, `# … TRACK` of keys that stand here too. Without a type, a field has that of
its annotation, and an entry is a number if its name ends in a unit, else a text. What is written around the tables
stays, and so do tables of objects that are not named here.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from studies.render import print_or_write

PAGE = Path(__file__).parents[1] / "docs" / "reference" / "json.md"

OBJECTS: dict[str, dict[str, str]] = {  # by heading of the page: by place of its keys in the object, who makes them
    "TRACK": {"": "ffcomp.metrics:Track"},
    "EXPECTATION": {"": "ffcomp.simulation.expectation:Expectation"},
    "ANSWER": {"": "ffcomp.result:Answer"},
    "MACHINE": {"": "models.machine:identity"},
    "PARTY": {"": "ffcomp.comparison.result:Party"},
    "ESTIMATE": {"": "ffcomp.identification.uncertainty:Estimate"},
    "ERROR": {"": "ffcomp.comparison.result:Error"},
    "SPREAD": {"": "ffcomp.comparison.result:Spread.to_dict"},
    "SIZE": {"": "ffcomp.diagnosis.gap:ResidualSize.to_dict"},
    "EXTREME": {"": "models.checks:Extreme"},
    "BODE": {"": "ffcomp.identification.frf_study:_bode"},
    "ffcomp-compensate/1": {
        "": (
            "ffcomp.compensation.result:CompensatedFile.details "
            "ffcomp.compensation.result:Result.to_dict? "
            "ffcomp.simulation.forecast:Forecast.to_dict? "
            "ffcomp.compensation.statistics:Shares.to_dict? "
            "ffcomp.result:Result.to_dict"
        ),
        "uncompensated[].": "ffcomp.compensation.statistics:_command_dict",
        "slowed[].": "ffcomp.inverse.time_scaling:TimeScaling",
        "steps.*.": "ffcomp.steps.sink:MotorTotal",
        "faster.": "ffcomp.compensation.result:QuickerPrint?",
    },
    "ffcomp-compensate-batch/1": {
        "": "ffcomp.compensation.result:CompensatedFiles.details ffcomp.result:Result.to_dict"
    },
    "FAILED": {"": "ffcomp.compensation.result:FileResult.to_dict"},
    "ffcomp-estimate/1": {"": "ffcomp.estimation.engine:Estimate.details ffcomp.result:Result.to_dict"},
    "ACCOUNT": {
        "": "ffcomp.estimation.engine:_values",
        "layers[].": "ffcomp.estimation.engine:_layer",
        "unknown[].": "ffcomp.estimation.statistics:Unknown",
    },
    "ffcomp-estimate-batch/1": {"": "ffcomp.cli.estimate:Estimates.details ffcomp.result:Result.to_dict"},
    "ffcomp-show/1": {
        "": "ffcomp.cli.show:ShowResult.details ffcomp.simulation.forecast:Forecast.to_dict "
        "ffcomp.result:Result.to_dict",
    },
    "ffcomp-compare/1": {
        "": "ffcomp.comparison.result:Comparison.to_dict ffcomp.api.comparison:MethodComparison.details "
        "ffcomp.result:Result.to_dict",
        "layers[].": "ffcomp.comparison.result:Layer",
    },
    "METHOD": {
        "": "ffcomp.comparison.result:Method.to_dict",
        "peaks.": "ffcomp.comparison.result:Peaks",
    },
    "QUALITY": {"": "ffcomp.comparison.result:EqualQuality"},
    "ffcomp-simulate/1": {"": "ffcomp.simulation.simulation:Simulation.details ffcomp.result:Result.to_dict"},
    "ffcomp-frf/1": {
        "": "ffcomp.identification.frf_study:frf_json ffcomp.result:Result.to_dict",
        "measured[].": "ffcomp.identification.frf_study:_compared_answer",
    },
    "ffcomp-gap/1": {"": "ffcomp.diagnosis.gap:Discrepancy.details ffcomp.result:Result.to_dict"},
    "ffcomp-diagnose/1": {
        "": "ffcomp.diagnosis.verb:result_json ffcomp.diagnosis.verb:Diagnosis.details ffcomp.result:Result.to_dict",
        "effects[].": "ffcomp.diagnosis.verb:_effect_json",
        "residual_curves[].": "ffcomp.diagnosis.residual_curves:ResidualCurve.to_dict",
        "separate[].": "ffcomp.diagnosis.next_experiment:Separation.to_dict",
    },
    "DOMINANT": {"": "ffcomp.diagnosis.verb:_effect_json ffcomp.diagnosis.result:Rest.to_dict"},
    "GAIN": {"": "ffcomp.diagnosis.verb:PrintGain.to_dict"},
    "ffcomp-identify-fit/1": {
        "": (
            "ffcomp.identification.machine_fit:MachineFit.details "
            "ffcomp.identification.machine_fit:ParametersFit.own? "
            "ffcomp.identification.machine_fit:StepwiseFit.own? "
            "ffcomp.identification.machine_fit:AxesFit.own? "
            "ffcomp.identification.machine_fit:ResonancesFit.own? "
            "ffcomp.identification.axis_fit:OneAxisFit.own? "
            "ffcomp.result:Result.to_dict"
        ),
        "shapers[].": "ffcomp.shapers.calibration:ShaperAdvice",
        "belts.": "ffcomp.identification.machine_fit:_belts?",
        "axes.*.": "ffcomp.identification.machine_fit:_axis",
        "axes.*.modes[].": "ffcomp.identification.modal_fit:AxisMode",
        "responses[].": "ffcomp.identification.machine_fit:_quality",
    },
    "ffcomp-identify-scan/1": {
        "": (
            "ffcomp.identification.machine_fit:MachineFit.details "
            "ffcomp.identification.machine_fit:ScanFit.own "
            "ffcomp.result:Result.to_dict "
            "-belts"
        ),
        "shapers[].": "ffcomp.shapers.calibration:ShaperAdvice",
    },
    "ffcomp-identify-decouple/1": {
        "": "ffcomp.identification.decoupling:Decoupling.details ffcomp.result:Result.to_dict",
        "places[].": "ffcomp.identification.decoupling:PlaceParts.to_dict",
    },
    "ffcomp-record-plan/1": {
        "": "ffcomp.record.planning:PlanResult.details ffcomp.result:Result.to_dict",
        "experiments[].": "ffcomp.record.planning:PlanResult._experiment_dict",
        "experiments[].peaks.": "ffcomp.record.excitation:Peaks",
    },
    "ffcomp-update/1": {"": "ffcomp.diagnosis.update:Updated.details ffcomp.result:Result.to_dict"},
    "ffcomp-join/1": {"": "ffcomp.record.result:JoinedRuns.details ffcomp.result:Result.to_dict"},
    "ffcomp-check/1": {
        "": "ffcomp.check.compare:CheckResult.details ffcomp.result:Result.to_dict",
        "named[].": "ffcomp.check.compare:Explanation.to_dict",
        "experiments[].": "ffcomp.check.compare:Size",
    },
    "ffcomp-captures/1": {"": "ffcomp.cli.simulate:Captures.details ffcomp.result:Result.to_dict"},
    "ffcomp-machine-diff/1": {
        "": "ffcomp.cli.machines:MachineDifference.details ffcomp.result:Result.to_dict",
        "changes[].": "models.file:Difference",
    },
    "ffcomp-restore/1": {"": "ffcomp.cli.restore:Restored.details ffcomp.result:Result.to_dict"},
    "ffcomp-machine-import/1": {
        "": "ffcomp.cli.machines_import:ImportedMachine.details ffcomp.result:Result.to_dict",
        "values.*.": "ffcomp.importers.values:Value",
    },
}
UNITS = {
    "um": "µm",
    "mm": "mm",
    "s": "s",
    "hz": "Hz",
    "kg": "kg",
    "deg": "°",
    "rad": "rad",
    "percent": "%",
    "db": "dB",
    "c": "°C",
    "mm_per_s": "mm/s",
    "mm_per_s2": "mm/s²",
    "mm3_per_s": "mm³/s",
}
ANNOTATIONS = {"str": "text", "Path": "text", "float": "number", "int": "whole number", "bool": "true or false"}
ANNOTATIONS |= {"None": "null", "FloatArray": "list of numbers"}
LISTS, MAPPINGS = ("tuple", "list", "Sequence"), ("dict", "Mapping")
PLURAL = re.compile("^(list|number|whole number)")
KIND = (
    r"(?:list of |lists of )*"
    r"(?:whole numbers?|numbers?(?: and nulls)?|text|true or false|null|[A-Z]{3,}|ffcomp-[\w-]+/1)"
)
COMMENT = re.compile(
    rf"(?:(…|(?:\[\]|\.\*)+) )?(?:({KIND}(?: or {KIND})*(?:, may be missing)?)(?: \[(.*?)\])?(?:: |$))?(.*)"
)


@dataclass(frozen=True)
class Key:
    """A key of an object: its place there, and its entry or field in the code."""

    name: str
    node: ast.expr | ast.AnnAssign
    file: Path
    optional: bool = False

    @property
    def comment(self) -> str:
        """What stands behind it, and on lines of their own before it."""
        lines, first = _lines(self.file), self.node.lineno - 1
        own: list[str] = []
        while lines[first - 1].strip().startswith("# "):
            first -= 1
            own.insert(0, lines[first].strip().removeprefix("# "))
        end = self.node.end_lineno if isinstance(self.node, ast.AnnAssign) else self.node.lineno
        behind = re.search(r"  # (.*)$", lines[(end or 1) - 1])
        return " ".join([*own, *([behind[1]] if behind else [])])

    @property
    def parts(self) -> tuple[str, str, str, str]:
        """Of its comment: what follows its name, type, unit, meaning; empty where nothing is said."""
        match = COMMENT.match(self.comment)
        assert match is not None
        rest, kind, unit, meaning = (part or "" for part in match.groups())
        return rest, kind, unit, meaning

    @property
    def kind(self) -> str:
        """Its type, stated or not."""
        stated = self.parts[1]
        if stated or not isinstance(self.node, ast.AnnAssign):
            return stated or ("number" if _unit(self.name) else "text")
        return _of_annotation(self.node.annotation)

    def row(self) -> str:
        """Its row of the page."""
        rest, _, unit, meaning = self.parts
        unit = unit or (_unit(self.name) if "number" in self.kind or "ESTIMATE" in self.kind else "")
        once = not re.search(r"(\[\]|\.\*)\.", self.name)  # within a list they are there if it is
        kind = self.kind + (", may be missing" if self.optional and once else "")
        return f"| `{self.name}{rest}` | {kind} | {unit} | {meaning}{' ' * bool(meaning)}|"


def _of_annotation(node: ast.expr) -> str:
    if isinstance(node, ast.BinOp):
        return f"{_of_annotation(node.left)} or {_of_annotation(node.right)}"
    if isinstance(node, ast.Subscript):
        name, inner = ast.unparse(node.value), node.slice
        if name in LISTS:
            return "list of " + PLURAL.sub(
                r"\1s", _of_annotation(inner.elts[0] if isinstance(inner, ast.Tuple) else inner)
            )
        if name in MAPPINGS and isinstance(inner, ast.Tuple):
            return _of_annotation(inner.elts[1])
        return "text"  # Literal
    return ANNOTATIONS.get(ast.unparse(node), ast.unparse(node))


def _names_of(node: ast.expr) -> str:
    """Return `.*` for each mapping of an annotation."""
    if isinstance(node, ast.Subscript) and ast.unparse(node.value) in MAPPINGS and isinstance(node.slice, ast.Tuple):
        return f".*{_names_of(node.slice.elts[1])}"
    return ""


def _unit(name: str) -> str:
    words = re.sub(r"[\[\]*.]+$", "", name).rpartition(".")[2].split("_")
    ends = ["_".join(words[k:]) for k in range(1, len(words))]
    unit = next((UNITS[end] for end in ends if end in UNITS), "")
    return "" if "per" in words and "/" not in unit else unit


@cache
def _lines(file: Path) -> list[str]:
    return file.read_text(encoding="utf-8").splitlines()


@cache
def _tree(file: Path) -> ast.Module:
    return ast.parse("\n".join(_lines(file)))


def keys_of(places: Mapping[str, str], prefix: str = "") -> Iterator[Key]:
    """Return the keys of an object, in the order in which they are made."""
    names = {prefix + each[1:] for each in places[prefix].split() if each[0] == "-"}
    for key in (key for place in places[prefix].split() if place[0] != "-" for key in _made(place, prefix)):
        if key.name in names or (key.name == prefix and key.parts[0] != "…"):
            continue
        names.add(key.name)
        inside = [key.name + rest for rest in (".", "[].", ".*.", ".*[].") if key.name + rest in places]
        yield from keys_of(places, inside[0]) if inside else (key,)


def _made(place: str, prefix: str) -> Iterator[Key]:
    """Return the keys of one dataclass or function; `?`: which may be missing."""
    module, _, name = place.rstrip("?").partition(":")
    spec = find_spec(module)
    assert spec is not None and spec.origin is not None
    file = Path(spec.origin)
    node: ast.AST = _tree(file)
    for part in name.split("."):
        inside = {
            each.name: each for each in ast.iter_child_nodes(node) if isinstance(each, ast.ClassDef | ast.FunctionDef)
        }
        node = inside[part]
    maker = _Fields(file) if isinstance(node, ast.ClassDef) else _Entries(file, node)
    yield from maker.keys(node, prefix, place.endswith("?"))


@dataclass(frozen=True)
class _Fields:
    file: Path

    def keys(self, node: ast.AST, prefix: str, optional: bool) -> Iterator[Key]:
        """Return the fields that JSON can hold."""
        for each in ast.iter_child_nodes(node):
            if isinstance(each, ast.AnnAssign) and isinstance(each.target, ast.Name):
                key = Key(prefix + each.target.id + _names_of(each.annotation), each, self.file, optional)
                if key.parts[1] or not (each.target.id.startswith("_") or re.search("[A-Z][a-z]", key.kind)):
                    yield key


class _Entries:
    """The dictionaries of a function."""

    def __init__(self, file: Path, function: ast.AST) -> None:
        assigned = [each for each in ast.walk(function) if isinstance(each, ast.Assign)]
        self.file = file
        self.values = {each.targets[0].id: each.value for each in assigned if isinstance(each.targets[0], ast.Name)}

    def keys(self, node: ast.AST, prefix: str, optional: bool) -> Iterator[Key]:
        """Return the entries of all dictionaries, those of others within these."""
        dictionaries = [each for each in ast.walk(node) if isinstance(each, ast.Dict)]
        inside = {id(each) for one in dictionaries for value in one.values for each in self._dictionaries(value)}
        for each in ast.walk(node):
            if isinstance(each, ast.Assign) and isinstance(each.targets[0], ast.Subscript):
                inside |= {id(one) for one in self._dictionaries(each.value)}
        for each in sorted(ast.walk(node), key=lambda one: getattr(one, "lineno", 0)):
            if isinstance(each, ast.Dict) and id(each) not in inside:
                yield from self._of(each, prefix, optional)
            if isinstance(each, ast.Assign) and isinstance(each.targets[0], ast.Subscript):
                key = each.targets[0].slice
                if isinstance(key, ast.Constant) and isinstance(key.value, str):
                    yield from self._value(key, each.value, prefix + key.value, True)

    def _dictionaries(self, value: ast.expr) -> Iterator[ast.Dict]:
        for each in ast.walk(value):
            if isinstance(each, ast.Dict):
                yield each
            elif isinstance(each, ast.Name) and each.id in self.values:
                yield from (one for one in ast.walk(self.values[each.id]) if isinstance(one, ast.Dict))

    def _of(self, node: ast.Dict, prefix: str, optional: bool) -> Iterator[Key]:
        for key, value in zip(node.keys, node.values, strict=True):
            if isinstance(key, ast.Constant) and isinstance(key.value, str):
                yield from self._value(key, value, prefix + key.value, optional)
            elif key is None:  # **
                sides = [value.body, value.orelse] if isinstance(value, ast.IfExp) else [value]
                for side in sides:
                    side = self.values.get(side.id, side) if isinstance(side, ast.Name) else side
                    if isinstance(side, ast.Dict):
                        yield from self._of(side, prefix, optional or len(sides) > 1)
                yield Key(prefix, value, self.file)

    def _value(self, key: ast.expr, value: ast.expr, name: str, optional: bool) -> Iterator[Key]:
        whole = Key(name, key, self.file, optional)
        if isinstance(value, ast.Name) and value.id in self.values:
            value = self.values[value.id]
        if isinstance(value, ast.IfExp):
            value = value.orelse if isinstance(value.body, ast.Constant) else value.body
        if isinstance(value, ast.Name) and value.id in self.values:
            value = self.values[value.id]
        if whole.parts[1] or not any(each.keys for each in self._dictionaries(value)):
            yield whole
        elif isinstance(value, ast.Dict):
            yield from self._of(value, f"{name}.", optional)
        elif isinstance(value, ast.ListComp | ast.List):
            yield from self._value(
                key, value.elt if isinstance(value, ast.ListComp) else value.elts[0], f"{name}[]", optional
            )
        elif isinstance(value, ast.DictComp):
            yield from self._value(key, value.value, f"{name}.*", optional)
        else:
            yield whole


def page() -> str:
    """The page, with the tables as the code has them."""
    text = PAGE.read_text(encoding="utf-8")
    for heading, places in OBJECTS.items():
        table = re.compile(rf"(^##+ {re.escape(heading)}\n(?:(?!^##|^\| `).*\n)*)((?:\| `.*\n)+)", re.MULTILINE)
        match = table.search(text)
        if match is None:
            raise ValueError(f"{PAGE.name} has no table under {heading!r}.")
        rows = "".join(f"{key.row()}\n" for key in keys_of(places))
        text = text[: match.start(2)] + rows + text[match.end(2) :]
    return text


if __name__ == "__main__":
    print_or_write(page(), PAGE)
