"""The registry of results: where each kind of result enters what is said of it, its
figures, and how it is read.

`curlfit.results` registers all kinds when curlfit is imported. What shows results asks
here, so that it need not know the rooms above it.
"""

from __future__ import annotations

TYPE_CHECKING = False  # of `typing`, whose import takes as long as that of curlfit
if TYPE_CHECKING:
    from os import PathLike
    from typing import Any

    from matplotlib.figure import Figure

    from curlfit.output.document import Document


class Kind:
    """A kind of results; a subclass states its names and what is made of a result.

    Attributes
    ----------
    name : of its JSON file, and of the class attribute `kind` of its records.
    noun : of its public functions, such as `load_fit`, `print_fit` and `fit_figure`.
    figure_names : of all figures that it may have; its own name where it has one.
    """

    name: str
    noun: str
    figure_names: tuple[str, ...] = ()

    def __init__(self) -> None:
        self.figure_names = self.figure_names or (self.name,)

    def document(self, result: Any) -> Document:
        """What a result says."""
        raise NotImplementedError

    def figures(self, result: Any) -> dict[str, Figure]:
        """Its figures, by name."""
        raise NotImplementedError

    def load(self, file: str | PathLike[str]) -> Any:
        """Read a saved result, or the one in a folder.

        Raises
        ------
        DataError : it is missing, damaged or of another version.
        """
        raise NotImplementedError


class Part:
    """What is shown like a result, but is not saved by itself.

    Attributes
    ----------
    name : of the class attribute `kind` of such objects.
    """

    name: str

    def document(self, part: Any) -> Document:
        """What it says."""
        raise NotImplementedError


KINDS: dict[str, Kind] = {}
"""The kinds of saved results, by the names of their JSON files."""
PARTS: dict[str, Part] = {}
"""What else is shown, by name."""


def register(*kinds: Kind | Part) -> None:
    """Enter kinds of results."""
    for kind in kinds:
        if isinstance(kind, Kind):
            KINDS[kind.name] = kind
        else:
            PARTS[kind.name] = kind
