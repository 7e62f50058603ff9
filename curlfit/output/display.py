"""How a result is shown: a few lines of text, and tables in a notebook."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

from curlfit.output import html
from curlfit.output.document import Document
from curlfit.output.kinds import KINDS, PARTS

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def kind_of(result: object) -> str:
    """The kind of a result that can be saved; empty for other objects."""
    name = getattr(type(result), "kind", "")
    return name if name in KINDS else ""


def document_of(result: object) -> Document:
    """What a result says."""
    return KINDS[kind_of(result)].document(result)


def figures_of(result: object) -> dict[str, Figure]:
    """The figures of a result that can be saved, by name."""
    return KINDS[kind_of(result)].figures(result)


class Displayed:
    """Base of results, shown as a few lines by `repr` and as tables in a notebook."""

    kind: ClassVar[str] = ""
    """name in the registry of results"""

    def _document(self) -> Document:
        kind: Any = PARTS.get(self.kind) or KINDS[self.kind]
        document: Document = kind.document(self)
        return document

    def __repr__(self) -> str:
        """A few lines."""
        kind = kind_of(self)
        return self._document().as_text(
            type(self).__name__, f"curlfit.print_{KINDS[kind].noun}" if kind else ""
        )

    def _repr_html_(self) -> str:
        """Tables, for notebooks."""
        return html.brief(self._document(), type(self).__name__)
