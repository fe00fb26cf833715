"""The site, built by Sphinx: `make docs`."""

from __future__ import annotations

import os
import re
import sys
from importlib.metadata import version as version_of
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))
os.environ["PATH"] = f"{Path(sys.executable).parent}:{os.environ['PATH']}"

from docs.content import Content  # noqa: E402

project = "afl_mujoco"
author = "the afl_mujoco developers"
copyright = "2026, the afl_mujoco developers"
release = version = version_of("afl_mujoco")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.viewcode",
    "numpydoc",
    "sphinx_copybutton",
    "sphinx_design",
]
exclude_patterns = ["results", "_build", "pages"]

html_theme = "furo"
html_title = "afl_mujoco"
html_static_path = ["_static", "../afl_mujoco/report/assets"]
html_css_files = ["site.css", "replay.css"]
html_js_files = ["replay.js"]
html_copy_source = False

myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3

default_role = "code"  # docstrings quote code by single backticks
autodoc_typehints_format = "short"
python_maximum_signature_line_length = 80
numpydoc_show_class_members = False
suppress_warnings = ["ref.python"]  # a field of two classes has one name
autodoc_member_order = "bysource"
copybutton_prompt_text = "$ "

CONTENT = Content()

PLAIN = {
    r"~typing\.Annotated\[([^\[\]]*), <function \S+ at 0x\w+>\]": r"\1",
    r"~numpy\.ndarray\[tuple\[~typing\.Any, \.\.\.\], ~numpy\.dtype\[[^\]]*\]\]": "~numpy.ndarray",
    r"~numpy\.\S*_Buffer.*?\[complex \| bytes \| str\]": "ArrayLike",
    r"Plant\(name='cart-pole'.*?'gravity'\)\)": "'cart-pole'",
    "<factory>": "{}",
    " = <property object[^>]*>": "",
}
"""How a signature shows what stands in it at length."""


def setup(app: Sphinx) -> None:
    """Put replays into pages, shorten the signatures of the API, and link sources back to it."""
    app.connect("source-read", _replay)
    app.connect("html-page-context", _back)
    app.connect("autodoc-process-signature", _plainly)


def _plainly(*found: Any) -> tuple[str | None, str | None]:
    """Return a signature and what it returns as a reader writes them."""
    texts = found[-2:]
    for long, short in PLAIN.items():
        texts = tuple(text and re.sub(long, short, text) for text in texts)
    return texts


def _back(app: Sphinx, page: str, _: str, context: dict[str, Any], __: Any) -> None:
    """Let a page of source link back to what is documented by the name of its own module.

    Sphinx takes one module for all of a page's names, and half of ours stand in `afl_mujoco`.
    """
    known, own = app.env.domaindata["py"]["objects"], page.removeprefix("_modules/")

    def link(found: re.Match[str]) -> str:
        name = found[2]
        if name not in known:
            name = f"{own.replace('/', '.')}.{name.removeprefix('afl_mujoco.')}"
        return f"{found[1]}#{name}" if name in known else found[0]

    if own != page:
        context["body"] = re.sub(
            r'(class="viewcode-back" href="[^#"]*)#([^"]+)', link, context["body"]
        )


def _replay(app: Sphinx, page: str, source: list[str]) -> None:
    """Put a replay where a page has its mark, a comment that a code host does not show."""
    source[0] = re.sub(r"<!-- replay (\S+) -->", lambda one: CONTENT.replay(one[1]), source[0])
