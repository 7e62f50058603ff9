"""The page of a design."""

from __future__ import annotations

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
from curlfit.html_report.provenance import design_command, made_by, stone_text
from curlfit.optimal_design.figures import design_figures
from curlfit.optimal_design.report import noise_text, overview, report
from curlfit.optimal_design.result import Design

_FIGURES = {
    "design-map": "What a single throw would tell, over speed and spin",
    "design-errors": "Errors against noise, rate and number of throws",
    "design-separate": "Separation of two coefficients",
}

_CAPTIONS = {"coefficient": "The best throws: expected standard errors"}


def page_of(design: Design) -> Page:
    """The page with the optimal throws and the errors expected from them."""
    glance, said = overview(design), Report.of(report(design))
    heading, *parts = said.parts
    title, about = heading.plain.splitlines()  # type: ignore[union-attr]
    lines = tuple(line for line in glance.lines if line and line != about)
    said_before = (*lines, glance.finding)
    settings = {
        "Law, load": f"{design.law}, {design.load}",
        "Coefficients": ", ".join(f"{name} = {v:g}" for name, v in design.coefficients.items()),
        "Stone": stone_text(design.stone),
        "Noise": noise_text(design.sigma),
        "Throws": str(design.throws),
    }
    sections = [
        section("measured", "What is to be measured", paragraph(sentence(about))),
        section("errors", "Expected errors", blocks_of(others(parts, said_before), _CAPTIONS)),
        warned(said.warnings, said.notes, names=design.coefficients),
        drawings(*(
            drawing(figure, name, _FIGURES[name])
            for name, figure in design_figures(design).items()
        )),
        made_by(settings, [design_command(design)]),
    ]  # fmt: skip
    return Page(
        title=f"Design: {design.law} law",
        subject=title,
        finding=sentence(glance.finding),
        good=True,
        lines=lines,
        warnings=len(said.warnings),
        sections=tuple(sections),
    )
