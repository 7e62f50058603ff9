"""A result as one HTML page: markup, style, program, data and figures in a
single file."""

from __future__ import annotations

import base64
import hashlib
import json
import platform
from collections.abc import Sequence
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from curlfit import sheet
from curlfit.errors import InputError
from curlfit.html_report.additions import additions_of
from curlfit.html_report.blocks import (
    Block,
    blocks_of,
    marked,
    of_findings,
    rows,
    sentence,
)
from curlfit.output.display import document_of, kind_of
from curlfit.output.files import atomic_write, prepare_folder, require_replaceable
from curlfit.records import plain
from curlfit.version import __version__

if TYPE_CHECKING:
    from curlfit.inference.mcmc.chain import Chain

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
    added = additions_of(result, chain)
    sections: dict[tuple[str, str], Sequence[Block]] = {}
    for section in document.sections:
        blocks = [*blocks_of(section), *added.blocks.get(section.id, ())]
        sections[section.id, section.heading] = blocks
    warnings = of_findings(document.warnings, "warning", document.names)
    notes = of_findings(document.notes, "note", document.names)
    heading = "Warnings and notes"
    if not warnings or not notes:
        heading = "Warnings" if warnings else "Notes"
    sections["warnings", heading] = [*warnings, *notes]
    for id, later in _LATER.items():
        sections[id, later] = added.blocks.get(id, [])
    commands = {"lines": [document.command] if document.command else []}
    sections["made", "How to reproduce this result"] = [
        Block("commands", commands),
        rows("Settings", document.settings),
        rows("Versions that wrote this page", _versions()),
    ]
    programs = (*_SCRIPTS, _FRAMED) if added.data else (_FRAMED,)
    return _filled(
        "page.html.j2", programs, added.data, document=document, sections=sections
    )


def page_alone(
    title: str, block: Block, data: dict[str, Any], programs: Sequence[str]
) -> str:
    """The text of a page of one interactive part, with its data by id and the programs
    that move it."""
    return _filled("alone.html.j2", programs, data, title=title, block=block)


def _filled(
    template: str, programs: Sequence[str], data: dict[str, Any], **parts: Any
) -> str:
    """A template of a whole page with its parts, style, programs and data, if any."""
    script = "".join(map(source, programs))
    page = _templates().get_template(template)
    return page.render(
        **parts,
        style=Markup(source("report.css")),
        script=Markup(script),
        digest=_digest(script),
        data=Markup(_embedded(data)) if data else "",
        version=__version__,
    )


def _digest(script: str) -> str:
    """By which the policy of a page knows its own program."""
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
    """JSON that cannot close the element around it, whatever names it contains."""
    text = json.dumps(plain(data), allow_nan=False, separators=(",", ":"))
    for sign in "<>&\u2028\u2029":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
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
