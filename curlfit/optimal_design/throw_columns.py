"""Columns of tables of planned throws, each once: reports and pandas pick from them. A
row is a candidate of a design, or a throw that may decide between laws."""

from __future__ import annotations

import math
from typing import Any

from curlfit.output.table import Column

ThrowColumn = Column[Any]
V0 = ThrowColumn("v0\n", format="g", unit="m/s", key="v0", right=True)
OMEGA0 = ThrowColumn("omega0\n", format="g", unit="rad/s", key="omega0", right=True)
RATE = ThrowColumn("rate")
ROWS = ThrowColumn("rows", right=True)
LAST = ThrowColumn("last")
REST = ThrowColumn("at rest\n", format=".1f", unit="s", key="rest", right=True)
DISTANCE = ThrowColumn("after\n", format=".1f", unit="m", key="distance", right=True)


def stderr_column(quantity: str) -> ThrowColumn:
    """The column of the standard error of a quantity from each throw alone, NaN where
    the throw does not determine it."""

    def stderr(throw: Any) -> float:
        error: float | None = throw.stderr[quantity]
        return math.nan if error is None else error

    return ThrowColumn(
        f"error of\n{quantity}",
        stderr,
        error_in_words,
        key=f"{quantity} stderr",
        right=True,
    )


def error_in_words(stderr: float | None) -> str:
    """A standard error; a dash for none or NaN."""
    return "-" if stderr is None or math.isnan(stderr) else f"{stderr:.2g}"


def log_odds_column(index: int, truth: str, rival: str) -> ThrowColumn:
    """The column of the log odds of a pair of laws from each throw alone."""
    return ThrowColumn(f"{truth} over {rival}", lambda throw: throw.log_odds[index])
