"""What a result says, wherever people look."""

from __future__ import annotations

import json
import re
from contextlib import redirect_stdout
from html import unescape
from io import StringIO
from pathlib import Path
from typing import Any

from ffcomp.cli.common import answer
from ffcomp.result import Answer, Result
from ffcomp.serve.messages import answer_of


def printed(result: Result, as_json: bool) -> str:
    """Return what the command line prints of a result."""
    with redirect_stdout(StringIO()) as out:
        answer(result, as_json)
    return out.getvalue()


def headlines(result: Result, report: Path) -> tuple[tuple[str, str, str, str], list[dict[str, Any]]]:
    """Return the headline on the terminal, as JSON, on the page of `serve` and on that of the report; and the JSON."""
    terminal, objects = printed(result, False).splitlines(), list(map(json.loads, printed(result, True).splitlines()))
    (told,) = {json.dumps(each["answer"]) for each in objects}
    lead = re.search(r'<p class="lead">(.*?)</p>', report.read_text(encoding="utf-8"), re.DOTALL)
    assert lead is not None
    plain = unescape(re.sub(r"</?code>", "", lead[1])).replace("\N{NO-BREAK SPACE}", " ")
    said = Answer(**json.loads(told))
    assert terminal == list(said.lines())
    (headline,) = [line for line in terminal if line == said.headline]
    return (headline, said.headline, answer_of(objects[0]).headline, plain), objects
