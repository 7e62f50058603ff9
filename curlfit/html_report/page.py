"""A result as one HTML page: markup, style, program, data and figures in a
single file."""

from __future__ import annotations

import base64
import hashlib
import json
import platform
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from curlfit import sheet
from curlfit.errors import InputError
from curlfit.html_report.additions import Additions, additions_of
from curlfit.html_report.blocks import (
    Block,
    Commands,
    InteractiveBlock,
    NamedValues,
    blocks_of,
    list_of_findings,
    marked,
    sentence,
)
from curlfit.output.display import document_of, kind_of
from curlfit.output.document import Document
from curlfit.output.files import atomic_write, prepare_folder, require_replaceable
from curlfit.version import __version__

if TYPE_CHECKING:
    from curlfit.inference.sampling.chain import Chain

_MARK = '<meta name="generator" content="curlfit'
_SCRIPTS = ("moving.js", "replay.js", "direction.js", "rests.js")
_FRAMED = "framed.js"
_PACKAGES = ("jax", "numpy", "scipy", "matplotlib")
_LATER = {
    "throw": "On the sheet",
    "draws": "Where it may come to rest",
    "figures": "Figures",
}
"""Sections that follow those of the document, by id."""


@dataclass(frozen=True)
class PageSection:
    """Blocks under a heading, to which the contents of the page lead by its id."""

    id: str
    heading: str
    blocks: Sequence[Block]


def write_report(
    result: Any, path: str | PathLike[str], *, chain: Chain | None = None
) -> None:
    """Write a result as one HTML file that needs no network: numbers, warnings, figures
    and interactive parts.

    Parameters
    ----------
    result : a fit, of one throw or several, a comparison, a profile, a prediction
        or a design.
    path : of the file.
    chain : the posterior sample of a fit, for its figure.

    Raises
    ------
    InputError : the result is of another kind, or the file cannot be written, has a
        name that does not end in .html, or exists and is not such a page.

    Examples
    --------
    >>> curlfit.write_report(sampled, "report.html", chain=chain)
    """
    page = page_of(result, chain)
    file = Path(path)
    require_replaceable(file, "an HTML file", _MARK)
    if file.suffix not in (".html", ".htm"):
        raise InputError(f"{file}: expected a name that ends in .html")
    prepare_folder(file.parent)
    atomic_write(file, page)


def page_of(result: Any, chain: Chain | None = None) -> str:
    """The text of the page of a result. Raises `InputError` for other objects."""
    if not kind_of(result):
        raise InputError(
            f"a {type(result).__name__} has no report; expected a fit, a comparison, "
            "a profile, a prediction or a design"
        )
    document = document_of(result)
    sections = _sections(document, additions_of(result, chain))
    interactive = [
        block
        for section in sections
        for block in section.blocks
        if isinstance(block, InteractiveBlock)
    ]
    programs = (*_SCRIPTS, _FRAMED) if interactive else (_FRAMED,)
    return _filled(
        "page.html.j2", programs, interactive, document=document, sections=sections
    )


def _sections(document: Document, additions: Additions) -> list[PageSection]:
    """The sections of the page of a result, of which none is empty."""
    sections = []
    for section in document.sections:
        blocks = [*blocks_of(section), *additions.blocks.get(section.id, ())]
        sections.append(PageSection(section.id, section.heading, blocks))
    warnings = list_of_findings(document.warnings, "warning", document.names)
    notes = list_of_findings(document.notes, "note", document.names)
    heading = "Warnings and notes"
    if not notes:
        heading = "Warnings"
    elif not warnings:
        heading = "Notes"
    sections.append(PageSection("warnings", heading, [*warnings, *notes]))
    for id, later_heading in _LATER.items():
        sections.append(PageSection(id, later_heading, additions.blocks.get(id, ())))
    reproduction: list[Block] = [
        NamedValues("Settings", document.settings),
        NamedValues("Versions that wrote this page", _versions()),
    ]
    if document.command:
        reproduction.insert(0, Commands([document.command]))
    sections.append(PageSection("made", "How to reproduce this result", reproduction))
    return [section for section in sections if section.blocks]


def page_alone(title: str, block: InteractiveBlock, programs: Sequence[str]) -> str:
    """The text of a page of one interactive part, with the programs that move it."""
    return _filled("alone.html.j2", programs, [block], title=title, block=block)


def _filled(
    template: str,
    programs: Sequence[str],
    interactive: Iterable[InteractiveBlock],
    **parts: Any,
) -> str:
    """A template of a whole page with its parts, style, programs, and the data of what
    they move, by id."""
    script = "".join(map(source, programs))
    data = {block.id: block.to_json() for block in interactive}
    page = _templates().get_template(template)
    return page.render(
        **parts,
        style=Markup(source("report.css")),
        script=Markup(script),
        digest=_digest(script),
        json=Markup(_embedded(data)) if data else "",
        version=__version__,
    )


def _digest(script: str) -> str:
    """The hash by which the security policy of a page knows its own program."""
    return base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()


def _versions() -> dict[str, str]:
    """Versions by package, of those that are installed."""
    versions = {"curlfit": __version__, "Python": platform.python_version()}
    for name in _PACKAGES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            continue
    return versions


def _embedded(data: dict[str, Any]) -> str:
    """Data as JSON that cannot close the element around it, whatever names it contains:
    signs of HTML and ends of lines are escaped."""
    text = json.dumps(data, allow_nan=False, separators=(",", ":"))
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return text


@lru_cache(1)
def _templates() -> Environment:
    """The templates of this folder."""
    environment = Environment(
        loader=PackageLoader("curlfit.html_report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals["sheet"] = sheet
    environment.filters |= {"marked": marked, "sentence": sentence}
    return environment


def rendered(block: Block) -> Markup:
    """One part of a section as HTML."""
    return Markup(
        _templates().get_template(f"{block.template}.html.j2").render(block=block)
    )


def source(name: str) -> str:
    """The text of a template, a style sheet or a program of the page."""
    environment = _templates()
    assert environment.loader is not None
    return environment.loader.get_source(environment, name)[0]
