"""Names of the controllers, for what must not import them: ``--help``, defaults, words."""

PAPER = ("fixed", "adaptive")
"""The paper's two; the default where results are for the paper."""

AFL = (
    *PAPER,
    *(f"{name}-retuned" for name in PAPER),
    *(f"{name}-nominal" for name in PAPER),
)
"""Feedback linearisation: the paper's gains, those found here, and M and l assumed nominal."""

BASELINES = ("lqr", "pole-placement", "partial-linearization")
"""State feedbacks to compare it with."""

NAMES = (*AFL, *BASELINES)
"""Every controller of the catalogue, in its order."""

INFORMED = tuple(name for name in NAMES if not name.endswith("-nominal"))
"""Those that know the true M(t) and l(t)."""

ESTIMATED = "-estimated"
"""Ending of the name of a controller that uses the estimator: ``adaptive-estimated``. Such
controllers are not in the catalogue: only sampled mode supports them."""

SUBJECT, REFERENCE = "adaptive", "lqr"
"""The controller that a single run shows and findings are about, and the one it is compared
with."""

KNOWN = (
    f"{', '.join(NAMES)}; any but -nominal with {ESTIMATED} after it (sampled); or your own, "
    "module:attribute (examples/README.md)."
)
"""What a controller can be asked for by."""
