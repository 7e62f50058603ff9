"""The API page: docstrings of the public names, in the form in which curlfit
writes them.

A section such as Parameters has items `names : what they are`, with further lines
indented; single back quotes stand for code.
"""

from __future__ import annotations

import re
from typing import Any

_HEAD = re.compile(r"^-{3,}$")
_ITEM = re.compile(r"^(?P<names>[\w*]+(?:, ?[\w*]+)*) : (?P<text>.*)$")
_INLINE = re.compile(r"(?<=[.;] )(?P<names>[\w*]+(?:, [\w*]+)*) : ")


def sections(lines: list[str]) -> list[tuple[str, list[str]]]:
    """Titles and lines of a docstring; what comes first has no title."""
    found: list[tuple[str, list[str]]] = [("", [])]
    for line in lines:
        if _HEAD.match(line) and found[-1][1] and len(found[-1][1][-1]) == len(line):
            found.append((found[-1][1].pop(), []))
        else:
            found[-1][1].append(line)
    return found


def items(lines: list[str]) -> list[str]:
    """A section as definitions, or as it is where it has none."""
    paragraphs: list[list[str]] = []
    # names that take more than a line
    whole = re.sub(r"^([\w, ]+,)\n(?=\w)", r"\1 ", "\n".join(lines), flags=re.M)
    for line in whole.split("\n"):
        if _ITEM.match(line) or (line.strip() and not paragraphs):
            paragraphs.append([line])
        elif line.strip():
            paragraphs[-1].append(line.strip())
    found: list[str] = []
    for paragraph in paragraphs:
        # several items may share a line: "x : this. y : that."
        for part in _INLINE.sub(r"\n\g<names> : ", " ".join(paragraph)).split("\n"):
            match = _ITEM.match(part.strip())
            if match is None:
                found += [part, ""]
                continue
            names = ", ".join(f"``{name}``" for name in match["names"].split(", "))
            found += [names, f"    {match['text']}", ""]
    return found


def rewrite(
    app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]
) -> None:
    """A docstring as reStructuredText."""
    found: list[str] = []
    for title, body in sections(lines):
        if not title:
            found += body
        elif title == "Examples":
            found += ["", ".. rubric:: Examples", "", *body]
        else:
            found += ["", f".. rubric:: {title}", "", *items(body)]
    lines[:] = [*found, ""]


_CALLED = ("Stone", "InitialState")


def without_fields(
    app: Any,
    what: str,
    name: str,
    obj: Any,
    options: Any,
    signature: Any,
    returned: Any,
) -> Any:
    """No signature for records that are not made by hand: their attributes follow."""
    made = what != "class" or not signature or name.rpartition(".")[2] in _CALLED
    return None if made else ("", None)


def setup(app: Any) -> dict[str, Any]:
    """Called by Sphinx."""
    app.connect("autodoc-process-docstring", rewrite)
    app.connect("autodoc-process-signature", without_fields)
    return {"parallel_read_safe": True}
