"""The page on findings: its sections, from the words in curlfit/findings."""

from __future__ import annotations

from typing import Any

from curlfit.findings.words import messages

_PAGE = "book/findings"


def with_sections(app: Any, page: str, source: list[str]) -> None:
    """Append a section for each code to the source of the page."""
    if page != _PAGE:
        return
    for code, message in messages().items():
        source[0] += f"\n## {code}\n\n*{message.title}*\n\n{message.means.strip()}\n"


def setup(app: Any) -> dict[str, Any]:
    """Called by Sphinx."""
    app.connect("source-read", with_sections)
    return {"parallel_read_safe": True}
