"""The page of a fit of one throw."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from curlfit.errors import CurlfitError
from curlfit.html_report.document import (
    Block,
    Page,
    Report,
    Section,
    blocks_of,
    drawings,
    paragraph,
    section,
    sentence,
    warned,
)
from curlfit.html_report.drawings import inline_svg
from curlfit.html_report.provenance import fit_command, fit_settings, made_by
from curlfit.html_report.replay import replay_of_fit
from curlfit.inference.derived_report import FITTED, OF_LAW
from curlfit.inference.fit.result import FitResult
from curlfit.inference.overview import overview
from curlfit.inference.report import identifiability, sections

if TYPE_CHECKING:
    from curlfit.inference.mcmc.chain import Chain

_CAPTIONS = {
    "parameter": "Estimates with standard errors",
    "refitted parameter": "Shift of the estimates with the constants of the stone",
    "": "Intervals at 95 %",
    "derived": "Derived quantities",
    FITTED: "Along the fitted path",
    OF_LAW: "Along the path of the law, without the discrepancy",
    "channel": "Residuals by channel",
    "measured": "Timed events",
}
_SEEN = ("determined", "prior", "fixed")


def page_of(fit: FitResult, chain: Chain | None = None) -> Page:
    """The page with the estimates, the animated throw and what the path does not determine."""
    glance, name = overview(fit), Path(fit.data["file"]).name
    parts = sections(fit)
    said = Report.of(parts["warnings"])
    notes = Report.of(parts["notes"]).notes
    (heading,) = Report.of(parts["heading"]).parts
    about = heading.plain.splitlines()[1]  # type: ignore[union-attr]
    data: dict[str, Any] = {}
    found = [
        section(
            "measured", "What was measured",
            paragraph(f"{name}: {about}."),
            blocks_of([parts["path"], parts["events"]], _CAPTIONS),
        ),
        section(
            "coefficients", "Coefficients",
            blocks_of(
                [parts[name] for name in ("estimates", "derived", "systematics", "reference",
                                          "quality", "posterior")],
                _CAPTIONS,
            ),
        ),
        section(
            "determined", _determined(fit),
            paragraph(identifiability(fit)), direction_blocks([fit], fit.null_directions, data),
        ),
        warned(
            said.warnings, notes, *blocks_of([parts["outliers"], parts["sampling"]], {}),
            names=fit.parameters,
        ),
        throw_section([fit], data),
        drawings(*figures(fit, chain)),
        made_by(fit_settings(fit), [fit_command(fit)]),
    ]  # fmt: skip
    determined = identifiability(fit).partition(". ")[0]
    return Page(
        title=f"{name}: {fit.law} law",
        subject=glance.subject.replace(fit.data["file"], name),
        finding=f"{sentence(fit.status)} {sentence(determined)}",
        good=fit.converged,
        lines=tuple(line for line in glance.lines if line),
        warnings=len(fit.warnings),
        sections=tuple(found),
        data=data,
    )


def _determined(fit: FitResult) -> str:
    """The heading of the section on what is determined."""
    hidden = any(item.verdict not in _SEEN for item in fit.parameters.values())
    return "What the path does not determine" if hidden else "What the path determines"


def direction_blocks(
    fits: Sequence[FitResult], directions: Sequence[dict[str, float]], data: dict[str, Any]
) -> list[Block]:
    """The interactive parts of null directions; their data are added to `data`."""
    if not directions or not all(fit.converged for fit in fits):
        return []
    try:
        fits[0].law_class  # noqa: B018  (a user's law is read from its file)
    except CurlfitError as error:
        return [paragraph(f"The paths along it are not here: {error}.", "note")]

    from curlfit.html_report.direction import directions_of

    found = []
    for block, own in directions_of(fits, directions, "direction"):
        data[block.shows["id"]] = own
        found.append(block)
    return found


def throw_section(fits: list[FitResult], data: dict[str, Any]) -> Section:
    """The section with the animated throws; their data are added to `data`."""
    blocks = []
    for place, fit in enumerate(fits):
        label = Path(fit.data["file"]).name if len(fits) > 1 else ""
        found = replay_of_fit(fit, f"replay-{place}", label)
        if found is not None:
            block, own = found
            data[block.shows["id"]] = own
            blocks.append(block)
    return section("throw", "The throw on the sheet" if len(fits) == 1 else "The throws", blocks)


def figures(fit: FitResult, chain: Chain | None) -> list[Block]:
    """The figures of a fit."""
    from curlfit.inference.figures import corner_figure, fit_figure

    path = "the path with its fit, residuals by channel, speed and spin"
    said = path if fit.rms else "timed events beside the fit"
    found = [drawing(fit_figure(fit), "fit", f"{said[:1].upper()}{said[1:]}")]
    if chain is not None:
        text = "Posterior of the coefficients, pair by pair"
        found.append(drawing(corner_figure(fit, chain), "corner", text))
    return found


def drawing(figure: Any, name: str, caption: str) -> Block:
    """A figure with its caption."""
    return Block("drawing", {"svg": inline_svg(figure, f"{name}-", caption), "caption": caption})
