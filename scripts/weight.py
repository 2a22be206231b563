"""Compare the size of the checkout with the limits in docs/weight.toml; exit with 1 where a limit is exceeded.

    scripts/weight.py            check, as .ci/run does
    scripts/weight.py --lower    lower every limit to today's size; no limit is ever raised

A limit may be raised by hand only, in a commit that gives the reason in a section of docs/decisions.md.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path

import tomlkit

ROOT = Path(__file__).parents[1]
LIMITS = ROOT / "docs" / "weight.toml"
GENERATED = {"EFFECTS.md", "DIALECTS.md", "cli.md", "json.md", "machine_file.md", "library.md"}  # made from the code


def size_of_everything(root: Path) -> dict[str, dict[str, int]]:
    """Count lines of code by package and words of prose, under the names that docs/weight.toml has."""
    product = {"gcode": root / "gcode", "models": root / "models"}
    product |= {f"ffcomp.{p.name}": p for p in (root / "ffcomp").iterdir() if (p / "__init__.py").exists()}
    lines = {name: count_lines(folder.rglob("*.py")) for name, folder in sorted(product.items())}
    lines["ffcomp"] = count_lines((root / "ffcomp").glob("*.py"))
    lines["pages"] = count_lines(p for end in ("*.js", "*.css", "*.jinja") for p in (root / "ffcomp").rglob(end))
    for folder in ("integrations", "scripts", "tests", "validation", "studies", "benchmarks"):
        lines[folder] = count_lines((root / folder).rglob("*.py"))
    docs = [*(root / "docs").rglob("*.md"), root / "README.md", root / "CONTRIBUTING.md"]
    words = {
        "docs by hand": count_words(p for p in docs if p.name not in GENERATED),
        "docs made from the code": count_words(p for p in docs if p.name in GENERATED),
        "CHANGELOG": count_words([root / "CHANGELOG.md"]),
        "study reports": count_words((root / "studies").rglob("*.md")),
    }
    return {"lines": lines, "words": words}


def count_lines(paths: Iterable[Path]) -> int:
    return sum(p.read_text(encoding="utf-8").count("\n") for p in paths)


def count_words(paths: Iterable[Path]) -> int:
    return sum(len(p.read_text(encoding="utf-8").split()) for p in paths)


def main(arguments: list[str]) -> int:
    """Check or lower the limits; return the exit code."""
    limits = tomlkit.parse(LIMITS.read_text(encoding="utf-8"))
    exceeded = []
    for unit, sizes in size_of_everything(ROOT).items():
        for name in set(limits[unit]) - set(sizes):
            exceeded.append(f"{name}: has a limit but no longer exists. Remove it from {LIMITS.name}.")
        for name, size in sizes.items():
            limit = limits[unit].get(name, 0)
            if size > limit:
                exceeded.append(f"{name}: {size:,} {unit}, limit {limit:,} ({size - limit:+,}).")
            elif "--lower" in arguments:
                limits[unit][name] = size
    if "--lower" in arguments:
        LIMITS.write_text(tomlkit.dumps(limits), encoding="utf-8")
    print("\n".join(exceeded) or "Every package is within its limit (docs/weight.toml).")
    return bool(exceeded)


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
