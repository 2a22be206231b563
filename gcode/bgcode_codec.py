"""Converts binary G-code to text and back, as a program: python bgcode_codec.py SOURCE TARGET BYTES [OPTIONS as JSON].

The codec (pybgcode, AGPL) trusts its input. It runs in a process of its own so that a malicious file can only crash
that process. Where the system supports limits, the process may write at most BYTES and use at most 1 GiB of memory.
Exit codes: 0 done; 3 failed, with the reason on stdout.
"""

from __future__ import annotations

import json
import sys
from contextlib import suppress
from importlib import import_module
from typing import Any

MEMORY_BYTES = 1 << 30


def convert(source: str, target: str, options: dict[str, str] | None) -> str:
    """Convert a file. Return the reason if it fails, else ""; `options` are for packing, None unpacks."""
    codec = import_module("pybgcode")
    files = [codec.open(source, "rb"), codec.open(target, "wb")]
    try:
        if options is None:
            result = codec.from_binary_to_ascii(*files, True)
        else:
            result = codec.from_ascii_to_binary(*files, _config(codec, **options))
    finally:
        for file in files:
            codec.close(file)
    return "" if result == codec.EResult.Success else str(codec.translate_result(result))


def _config(codec: Any, compression: str, encoding: str, checksum: str) -> Any:
    names, config = codec._bgcode, codec.get_config()
    config.compression.gcode = getattr(names.CompressionType, compression)
    config.gcode_encoding = getattr(names.GCodeEncodingType, encoding)
    config.checksum = getattr(names.ChecksumType, checksum)
    return config


def _limit(written_bytes: int) -> None:
    if sys.platform != "win32":
        import resource

        for what, most in ((resource.RLIMIT_FSIZE, written_bytes), (resource.RLIMIT_AS, MEMORY_BYTES)):
            _, hard = resource.getrlimit(what)
            with suppress(ValueError, OSError):  # macOS has no memory limit
                resource.setrlimit(what, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


if __name__ == "__main__":
    source, target, written, *options = sys.argv[1:]
    _limit(int(written))
    why_not = convert(source, target, json.loads(options[0]) if options else None)
    print(why_not)
    raise SystemExit(3 if why_not else 0)
