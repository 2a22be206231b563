"""Find turns of phrase that make our prose hard to read; exit with 1 where a folder has more than its limit.

    scripts/prose.py [FOLDER …]     all folders, as .ci/run does; or every hit in some folders or files

Prose is Markdown without code, and the docstrings, comments and texts of Python. A hit is a place to look at: rewrite
the sentence, never swap one phrase for another. Lower a folder's limit when it gets better.
"""

from __future__ import annotations

import io
import re
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
HABITS = {
    r"what (?:is|are|was|were|has|have|had|does|do|did|comes|becomes|cannot|can|no|holds|must|may|would|will)\b"
    r"(?![^.\n]{0,80}\?)": "name the thing: residual, lag, remaining files",
    r"as (?:it|they) (?:is|are|was|were)": "unchanged",
    r"(?<=[,;:] )for (?:it|they|there|no|nobody|nothing|this|these|only|what)": "because",
    r"anew|beside|thereby|therein|hence|whereby|withal|nought": "again, next to, so",
    r"tells?|told|asked for|asks? for|says? of|said of|speaks? of|knows? of|says? so": "contain, set, report, need",
    r"(?:nobody|nowhere|no one) (?:knows?|tells?|says?|has|is)|(?:is|are) to be|made up": "say it straight",
    r"(?:of|by|in|from|with|at|for) which": "two sentences, or where, whose, that",
    r"(?:written|replaced|read|kept|simulated|run|taken|measured|planned|lost|held) whole": "completely",
}
PATTERNS = [(re.compile(rf"\b(?:{habit})\b", re.IGNORECASE), remedy) for habit, remedy in HABITS.items()]
TOPS = ("README.md", "CONTRIBUTING.md", "docs", "ffcomp", "gcode", "models")
LIMIT = 1.0  # hits in 1,000 words
LIMITS = {  # of folders that are not rewritten yet
    **{"docs/reference": 1.3, "ffcomp/check": 3.9, "ffcomp/compensation": 1.2, "ffcomp/diagnosis": 7.9},
    **{"ffcomp/faster": 3.2, "ffcomp/firmware": 1.5, "ffcomp/identification": 3.6, "ffcomp/inverse": 1.4},
    **{"ffcomp/planner": 1.7, "ffcomp/steps": 2.4},
}


def pieces(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the number and the text of each line of prose in a file."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        text = re.sub(r"(?sm)^```.*?^```$|`[^`\n]*`", lambda code: "\n" * code[0].count("\n"), text)
        yield from enumerate(text.splitlines(), 1)
        return
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        kind = tokenize.tok_name[token.type]
        if kind == "COMMENT" or (kind in ("STRING", "FSTRING_MIDDLE") and " " in token.string):
            yield from enumerate(token.string.splitlines(), token.start[0])


def count(path: Path) -> tuple[int, list[str]]:
    """Count the words of a file and describe its hits."""
    words, hits = 0, []
    for line, text in pieces(path):
        words += len(re.findall(r"[A-Za-z]{2,}", text))
        found = [(hit.group(), remedy) for pattern, remedy in PATTERNS for hit in pattern.finditer(text)]
        hits += [f"{path.relative_to(ROOT)}:{line}: {hit!r}: {remedy}" for hit, remedy in found]
    return words, hits


def main(arguments: list[str]) -> int:
    """Check every folder, or print the hits of some; return the exit code."""
    found: dict[str, tuple[int, list[str]]] = {}
    tops = [Path(each).resolve() for each in arguments or [ROOT / top for top in TOPS]]
    for path in (p for top in tops for p in [top, *sorted(top.rglob("*"))] if p.suffix in (".md", ".py")):
        folder = "/".join(path.relative_to(ROOT).parent.parts[:2]) or "."
        words, hits = found.get(folder, (0, []))
        more, new = count(path)
        found[folder] = words + more, hits + new
    failed = False
    for folder, (words, hits) in sorted(found.items()):
        rate, limit = 1000 * len(hits) / max(words, 1), LIMITS.get(folder, LIMIT)
        failed |= rate > limit
        if arguments or rate > limit:
            print(*hits, f"{folder}: {rate:.2f} hits in 1,000 words, limit {limit:g}.", sep="\n")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
