"""A result as one HTML page: markup, style, program, data and figures in a single file."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Callable
from functools import lru_cache
from importlib import import_module
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from curlfit import sheet
from curlfit.errors import InputError
from curlfit.html_report.document import Page, marked
from curlfit.output.files import atomic_write, prepare_folder, require_replaceable
from curlfit.records import plain
from curlfit.version import __version__

if TYPE_CHECKING:
    from curlfit.inference.mcmc.chain import Chain

_MARK = '<meta name="generator" content="curlfit'
_SCRIPTS = ("moving.js", "replay.js", "direction.js", "rests.js")
_KINDS = {
    "FitResult": "fit",
    "JointResult": "joint",
    "Comparison": "comparison",
    "Profile": "profile",
    "PairProfile": "profile",
    "Prediction": "prediction",
    "Design": "design",
}
"""Module `of_...` of this package that makes the page of a record, by the record's class name."""


def write_report(result: Any, path: str | PathLike[str], *, chain: Chain | None = None) -> None:
    """Write a result as one HTML file that needs no network: numbers, warnings, figures and
    interactive parts.

    Parameters
    ----------
    result : a fit, of one throw or several, a comparison, a profile, a prediction or a design.
    path : of the file.
    chain : the posterior sample of a fit, for its figure.

    Raises
    ------
    InputError : the result is of another kind, or the file cannot be written, has a name that does
        not end in .html, or exists and is not such a page.

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
    text = render(page)
    with atomic_write(file) as temporary:
        temporary.write_text(text, encoding="utf-8")


def page_of(result: Any, chain: Chain | None = None) -> Page:
    """A result as a page, not yet rendered. Raises `InputError` for other objects."""
    name = _KINDS.get(type(result).__name__)
    if name is None:
        raise InputError(
            f"a {type(result).__name__} has no report; expected a fit, a comparison, a profile, a "
            "prediction or a design"
        )
    make: Callable[..., Page] = import_module(f"curlfit.html_report.of_{name}").page_of
    return make(result, chain) if name == "fit" else make(result)


def render(page: Page) -> str:
    """The text of a page."""
    script = "".join(_source(name) for name in _SCRIPTS) if page.data else ""
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    return _templates().get_template("page.html.j2").render(
        page=page,
        style=Markup(_source("report.css")),
        script=Markup(script),
        digest=digest,
        data=Markup(_embedded(page.data)),
        version=__version__,
    )  # fmt: skip


def _embedded(data: dict[str, Any]) -> str:
    """JSON that cannot close the element around it, whatever names it contains."""
    text = json.dumps(plain(data), allow_nan=False, separators=(",", ":"))
    for sign in "<>&\u2028\u2029":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return text


@lru_cache(1)
def _templates() -> Environment:
    found = Environment(
        loader=PackageLoader("curlfit.html_report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    found.globals["sheet"] = sheet
    found.filters["marked"] = marked
    return found


def _source(name: str) -> str:
    environment = _templates()
    assert environment.loader is not None
    return environment.loader.get_source(environment, name)[0]
