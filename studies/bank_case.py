"""Ask for the verdict of one sealed case: ours, by the API that the command line uses, and those of its rivals.

    python -m studies.bank_case FOLDER OUT FRESH ...     a process of its own for each case, so that it can be stopped

FOLDER holds machine.toml and runs/; OUT.json gets the verdict, OUT.toml the better machine file, and OUT-proof.json the
gap on FRESH runs before and after. Nothing here reads a label.
"""

from __future__ import annotations

import json
import resource
import sys
import time
import traceback
from pathlib import Path
from typing import Any

from ffcomp.api.measurements import diagnose, gap
from ffcomp.errors import FfcompError
from studies.bank_rivals import rivals

LONGEST_S = 600  # of CPU: of the answer, and of its rivals


def main() -> None:
    """Ask, and write the answers."""
    resource.setrlimit(resource.RLIMIT_CPU, (LONGEST_S, LONGEST_S + 10))
    folder, out, *fresh = map(Path, sys.argv[1:])
    runs, better = sorted((folder / "runs").glob("*.csv")), out.with_suffix(".toml")
    began = time.process_time()
    try:
        found = diagnose(runs, folder / "machine.toml", better)
    except FfcompError as error:
        written(out.with_suffix(".json"), {"verdict": "failed", "why": str(error)})
        return
    took = time.process_time() - began
    others = compared(found.search)
    beside = time.process_time() - began - took
    proof = {}
    if better.exists():
        before, after = (gap(fresh, file).residual.total for file in (folder / "machine.toml", better))
        proof = {"before": before.nrms, "after": after.nrms, "noise": before.noise_nrms}
    written(out.parent / f"{out.stem}-proof.json", proof)
    tried = [{"effects": list(h.names), "evidence": h.fit.evidence, "left": h.discrepancy} for h in found.search.tried]
    written(
        out.with_suffix(".json"),
        {**found.to_dict(), "cpu_seconds": took, "rivals_cpu_seconds": beside, "rivals": others, "tried": tried[:8]},
    )


def compared(search: Any) -> dict[str, Any]:
    """Return the rivals' verdicts; one that fails has none."""
    try:
        return rivals(search)
    except Exception:
        failed = {"verdict": "failed", "effects": [], "why": traceback.format_exc()[-500:]}
        return dict.fromkeys(("sindy", "spike_slab", "bic"), failed)


def written(path: Path, content: dict[str, Any]) -> None:
    """All or nothing: an interrupted run leaves no half a verdict."""
    beside = path.with_suffix(".part")
    beside.write_text(json.dumps(content, indent=1), encoding="utf-8")
    beside.replace(path)


if __name__ == "__main__":
    main()
