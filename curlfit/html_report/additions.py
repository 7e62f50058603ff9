"""What the page of each kind of result has beside its document: figures and
interactive parts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from curlfit.errors import CurlfitError
from curlfit.html_report.blocks import Block, FigureBlock, NamedValues, Paragraph
from curlfit.html_report.drawings import inline_svg
from curlfit.losses import LOSSES
from curlfit.output.display import figures_of
from curlfit.reports.corner import corner_of
from curlfit.wording import join_words

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from curlfit.inference.fit.result import FitResult
    from curlfit.inference.sampling.chain import Chain
    from curlfit.inference.together.result import JointResult
    from curlfit.prediction.result import Prediction

_MOST_ANIMATED = 6  # throws in a page
_NO_DRAWS = (
    "This record was written without draws of the posterior; "
    "`curlfit predict` adds them."
)


@dataclass
class Additions:
    """Blocks by the id of a section: of one of the document, at its end, or of one
    that follows."""

    blocks: dict[str, list[Block]] = field(default_factory=dict)

    def add(self, section: str, block: Block) -> None:
        """Add to a section."""
        self.blocks.setdefault(section, []).append(block)

    def add_figure(self, figure: Figure, name: str, caption: str) -> None:
        """Add a figure, whose ids begin with its name."""
        svg = inline_svg(figure, f"{name}-", caption)
        self.add("figures", FigureBlock(svg, caption))

    def add_directions(
        self, fits: Sequence[FitResult], directions: Sequence[Mapping[str, float]]
    ) -> None:
        """Add the null directions of fits, in parameters that they have in common."""
        if not directions or not all(fit.converged for fit in fits):
            return
        try:
            fits[0].law_class  # noqa: B018  (a user's law is read from its file)
        except CurlfitError as error:
            text = f"The paths along it are not here: {error}."
            self.add("determined", Paragraph(text, "note"))
            return
        from curlfit.html_report.direction import directions_of

        for direction in directions_of(fits, directions, "direction"):
            self.add("determined", direction)

    def add_replays(self, fits: Sequence[FitResult]) -> None:
        """Add the animated throws; the first one is explained."""
        from curlfit.html_report.replay import replay_of_fit

        for number, fit in enumerate(fits):
            label = Path(fit.data.file).name if len(fits) > 1 else ""
            replay = replay_of_fit(
                fit, f"replay-{number}", label, explained=number == 0
            )
            if replay is not None:
                self.add("throw", replay)


def _add_of_fit(additions: Additions, fit: FitResult) -> None:
    """Add the null directions of a fit, and its throw, animated."""
    additions.add_directions([fit], fit.identifiability.null_directions)
    additions.add_replays([fit])


def _add_of_joint(additions: Additions, joint: JointResult) -> None:
    """Add what is measured of each throw, the null directions that the throws have in
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
    additions.add("coefficients", NamedValues("The throws", measured))
    shared_directions = [
        direction
        for direction in throws[0].identifiability.null_directions
        if set(direction) <= set(joint.share)
    ]
    additions.add_directions(throws, shared_directions)
    if len(throws) > _MOST_ANIMATED:
        text = f"The first {_MOST_ANIMATED} of {len(throws)} throws."
        additions.add("throw", Paragraph(text, "note"))
    additions.add_replays(throws[:_MOST_ANIMATED])


def _add_of_prediction(additions: Additions, prediction: Prediction) -> None:
    """Add the predicted throw, animated, and where its draws come to rest."""
    from curlfit.html_report.replay import replay_of_prediction, rests_of

    additions.add("throw", replay_of_prediction(prediction, "replay-0"))
    rests = rests_of(prediction, "rests")
    if rests is None:
        additions.add("draws", Paragraph(_NO_DRAWS, "note"))
    else:
        additions.add("draws", rests)


_ADD_OF_KIND: dict[str, Callable[[Additions, Any], None]] = {
    "fit": _add_of_fit,
    "joint": _add_of_joint,
    "predict": _add_of_prediction,
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
        profiles = getattr(result, "each", [result])  # of a pair, both alone
        is_robust = LOSSES[profiles[0].loss].is_robust
        what = "Minus twice the log-likelihood" if is_robust else "Chi squared"
        names = join_words(result.names)
        return f"{what} over {names}, all other parameters fitted again"
    if name == "fit" and not result.rms:
        return "Timed events beside the fit"
    return _CAPTIONS[name]


def additions_of(result: Any, chain: Chain | None) -> Additions:
    """The figures of a result, with that of its chain, and its interactive parts."""
    additions = Additions()
    if result.kind in _ADD_OF_KIND:
        _ADD_OF_KIND[result.kind](additions, result)
    figures = figures_of(result)
    if chain is not None:
        figures |= corner_of(result, chain)
    for name, figure in figures.items():
        additions.add_figure(figure, name, _caption(result, name))
    return additions
