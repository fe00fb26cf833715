"""The paper's claims: its number, the one found here, the verdict, and random schedules."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from afl_mujoco.report.numbers import fixed, interval, listed, percent, sentence, short
from afl_mujoco.report.old import (
    Bar,
    Block,
    Cell,
    Column,
    Finding,
    Section,
    Status,
    Table,
    Tag,
    Tally,
    Text,
)
from afl_mujoco.studies.verification.claims.claim import (
    EVERY,
    FITTED,
    IN_PART,
    NONE,
    NOT_REPRODUCED,
    RANDOM,
    REPRODUCED,
    UNDETERMINED,
    Claim,
    Comparison,
    kind,
)
from afl_mujoco.studies.verification.figures.claims import claims_figure
from afl_mujoco.studies.verification.result import Result
from afl_mujoco.studies.verification.sections.decisions import claim_decisions, links

STATUSES: Mapping[str, Status] = {
    REPRODUCED: "good",
    EVERY: "good",
    IN_PART: "neutral",
    RANDOM: "neutral",
    FITTED: "open",
    NOT_REPRODUCED: "bad",
    NONE: "bad",
    UNDETERMINED: "open",
}
"""Status with which a verdict on a claim is shown."""

WORDS = {
    REPRODUCED: "hold here",
    EVERY: "hold under every reading tried",
    IN_PART: "hold in part",
    RANDOM: "hold under a share of random readings of what the paper leaves open",
    FITTED: "hold under readings fitted to them",
    NOT_REPRODUCED: "do not hold",
    NONE: "hold under no reading tried",
    UNDETERMINED: "cannot be determined",
}
"""The verdicts for use in a sentence."""

TABLE_3 = ("C3", "C4", "C5", "C6")
"""Claims on the improvements of the paper's Table 3."""

QUANTILES = ("5%", "25%", "median", "75%", "95%")
"""Percentiles of the improvement over random schedules that are shown."""


def claims_section(result: Result) -> Section:
    """Return the claims and the random schedules."""
    blocks: list[Block] = []
    if result.claims:
        published = result.random_schedules.get("published")
        blocks += [
            Finding("The paper's claims", _summary(result.claims)),
            Tally(
                f"The paper's {len(result.claims)} claims",
                [Tag(c.id, STATUSES[kind(c.verdict)], c.id, c.verdict) for c in result.claims],
            ),
            Text(
                "What the paper says, its number, the number found here with the controller as "
                "published in MuJoCo, and the verdict. A claim that is not reproduced is not a "
                "failed check: the checks ask whether the two codes agree, this table asks "
                "whether the paper is right. C9 to C12, and what readings say of C3 to C6, come "
                "with the package; `make claims` in its repository makes them anew."
            ),
            claims_figure(result.claims, published.interval if published else None),
            _table(result),
        ]
    else:
        said = (
            "Not judged in this run: the claims need all nine scenarios of the paper with the "
            "controllers `fixed` and `adaptive`, as `make validate` runs them."
        )
        blocks.append(Text(said))
    if result.random_schedules:
        blocks.append(_random(result.random_schedules))
    return Section("The paper's claims", "claims", blocks)


def _table(result: Result) -> Table:
    """Return the ledger of claims."""
    return Table(
        caption="Claims ledger",
        columns=(
            Column("Claim"),
            Column("What the paper says, and why the verdict"),
            Column("Paper", number=True),
            Column("Here", number=True),
            Column("Verdict"),
        ),
        rows=[
            (
                Cell(claim.id, anchor=claim.id),
                Cell(sentence(claim.claim), note=_note(result, claim)),
                short(claim.paper),
                short(claim.here, 3),
                Cell(claim.verdict, status=STATUSES[kind(claim.verdict)]),
            )
            for claim in result.claims
        ],
        stacked=True,
    )


def _note(result: Result, claim: Claim) -> str:
    """Say why a claim is judged as it is, what is compared, and which decisions it rests on."""
    ids = claim_decisions(result, claim)
    said = f"{sentence(claim.why)}. Compared: {claim.figure}."
    return f"{said} {links(ids)}" if ids else said


def _random(comparisons: Mapping[str, Comparison]) -> Section:
    """Return how adaptive gains do on schedules drawn at random."""
    text = Text(
        "Share of random schedules on which adaptive gains have a lower objective than fixed "
        "ones. A coin toss would give one half, where the mark is."
    )
    table = Table(
        caption="Adaptive against fixed gains; improvement of the objective by percentile, in %",
        columns=(
            Column("Gains"),
            Column("Schedules", number=True),
            Column("Adaptive wins", number=True),
            Column("95 % interval"),
            *(Column(name, number=True) for name in QUANTILES),
        ),
        rows=[
            (
                name,
                str(row.schedules),
                percent(row.share, 3),
                Cell(f"{interval(row.interval)} %", bar=Bar(*row.interval, 0.5, row.share)),
                *(fixed(row.quantiles.get(quantile), 1) for quantile in QUANTILES),
            )
            for name, row in comparisons.items()
        ],
    )
    found = Finding("Other schedules", _schedules(comparisons))
    return Section("Random schedules", "random", (found, text, table))


def _summary(claims: Sequence[Claim]) -> str:
    """Say how many of the paper's claims hold."""
    told = []
    for verdict, words in WORDS.items():
        ids = [claim.id for claim in claims if kind(claim.verdict) == verdict]
        if len(ids) == 1:
            words = words.replace("do not", "does not").replace("hold ", "holds ", 1)
        if ids:
            told.append(f"{len(ids)} {words} ({', '.join(ids)})")
    pairs = [
        (c.paper, c.here)
        for c in claims
        if c.id in TABLE_3 and c.paper is not None and c.here is not None
    ]
    more = ""
    if pairs:
        paper, here = (sorted(pair[k] for pair in pairs) for k in (0, 1))
        more = (
            f"; the improvement by adaptive gains, {_range(paper)} in the paper's Table 3, is "
            f"{_range(here)} on the schedules assumed here (D3) and scales of D4"
        )
    return f"Of {len(claims)} claims {listed(told, 'and')}{more}."


def _schedules(comparisons: Mapping[str, Comparison]) -> str:
    """Say how adaptive gains do on random schedules."""
    paper = comparisons["published"]
    low, high = paper.interval
    if low > 0.5:
        meaning = "more often than not"
    elif high < 0.5:
        meaning = "they lose more often than they win"
    else:
        meaning = "no better than a coin toss"
    text = (
        f"On {short(paper.schedules)} random schedules the published adaptive gains beat the "
        f"fixed ones on {percent(paper.share, 3)} "
        f"(95 % interval {interval(paper.interval)} %): {meaning}"
    )
    if "retuned" in comparisons:
        ours = comparisons["retuned"]
        median = ours.quantiles.get("median")
        by = "" if median is None else f", by {fixed(median, 1)} % in the median"
        won = f"{percent(ours.share, 3)} ({interval(ours.interval)} %)"
        text += f"; retuned gains win on {won}{by}"
    return f"{text}."


def _range(percents: Sequence[float]) -> str:
    """Return the range of sorted percentages in words."""
    low, high = (fixed(percents[end], 0) for end in (0, -1))
    return f"{low} %" if low == high else f"{low} to {high} %"
