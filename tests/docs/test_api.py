import doctest
import importlib
import inspect
import re
from pathlib import Path

import pytest

import afl_mujoco as afl

PAGES = Path(__file__).parents[2] / "docs"
PAGE = (PAGES / "reference" / "api.md").read_text()
NAME = re.compile(r"(?<!`)`(?:[a-z_]+\.)*([A-Z]\w+|as_\w+)`(?!`)")  # of a class or a constant


def documented():
    module = ""
    for kind, name in re.findall(r"\.\. (currentmodule|auto\w+):: ([\w.]+)", PAGE):
        if kind == "currentmodule":
            module = name
            continue
        owner, _, last = name.rpartition(".")
        yield last, getattr(importlib.import_module(owner or module), last)


def docstrings(thing: object):
    parts = [v for k, v in vars(thing).items() if k[0] != "_"] if inspect.isclass(thing) else []
    for one in (thing, *parts):
        if callable(one) or isinstance(one, property):
            yield inspect.getdoc(one) or ""


def test_every_public_name_is_on_it_and_what_raises_says_why() -> None:
    assert set(afl.__all__) - {"__version__"} - {name for name, _ in documented()} == set()
    vague = re.compile(r"(setting|argument|value) breaks (its|a) rule")
    assert [name for name, thing in documented() if vague.search(inspect.getdoc(thing) or "")] == []


def test_its_examples_give_what_they_show_and_what_it_names_is_defined_on_it() -> None:
    pytest.importorskip("dm_control")
    finder, runner = doctest.DocTestFinder(recurse=False), doctest.DocTestRunner()
    for name, thing in documented():
        for example in finder.find(thing, name, module=False):
            runner.run(example)
    assert runner.summarize(verbose=False).failed == 0 and runner.tries > 25
    found = dict(documented())
    assert len(found) > 40
    texts = [(name, text) for name, thing in found.items() for text in docstrings(thing)]
    named = {(name, other) for name, text in texts for other in NAME.findall(text)}
    outside = {"MjModel", "MjData", "MjSpec", "RandomState"}  # MuJoCo's and NumPy's
    assert {(n, o) for n, o in named if o not in found and o not in outside} == set()


def test_every_class_that_a_page_names_is_in_the_code() -> None:
    root = PAGES.parent
    code = "".join(path.read_text() for path in root.glob("[ader]*/**/*.py"))
    pages = [path for path in PAGES.rglob("*.md") if "_build" not in path.parts]
    named = {
        (page.name, name)
        for page in (*pages, *root.glob("[A-Z]*.md"))
        if page.name.lower() != "changelog.md"
        for name in re.findall(r"`(?:\w+\.)*([A-Z]\w*[a-z]\w*)(?:\([^`]*\))?`", page.read_text())
    }
    gone = {one for one in named if not re.search(rf"\b{one[1]}\b", code)}
    assert len(named) > 15 and {name for _, name in gone} <= {"NamespaceNotFound"}  # Gymnasium's
