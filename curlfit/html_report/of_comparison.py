"""The page of a comparison of laws."""

from __future__ import annotations

from pathlib import Path

from curlfit.comparison.figures import comparison_figure
from curlfit.comparison.report import overview, report
from curlfit.comparison.result import Comparison
from curlfit.html_report.document import (
    Page,
    Report,
    blocks_of,
    drawings,
    others,
    paragraph,
    section,
    sentence,
    warned,
)
from curlfit.html_report.of_fit import drawing
from curlfit.html_report.provenance import (
    comparison_command,
    made_by,
    rows_text,
    stone_text,
)

_CAPTIONS = {
    "": "The laws, best first by BIC",
    "law, load": "Coefficients of each law, with standard errors",
}


def page_of(comparison: Comparison) -> Page:
    """The page with the ranking of the laws."""
    glance, said = overview(comparison), Report.of(report(comparison))
    heading, *parts = said.parts
    lines = heading.plain.splitlines()  # type: ignore[union-attr]
    data = comparison.data
    settings = {
        "Data": f"{data['file']}, {rows_text(data)}", "Stone": stone_text(comparison.stone),
        "Loss, noise": f"{comparison.loss}, {comparison.noise}",
    }  # fmt: skip
    caption = "All paths over the data, their residuals, and the size of these by channel"
    sections = [
        section("measured", "What was measured", *(paragraph(f"{line}.") for line in lines[1:])),
        section("laws", "The laws", blocks_of(others(parts, glance.lines), _CAPTIONS)),
        warned(said.warnings),
        drawings(drawing(comparison_figure(comparison), "comparison", caption)),
        made_by(settings, [comparison_command(comparison)]),
    ]
    return Page(
        title=f"{Path(data['file']).name}: which law?",
        subject=lines[0].replace(data["file"], Path(data["file"]).name),
        finding=sentence(glance.finding),
        good=True,
        lines=tuple(line for line in glance.lines if line),
        warnings=len(said.warnings),
        sections=tuple(sections),
    )
