"""Names of the controllers, for code that must not import them: ``--help``, defaults, texts."""

PAPER = ("fixed", "adaptive")
"""The paper's two controllers, the default where results are for the paper."""

AFL = (
    *PAPER,
    *(f"{name}-retuned" for name in PAPER),
    *(f"{name}-nominal" for name in PAPER),
)
"""Feedback linearisation: the paper's gains; gains found here; nominal M and l assumed."""

BASELINES = ("lqr", "pole-placement", "partial-linearization")
"""State feedback controllers to compare it with."""

NAMES = (*AFL, *BASELINES)
"""Every controller of the catalogue, in its order."""

INFORMED = tuple(name for name in NAMES if not name.endswith("-nominal"))
"""Controllers that know the true M(t) and l(t)."""

ESTIMATED = "-estimated"
"""Ending of the name of a controller that uses the estimator: ``adaptive-estimated``. Such
controllers are not in the catalogue: only sampled mode supports them."""

SUBJECT, REFERENCE = "adaptive", "lqr"
"""The controller that a single run shows and findings are about, and the one it is compared
with."""

KNOWN = (
    f"{', '.join(NAMES)}; any but -nominal followed by {ESTIMATED} (sampled mode); or your own, "
    "as module:attribute."
)
"""Every way to name a controller."""
