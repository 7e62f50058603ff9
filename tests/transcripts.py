"""Commands of a page are typed as they stand, and print the lines that
the page shows."""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from conftest import command

ROOT = Path(__file__).parents[1]
NUMBER = r"-?\d+\.\d+"
_FLAT = r"(\w+)(?:\s+-)+\s+not identifiable\s+([\d.]+) \.\. ([\d.]+)"


def typed(line: str, folder: Path) -> str:
    """What a `curlfit` line prints as a user types it."""
    program, *words = shlex.split(line)
    assert program == "curlfit"
    run = command(*words, cwd=folder)
    assert (run.returncode, run.stderr) == (0, ""), line
    return run.stdout


def blocks(page: str) -> list[tuple[list[str], str]]:
    """The commands of each block of a page, and the block of output that
    follows it, if any."""
    matches = re.findall(r"```bash\n(.*?)```(?:\n\n```text\n(.*?)```)?", page, re.S)
    return [
        ([line for line in part.splitlines() if line.strip()], text)
        for part, text in matches
    ]


def without_gaps(text: str) -> list[str]:
    """The lines of a block of output without those that stand for others."""
    return [line for line in text.splitlines() if line.strip() and line != "..."]


def alike(line: str, text: str) -> bool:
    """Whether the text has the line, but for five units of the last digits of numbers,
    or 5 %: quantiles of samples have an error, and hang on the processor's rounding."""
    pattern = f"({NUMBER})".join(map(re.escape, re.split(NUMBER, line)))
    for match in re.finditer(pattern, text):
        pairs = zip(re.findall(NUMBER, line), match.groups(), strict=True)
        if all(
            abs(float(shown) - float(printed))
            <= max(
                5.5 * 10.0 ** -len(shown.partition(".")[2]), 0.05 * abs(float(shown))
            )
            for shown, printed in pairs
        ):
            return True
    return False


def require_shown(lines: Sequence[str], printed: str) -> None:
    """Assert that what was printed has the lines that a page shows."""

    def words(text: str) -> str:
        # how many steps a fit takes may depend on the machine
        text = re.sub(r"\(\d+ steps\)", "(some steps)", " ".join(text.split()))
        return re.sub(_FLAT, r"\1 not identifiable", text)

    printed_words = words(printed)
    for line in lines:
        assert words(line) in printed_words or alike(words(line), printed_words), line
    # So do the quantiles of a flat posterior, which is wide, in their last digit.
    ranges = {groups[0]: groups[1:] for groups in re.findall(_FLAT, printed)}
    for name, *limits in re.findall(_FLAT, "\n".join(lines)):
        np.testing.assert_allclose(
            np.array(ranges[name], float), np.array(limits, float), atol=5e-4
        )
