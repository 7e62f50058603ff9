"""Tables of README.md beside this file, each between two marks with its name."""

from __future__ import annotations

from pathlib import Path

from scipy.stats import binomtest

HERE = Path(__file__).parent
DOUBTFUL = 0.01
LEVELS = {"68 %": (0.68, 0.99446), "95 %": (0.95, 1.95996)}
"""Share of the cases that an interval should hold, and its half width in standard errors."""


def put(name: str, text: str) -> None:
    """Replace a table."""
    file = HERE / "README.md"
    mark = f"<!-- {name} -->\n"
    before, _, after = file.read_text().split(mark)
    file.write_text(mark.join([before, text, after]))


def share(inside: int, of: int, nominal: float) -> str:
    """A count as a cell, marked where chance does not explain it."""
    if not of:
        return ""
    off = binomtest(inside, of, nominal).pvalue < DOUBTFUL
    return f"{100 * inside / of:.1f} %{' (!)' if off else ''}"
