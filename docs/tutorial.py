"""Run the Python of the tutorial in its folder, block by block; print what each prints.

    python docs/tutorial.py

`make results ARGS=tutorial` keeps it, and the pages show it.
"""

import json
import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path

HERE = Path(__file__).parent
PAGE = HERE / "pages" / "tutorial" / "index.md"
MARK = "# %%\n"  # before what a block prints, and at the end


BLOCK = re.compile(r"^```python\n(.*?)^```$", re.DOTALL | re.MULTILINE)
PRINTED = re.compile(r"\A\s*```text\n.*?^```$", re.DOTALL | re.MULTILINE)


def notebook(text: str) -> str:
    """Return a page as a notebook: its Python as cells, and what stands between them.

    What the blocks print is left out: the notebook prints it itself.
    """
    own = BLOCK.findall(PAGE.read_text(encoding="utf-8"))  # not the files that it shows

    def cells() -> Iterator[dict[str, object]]:
        for k, said in enumerate(BLOCK.split(text)):  # in turn what stands between, and blocks
            if k % 2 and said in own:
                yield {"cell_type": "code", "execution_count": None, "outputs": [],
                       "metadata": {}, "source": said.strip()}  # fmt: skip
            elif words := f"```python\n{said}```" if k % 2 else PRINTED.sub("", said).strip():
                yield {"cell_type": "markdown", "metadata": {}, "source": words}

    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    whole = {"nbformat": 4, "nbformat_minor": 4, "metadata": {"kernelspec": kernel},
             "cells": [*cells()]}  # fmt: skip
    return json.dumps(whole, indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    os.chdir(HERE / "tutorial")
    sys.path.insert(0, "")
    known: dict[str, object] = {}
    for block in BLOCK.findall(PAGE.read_text(encoding="utf-8")):
        print(MARK, end="")
        exec(block, known)  # our own page
    print(MARK, end="")
