"""Read the JSON file of a plan: what is wrong with it becomes a sentence."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from ffcomp.errors import MeasurementError

T = TypeVar("T")

_BELONG = {
    "ffcomp-moves": " Plans of `record plan` belong to `ffcomp diagnose`, `identify fit` and `record join`.",
    "ffcomp-excitation": " Plans of `identify plan` belong to `identify fit`.",
}
"""What to say to the plan of another verb."""


def read_plan_json(path: str | Path, schema: str, build: Callable[[Mapping[str, Any]], T]) -> T:
    """Read a plan's file and build what it describes.

    Raises
    ------
    MeasurementError
        For a file that is no such plan, or an incomplete one.
    """
    try:
        read = json.loads(Path(path).read_text(encoding="utf-8"))
        if read["schema"] != schema:
            hint = _BELONG.get(str(read["schema"]).partition("/")[0], "")
            raise MeasurementError(str(path), [f"The schema is {read['schema']!r}; {schema!r} is needed.{hint}"])
        return build(read)
    except OSError as error:
        raise MeasurementError(str(path), [f"The plan cannot be read: {error.strerror}."]) from None
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise MeasurementError(str(path), [f"This is not JSON: {error}."]) from None
    except KeyError as error:
        raise MeasurementError(str(path), [f"The key {error} is missing; it belongs to {schema}."]) from None
    except (TypeError, ValueError, IndexError) as error:
        if isinstance(error, MeasurementError):
            raise
        raise MeasurementError(str(path), [f"This is no complete plan ({schema}): {error}."]) from None
