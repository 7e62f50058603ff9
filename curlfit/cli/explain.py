"""`curlfit explain`: what findings mean."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from curlfit.findings.words import Message


def explain(*codes: str) -> None:
    """Explain warnings and notes: what each means, and what to do about it.

    A warning of a result stands with its code in the record (fit.json, key `findings`)
    and in the report. Without codes, all are listed.

    Example: `curlfit explain correlated`

    Parameters
    ----------
    codes
        Codes of findings, such as `at-bound`.
    """
    from curlfit.findings.words import message_of, messages
    from curlfit.output.console import terminal

    width = terminal().width
    if codes:
        print("\n\n".join([_text(code, message_of(code), width) for code in codes]))
        return
    longest = max(map(len, messages()))
    for code, message in messages().items():
        head = f"{code:<{longest}}  "
        print(textwrap.fill(f"{head}{message.title}", width, **_under(head)))


def _text(code: str, message: Message, width: int) -> str:
    """A code with its title, and beneath it what it means."""
    lines = [textwrap.fill(f"{code}: {message.title}", width)]
    for paragraph in message.means.split("\n\n"):
        text = " ".join(paragraph.split())
        lines.append(textwrap.fill(f"  {text}", width, **_under("  ")))
    return "\n".join(lines)


def _under(head: str) -> dict[str, Any]:
    """Options of `textwrap.fill` for lines that continue beside a head."""
    return {
        "subsequent_indent": " " * len(head),
        "break_long_words": False,
        "break_on_hyphens": False,
    }
