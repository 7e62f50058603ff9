"""`curlfit explain`: what findings mean."""

from __future__ import annotations

from typing import TYPE_CHECKING

from curlfit.wording import hanging, listed

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
    titles = {code: message.title for code, message in messages().items()}
    print("\n".join(listed(titles, width)))


def _text(code: str, message: Message, width: int) -> str:
    """A code with its title, and beneath it what it means."""
    lines = hanging("", f"{code}: {message.title}", width)
    for paragraph in message.means.split("\n\n"):
        lines += hanging("  ", " ".join(paragraph.split()), width)
    return "\n".join(lines)
