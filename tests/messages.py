"""What a message must say, for `match`."""

import re
from types import EllipsisType


def line(*parts: str | EllipsisType) -> str:
    """Return the pattern of one whole line; `...` stands for whatever lies between two parts."""
    return r"\A" + "".join(".*" if x is ... else re.escape(x) for x in parts) + r"\Z"
