"""The claims ledger of docs/tuning.md, printed from a report."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from afl_mujoco.errors import FileError
from afl_mujoco.studies.verification.criteria_table import rewrite


def claims_table(report: Path) -> str:
    """Return the claims of a report as a Markdown table."""
    claims = json.loads(report.read_text(encoding="utf-8"))["claims"]
    if not claims:
        raise FileError(str(report), "must hold claims: run make proof on every scenario")
    lines = [("", "claim", "paper", "here", "verdict", "why"), ("---",) * 6]
    for claim in claims:
        numbers = ("–" if x is None else f"{x:.4g}" for x in (claim["paper"], claim["here"]))
        said = f"{claim['claim']}; *{claim['figure']}*"
        lines.append((claim["id"], said, *numbers, f"**{claim['verdict']}**", claim["why"]))
    cells = [[cell.replace("|", "\\|") for cell in line] for line in lines]
    return "".join("| " + " | ".join(line) + " |\n" for line in cells)


if __name__ == "__main__":
    rewrite(Path(sys.argv[1]), "claims", claims_table(Path(sys.argv[2])))
