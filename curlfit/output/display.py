"""Kinds of results, and how each is shown: a few lines of text, and tables
in a notebook."""

from __future__ import annotations

from importlib import import_module
from typing import Any, NamedTuple

from curlfit.output import html
from curlfit.output.document import Document


class Kind(NamedTuple):
    """A kind of saved results.

    Attributes
    ----------
    report : module of its function `document`.
    noun : of the public names of what loads, prints and draws it, such as `load_fit`,
        `print_fit` and `fit_figure`.
    figures : names of all its figures, where it has several.
    with_corner : whether it holds its draws, for one more.
    """

    report: str
    noun: str
    figures: tuple[str, ...] = ()
    with_corner: bool = False


KINDS = {
    "fit": Kind("reports.fit", "fit"),
    "compare": Kind("comparison.report", "comparison"),
    "joint": Kind("reports.joint", "joint", with_corner=True),
    "predict": Kind("prediction.report", "prediction"),
    "friction": Kind("friction_tables.report", "friction"),
    "profile": Kind("profile_likelihood.report", "profile"),
    "design": Kind(
        "optimal_design.report",
        "design",
        ("design-map", "design-errors"),
    ),
    "discrimination": Kind("optimal_design.discrimination", "discrimination"),
}
"""By the names of their JSON files."""


def kind_of(result: object) -> str:
    """The kind of a result; empty for other objects."""
    kind = getattr(type(result), "kind", "")
    return kind if kind in KINDS else ""


def document_of(result: object) -> Document:
    """What a saved result says."""
    module = import_module(f"curlfit.{KINDS[kind_of(result)].report}")
    document: Document = module.document(result)
    return document


def figures_of(result: object) -> dict[str, Any]:
    """The figures of a saved result, by name."""
    name = kind_of(result)
    kind = KINDS[name]
    curlfit = import_module("curlfit")
    figures: dict[str, Any]
    if kind.figures:
        figures = getattr(curlfit, f"{kind.noun}_figures")(result)
    else:
        figures = {name: getattr(curlfit, f"{kind.noun}_figure")(result)}
    chain = getattr(result, "chain", None)
    if kind.with_corner and chain is not None:
        figures |= corner_of(result, chain)
    return figures


def corner_of(result: object, chain: object) -> dict[str, Any]:
    """The corner plot of a fit and its chain, by name."""
    return {"corner": import_module("curlfit").corner_figure(result, chain)}


class Displayed:
    """Base of results, shown as a few lines by `repr` and as tables in a notebook."""

    def _document(self) -> Document:
        return document_of(self)

    def __repr__(self) -> str:
        """A few lines."""
        kind = kind_of(self)
        return self._document().as_text(
            type(self).__name__, f"curlfit.print_{KINDS[kind].noun}" if kind else ""
        )

    def _repr_html_(self) -> str:
        """Tables, for notebooks."""
        return html.brief(self._document(), type(self).__name__)
