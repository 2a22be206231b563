"""What Moonraker's own metadata script reads in a file, and a file with what it reads."""

from __future__ import annotations

import base64
import importlib.util
import io
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from PIL import Image


def metadata(folder: Path, name: str, processors: list[dict[str, Any]]) -> tuple[dict[str, Any], str]:
    """What Moonraker's own script finds in a file, and what it logs."""
    spec = importlib.util.find_spec("moonraker")
    if spec is None or spec.submodule_search_locations is None:
        pytest.skip("no Moonraker here to read the file (pip install --no-deps moonraker)")
    script = Path(spec.submodule_search_locations[0], "components", "file_manager", "metadata.py")
    config = folder / "config.json"
    config.write_text(json.dumps({"gcode_dir": str(folder), "filename": name, "processors": processors}))
    answer = subprocess.run([sys.executable, script, "-c", config], capture_output=True, text=True, check=True)
    found: dict[str, Any] = json.loads(answer.stdout)["metadata"]
    return found, answer.stderr


def thumbnail() -> list[bytes]:
    """A picture of 32 x 32, as PrusaSlicer writes it: its length in base64 must be kept."""
    picture = io.BytesIO()
    Image.new("RGB", (32, 32), "red").save(picture, "PNG")
    text = base64.b64encode(picture.getvalue())
    lines = [b"; %s\n" % text[k : k + 78] for k in range(0, len(text), 78)]
    return [b";\n; thumbnail begin 32x32 %d\n" % len(text), *lines, b"; thumbnail end\n;\n"]
