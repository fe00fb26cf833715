"""Mutation testing by an outside tool: faults that nobody chose, and how many of them are noticed.

Cosmic Ray's operators say where the physics, the control, the loops, the checks and the statistics
can be changed, and how. Of all these mutants a sample is drawn, the same for the same seed, and
each is planted in a temporary copy of the repository, on which checks run until one objects: the
tests that are likely to, the verdict of `afl-mujoco validate --full`, the other tests of what is
computed, all but the slow ones.

OPERATORS has one replacement per operator. Left out, since no test could notice them or every test
would, which flatters the score: bitwise operators in place of arithmetic, ``is`` in place of
``==``, decorators, other exceptions to catch, annotations, docstrings, f-strings, errors' words.

A mutant is equivalent if equivalent_mutants.toml names it, with the reason; it is not run. The
score is the share of the others that were noticed. One that runs into the time limit was.
"""

import argparse
import ast
import hashlib
import json
import re
import sys
import tomllib
from collections import Counter, defaultdict
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from itertools import islice
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from afl_mujoco.files import write_text
from afl_mujoco.studies.montecarlo import rate
from afl_mujoco.studies.shared.record import versions
from tests import faulty_copies
from tests.faulty_copies import REPOSITORY, TimeLimitError, files_of, say

RESULT = REPOSITORY / "docs" / "results" / "mutants.json"
EQUIVALENT = Path(__file__).with_name("equivalent_mutants.toml")
AREAS = {
    "equations": ("plants/cartpole_equations.py", "plants/equations.py", "plants/tree.py"),
    "plants in MuJoCo": ("plants/*.py",),
    "estimator": ("control/estimator.py",), "control": ("control/*.py",),
    "scenario": ("scenario/*.py",),
    "MuJoCo model and loop, integration": ("simulation/*.py",),
    "sensors and actuators": ("simulation/sampled/*.py",),
    "checks": ("studies/check.py", "studies/validate.py", *(f"studies/verify/{name}.py" for name in
               ("any_plant", "checks", "claims", "convergence", "explanation"))),
    "margins": ("studies/margins.py", "studies/shared/loop_margins.py"),
    "statistics": ("studies/montecarlo.py", "studies/shared/robustness.py"),
}  # fmt: skip
"""What is changed: a file is of the first area that names it."""

DRAWN = ("simulation/drawing.py", "plants/differences.py", "plants/suspects.py")
"""What only draws, or only names what a check has found."""

BINARY = "Add_Sub Sub_Add Mul_Div Div_Mul Pow_Mul FloorDiv_Div Mod_FloorDiv"
COMPARISONS = (
    "Lt_LtE Lt_GtE LtE_Lt LtE_Gt Gt_GtE Gt_LtE GtE_Gt GtE_Lt Eq_NotEq NotEq_Eq Is_IsNot IsNot_Is"
)
OTHERS = """ReplaceUnaryOperator_Delete_USub ReplaceUnaryOperator_Delete_Not AddNot ReplaceAndWithOr
ReplaceOrWithAnd ReplaceTrueWithFalse ReplaceFalseWithTrue ReplaceBreakWithContinue
ReplaceContinueWithBreak ZeroIterationForLoop NumberReplacer"""
OPERATORS = [f"ReplaceBinaryOperator_{one}" for one in BINARY.split()]
OPERATORS += [f"ReplaceComparisonOperator_{one}" for one in COMPARISONS.split()] + OTHERS.split()

NOT_CHANGED = {"raise_stmt", "assert_stmt", "fstring", "decorator", "tfpdef"}

LATE = [
    f"tests/{one}.py"
    for one in """control/test_baselines studies/test_thresholds
simulation/test_gym_env studies/test_margins simulation/test_task studies/test_montecarlo
studies/test_robustness simulation/test_graphics""".split()
]
"""Tests that take longest; they run last."""

FOLDERS = """control films identification plants report scenario simulation studies
test_loading.py docs/test_content.py test_properties.py test_own_rig.py
test_right_answers.py""".split()
"""Tests of what is computed."""

QUICK = ("-m", "not slow")
LIKELY = 6  # test files that run first, at most
LIKELY_LIMIT = 300.0  # [s] for them
NO_TIME = "time limit"
KILLED, SURVIVED, SAME = "killed", "survived", "equivalent"


@dataclass(frozen=True, kw_only=True)
class Change:
    """What becomes of the `nth` line that reads so."""

    area: str
    file: str
    was: str
    now: str
    nth: int

    @property
    def key(self):
        return self.file, self.was, self.now, self.nth


@dataclass(frozen=True, kw_only=True)
class Mutant(Change):
    """What an operator makes of a source; at first only where."""

    operator: str
    occurrence: int
    line: int

    @property
    def name(self) -> str:
        return f"{self.file}: {self.was}  ->  {self.now}"

    def rank(self, seed: int) -> bytes:
        """Where a seed puts it: a sample is those that come first, whatever else is edited."""
        known_by = (seed, self.file, self.operator, self.was, self.nth)
        return hashlib.blake2b(repr(known_by).encode(), digest_size=16).digest()

    def mutated(self, text: str) -> str:
        from cosmic_ray.mutating import mutate_code

        changed = mutate_code(text, operators()[self.operator](), self.occurrence)
        if changed is None:
            raise ValueError(f"{self.name}: there is nothing to change")
        return changed

    def made(self):
        """Return it with what its line becomes, None if that means the same or is no Python."""
        before = (REPOSITORY / self.file).read_text(encoding="utf-8")
        after = self.mutated(before)
        try:
            if ast.dump(ast.parse(after)) == ast.dump(ast.parse(before)):
                return None
        except SyntaxError:
            return None
        return replace(self, now=" ".join(after.splitlines()[self.line].split()))

    def plant(self, root: Path) -> None:
        path = root / self.file
        path.write_text(self.mutated(path.read_text(encoding="utf-8")), encoding="utf-8")


@dataclass(frozen=True, kw_only=True)
class Found(Change):
    outcome: str
    by: str  # what noticed it, or why it is equivalent


def operators():
    from cosmic_ray.operators.number_replacer import NumberReplacer
    from cosmic_ray.operators.provider import OperatorProvider

    class InPlace(NumberReplacer):
        """Cosmic Ray's operator on numbers, without what it does to the spaces around them."""

        def mutate(self, node, index):
            changed = super().mutate(node, index)
            changed.value, changed.prefix = changed.value.strip(), node.prefix
            return changed

    provider = OperatorProvider()
    return {name: provider[name] for name in OPERATORS} | {"NumberReplacer": InPlace}


def places_in(file: str, area: str):
    from cosmic_ray.ast import ast_nodes, get_ast

    text = (REPOSITORY / file).read_text(encoding="utf-8")
    nodes, lines = list(ast_nodes(get_ast(text))), text.splitlines()
    for name, operator in operators().items():
        seen = Counter()
        starts = ((one, start) for one in nodes for start, _ in operator().mutation_positions(one))
        for occurrence, (node, (line, _)) in enumerate(starts):
            if not _left_out(node):
                was = lines[line - 1].strip()
                at = {"area": area, "file": file, "was": was, "now": "", "nth": seen[was]}
                yield Mutant(**at, operator=name, occurrence=occurrence, line=line - 1)
                seen[was] += 1


def _left_out(node) -> bool:
    if node.parent is not None and node.parent.type == "parameters":  # the bare star
        return True
    while (parent := node.parent) is not None:
        annotation = {"annassign": lambda x: x.children[1], "funcdef": lambda x: x.annotation}
        annotated = annotation.get(parent.type)
        if parent.type in NOT_CHANGED or (annotated and annotated(parent) is node):
            return True
        node = parent
    return False


def all_places() -> list[Mutant]:
    package, found = REPOSITORY / "afl_mujoco", []
    known = {package / name for name in DRAWN}
    for area, patterns in AREAS.items():
        files = sorted({path for pattern in patterns for path in package.glob(pattern)} - known)
        known.update(files)
        for path in files:
            found += places_in(str(path.relative_to(REPOSITORY)), area)
    return found


def draw(places, count: int, seed: int) -> list[Mutant]:
    ranked = sorted(places, key=lambda place: place.rank(seed))
    return list(islice(filter(None, (place.made() for place in ranked)), count))


def equivalents() -> dict[tuple[str, str, str], str]:
    listed = tomllib.loads(EQUIVALENT.read_text(encoding="utf-8")).get("mutant", [])
    return {(row["file"], row["was"], row["now"]): row["reason"] for row in listed}


class Tests:
    """Which tests come first: those that noticed other mutants of the file, its own, importers."""

    def __init__(self, before) -> None:
        self._noticed = defaultdict(Counter)
        for one in before:
            if one.outcome == KILLED:
                self.learn(one.file, one.by)

    @cached_property
    def files(self) -> list[str]:
        found = files_of([f"tests/{x}" for x in FOLDERS])
        found.remove("tests/studies/test_contract.py")  # of the repository, which a copy is not
        return sorted(found, key=lambda name: LATE.index(name) if name in LATE else -1)

    @cached_property
    def _texts(self) -> dict[str, str]:
        return {name: (REPOSITORY / name).read_text(encoding="utf-8") for name in self.files}

    def learn(self, file: str, by: str) -> None:
        if "::" in by:
            self._noticed[file][f"tests/{by.partition('::')[0]}"] += 1

    def likely(self, file: str) -> list[str]:
        module = file.removesuffix(".py").replace("/", ".")
        package, _, stem = module.rpartition(".")
        named = rf"from {re.escape(package)} import .*\b{stem}\b"
        imports = re.compile(rf"{re.escape(module)}\b|{named}")
        own = [name for name in self.files if Path(name).stem == f"test_{stem}"]
        texts = {name: text for name, text in self._texts.items() if name not in LATE}
        importers = [name for name, text in texts.items() if imports.search(text)]
        noticed = [name for name, _ in self._noticed[file].most_common() if name in self.files]
        beside = [name for name in texts if Path(name).parts[1:-1] == Path(file).parts[1:-1]]
        return list(dict.fromkeys([*noticed[:3], *own, *importers, *noticed, *beside]))[:LIKELY]

    def checks(self, copies, mutant: Mutant):
        def checks(root: Path):
            likely = self.likely(mutant.file)
            yield copies.tests(root, [*QUICK, *likely], LIKELY_LIMIT)
            yield copies.verdict(root)
            rest = [name for name in self.files if name not in likely]
            yield copies.tests(root, [*QUICK, *rest])

        def in_time(root: Path):
            try:
                for by in checks(root):
                    self.learn(mutant.file, by)
                    yield by
            except TimeLimitError:
                yield NO_TIME

        return in_time


def found_of(mutant: Mutant, outcome: str, by: str) -> Found:
    change = {name: getattr(mutant, name) for name in Change.__dataclass_fields__}
    return Found(**change, outcome=outcome, by=by)


def load(path: Path) -> dict[tuple, Found]:
    rows = json.loads(path.read_text(encoding="utf-8"))["mutants"] if path.is_file() else ()
    return {found.key: found for found in (Found(**row) for row in rows)}


def save(path: Path, found: list[Found], of: int, seed: int) -> None:
    areas = {area: [one for one in found if one.area == area] for area in AREAS}
    said = re.sub(r" ?--out[ =]\S+", "", " ".join(sys.argv[1:])).strip()
    command = f'make mutants ARGS="{said}"' if said else "make mutants"
    result = {
        **{"command": command, "versions": versions(), "seed": seed, "places": of},
        **summary(found), "areas": {area: summary(those) for area, those in areas.items() if those},
        "mutants": [asdict(one) for one in sorted(found, key=lambda one: one.key)],
    }  # fmt: skip
    write_text(path, json.dumps(result, indent=1, ensure_ascii=False) + "\n")


def summary(found: list[Found]) -> dict[str, object]:
    count = Counter(one.outcome for one in found)
    killed = [True] * count[KILLED] + [False] * count[SURVIVED]
    score, *interval = rate(killed) if killed else (None,)
    return {
        "sampled": len(found), "killed": count[KILLED],
        "by_time_limit": sum(one.by == NO_TIME for one in found), "survived": count[SURVIVED],
        "equivalent": count[SAME], "score": score, "interval": interval or None,
    }  # fmt: skip


def decided(sample, before, kept):
    """Return what is known without running: equivalents, and `kept` outcomes of an earlier run."""
    same, found = equivalents(), {}
    for one in sample:
        earlier = before.get(one.key)
        if reason := same.get(one.key[:3]):
            found[one.key] = found_of(one, SAME, reason)
        elif earlier and earlier.outcome in kept:
            found[one.key] = earlier
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description="Plant mutants and see how many are noticed.")
    parser.add_argument("--count", type=int, default=400, help="how many mutants")
    parser.add_argument("--seed", type=int, default=1, help="of the sample")
    parser.add_argument("--jobs", type=int, default=2, help="how many at a time")
    parser.add_argument("--only", nargs="+", metavar="PART", help="parts of their names")
    parser.add_argument("--resume", action="store_true", help="keep what --out has of the sample")
    parser.add_argument("--survivors", action="store_true", help="as --resume, survivors anew")
    parser.add_argument("--out", type=Path, default=RESULT, metavar="FILE", help="a JSON")
    parser.add_argument("--list", action="store_true", help="only print the sample")
    options = parser.parse_args()
    places = all_places()
    sample = draw(places, options.count, options.seed)
    if options.only:
        sample = [one for one in sample if any(part in one.name for part in options.only)]
    if not sample:
        raise ValueError("no mutant of the sample has such a name")
    if options.list:
        print("\n".join(one.name for one in sample), f"\n{len(sample)} at {len(places)} places")
        return 0
    before = load(options.out)
    kept = {KILLED} if options.survivors else {KILLED, SURVIVED} if options.resume else set()
    found = decided(sample, before, kept)

    def keep() -> None:
        if not options.only:
            save(options.out, list(found.values()), len(places), options.seed)

    left = [one for one in sample if one.key not in found]
    tests = Tests(before.values())
    asked = (max(1, options.jobs), [*QUICK, *tests.files], tests.checks)
    for mutant, by in faulty_copies.check_all(left, *asked) if left else ():
        found[mutant.key] = found_of(mutant, KILLED if by else SURVIVED, by)
        keep()
    keep()
    missed = [one for one in found.values() if one.outcome == SURVIVED]
    for one in missed:
        say(f"NOT NOTICED in {one.file}\n  - {one.was}\n  + {one.now}")
    say(json.dumps(summary(list(found.values()))))
    return 1 if missed else 0


if __name__ == "__main__":
    faulty_copies.run_command_line(main, "mutants")
