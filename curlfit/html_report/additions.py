"""What the page of each kind of result has beside its document: figures and
interactive parts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from curlfit.errors import CurlfitError
from curlfit.html_report.blocks import Block, paragraph, rows
from curlfit.html_report.drawings import inline_svg
from curlfit.losses import LOSSES
from curlfit.output.display import figures_of
from curlfit.reports.corner import corner_of
from curlfit.wording import join_words

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from curlfit.inference.fit.result import FitResult
    from curlfit.inference.joint.result import JointResult
    from curlfit.inference.mcmc.chain import Chain
    from curlfit.prediction.result import Prediction

_MOVING = 6  # animated throws in a page
_OLD = (
    "This record was written without draws of the posterior; "
    "`curlfit predict` adds them."
)


@dataclass
class Additions:
    """Blocks by section: of a section of the document, at its end, or of one
    that follows.

    `data` are of the interactive parts, by id.
    """

    blocks: dict[str, list[Block]] = field(default_factory=dict)
    data: dict[str, Any] = field(default_factory=dict)

    def add(self, section: str, *blocks: Block) -> None:
        """Add to a section."""
        self.blocks.setdefault(section, []).extend(blocks)

    def draw(self, figure: Figure, name: str, caption: str) -> None:
        """Add a figure."""
        svg = inline_svg(figure, f"{name}-", caption)
        self.add("figures", Block("drawing", {"svg": svg, "caption": caption}))

    def move(self, section: str, part: tuple[Block, dict[str, Any]] | None) -> None:
        """Add an interactive part, if there is one, with its data."""
        if part is not None:
            block, data = part
            self.add(section, block)
            self.data[block.shows["id"]] = data

    def directions(
        self, fits: Sequence[FitResult], directions: Sequence[dict[str, float]]
    ) -> None:
        """Add the null directions of fits, in parameters that they have in common."""
        if not directions or not all(fit.converged for fit in fits):
            return
        try:
            fits[0].law_class  # noqa: B018  (a user's law is read from its file)
        except CurlfitError as error:
            self.add(
                "determined",
                paragraph(f"The paths along it are not here: {error}.", "note"),
            )
            return
        from curlfit.html_report.direction import directions_of

        for part in directions_of(fits, directions, "direction"):
            self.move("determined", part)

    def throws(self, fits: Sequence[FitResult]) -> None:
        """Add the animated throws."""
        from curlfit.html_report.replay import replay_of_fit

        for number, fit in enumerate(fits):
            label = Path(fit.data.file).name if len(fits) > 1 else ""
            self.move("throw", replay_of_fit(fit, f"replay-{number}", label))


def _of_joint(page: Additions, joint: JointResult) -> None:
    """What is measured of each throw, the null directions that the throws have in
    common, and the first throws animated."""
    from curlfit.reports.fit import extent, quantities_line

    throws = joint.throws
    if not throws:
        return
    measured = {}
    for throw in throws:
        parts = (extent(throw), quantities_line(throw))
        file = Path(throw.data.file).name
        measured[file] = "; ".join(part for part in parts if part)
    page.add("coefficients", rows("The throws", measured))
    shared = [
        direction
        for direction in throws[0].identifiability.null_directions
        if set(direction) <= set(joint.share)
    ]
    page.directions(throws, shared)
    count = len(throws)
    if count > _MOVING:
        page.add("throw", paragraph(f"The first {_MOVING} of {count} throws.", "note"))
    page.throws(throws[:_MOVING])


def _of_prediction(page: Additions, prediction: Prediction) -> None:
    """The predicted throw, animated, and where its draws come to rest."""
    from curlfit.html_report.replay import replay_of_prediction, rests_of

    page.move("throw", replay_of_prediction(prediction, "replay-0"))
    page.move("draws", rests_of(prediction, "rests"))
    if not prediction.sample:
        page.add("draws", paragraph(_OLD, "note"))


def _of_fit(page: Additions, fit: FitResult) -> None:
    """The null directions of a fit, and its throw, animated."""
    page.directions([fit], fit.identifiability.null_directions)
    page.throws([fit])


_PARTS: dict[str, Callable[[Additions, Any], None]] = {
    "fit": _of_fit,
    "joint": _of_joint,
    "predict": _of_prediction,
}
_CAPTIONS = {
    "fit": "The path with its fit, residuals by channel, speed and spin",
    "corner": "Posterior of the coefficients, pair by pair",
    "joint": (
        "All throws with their fits, and what each alone says of what "
        "they have in common"
    ),
    "friction": "Measured friction against speed, and the laws fitted to it",
    "compare": (
        "All paths over the data, their residuals, and the size of these by channel"
    ),
    "predict": "The path on the sheet, the resting position, the bands, speed and spin",
    "design-map": "What a single throw would tell, over speed and spin",
    "design-errors": "Errors against noise, rate and number of throws",
    "discrimination": (
        "How well one throw decides the hardest pair of laws, over speed and spin"
    ),
}


def _caption(result: Any, name: str) -> str:
    """What a figure of a result shows."""
    if name == "profile":
        loss = getattr(result, "each", [result])[0].loss
        robust = LOSSES[loss].is_robust
        what = "Minus twice the log-likelihood" if robust else "Chi squared"
        names = join_words(result.names)
        return f"{what} over {names}, all other parameters fitted again"
    if name == "fit" and not result.rms:
        return "Timed events beside the fit"
    return _CAPTIONS[name]


def additions_of(result: Any, chain: Chain | None) -> Additions:
    """The figures of a result, with that of its chain, and its interactive parts."""
    page = Additions()
    if result.kind in _PARTS:
        _PARTS[result.kind](page, result)
    figures = figures_of(result)
    if chain is not None:
        figures |= corner_of(result, chain)
    for name, figure in figures.items():
        page.draw(figure, name, _caption(result, name))
    return page
