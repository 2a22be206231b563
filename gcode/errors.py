"""The errors of a G-code file: each names the place and the rule.

GcodeError                a line we cannot follow (file, line, rule)
└── UnsupportedGcode      well-formed, but ambiguous
"""

from __future__ import annotations


class GcodeError(ValueError):
    """A G-code line that cannot be followed.

    rule : a sentence with the value and the rule that it breaks
    line : number in the file, from 1;  path : the file, as the user named it
    """

    exit_code = 4

    def __init__(self, rule: str, line: int | None = None, path: str = "") -> None:
        self.rule, self.line, self.path = rule, line, path
        super().__init__(rule)

    def __str__(self) -> str:
        place = ":".join(p for p in (self.path, "" if self.line is None else str(self.line)) if p)
        return f"{place}: {self.rule}" if place else self.rule

    def located(self, path: str) -> GcodeError:
        """Return the same error with the file's name."""
        return type(self)(self.rule, self.line, path)


class UnsupportedGcode(GcodeError):
    """Well-formed G-code whose meaning ffcomp refuses to guess."""
