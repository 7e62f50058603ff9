"""Kinds of results, and how each is shown: a few lines of text, and tables in a notebook."""

from __future__ import annotations

from importlib import import_module
from typing import NamedTuple

from curlfit.output import html
from curlfit.output.document import Document


class Kind(NamedTuple):
    """A kind of saved results.

    Attributes
    ----------
    records : names of its classes.
    report : module of its function `document`.
    load, print, draw : public names of what loads, prints and draws it.
    """

    records: tuple[str, ...]
    report: str
    load: str
    print: str
    draw: str


KINDS = {
    "fit": Kind(("FitResult",), "inference.report", "load_fit", "print_fit", "fit_figure"),
    "compare": Kind(
        ("Comparison",), "comparison.report", "load_comparison", "print_comparison",
        "comparison_figure",
    ),
    "joint": Kind(
        ("JointResult",), "inference.joint.report", "load_joint", "print_joint", "joint_figure"
    ),
    "predict": Kind(
        ("Prediction",), "prediction.report", "load_prediction", "print_prediction",
        "prediction_figure",
    ),
    "profile": Kind(
        ("Profile", "PairProfile"), "profile_likelihood.report", "load_profile", "print_profile",
        "profile_figure",
    ),
    "design": Kind(
        ("Design",), "optimal_design.report", "load_design", "print_design", "design_figures"
    ),
}  # fmt: skip
"""By the names of their JSON files."""


def kind_of_record(result: object) -> str:
    """The kind of a result; empty for other objects."""
    return next((kind for kind in KINDS if type(result).__name__ in KINDS[kind].records), "")


def document_of(result: object) -> Document:
    """What a saved result says."""
    module = import_module(f"curlfit.{KINDS[kind_of_record(result)].report}")
    found: Document = module.document(result)
    return found


class Displayed:
    """Base of results, shown as a few lines by `repr` and as tables in a notebook."""

    def _document(self) -> Document:
        return document_of(self)

    def __repr__(self) -> str:
        """A few lines."""
        kind = kind_of_record(self)
        return self._document().as_text(
            type(self).__name__, f"curlfit.{KINDS[kind].print}" if kind else ""
        )

    def _repr_html_(self) -> str:
        """Tables, for notebooks."""
        return html.brief(self._document(), type(self).__name__)
