"""The page of a profile likelihood, of one parameter or of two."""

from __future__ import annotations

from pathlib import Path

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
from curlfit.html_report.provenance import made_by, profile_command, rows_text
from curlfit.output.text import join_words
from curlfit.profile_likelihood.figures import profile_figure
from curlfit.profile_likelihood.report import overview, report
from curlfit.profile_likelihood.result import PairProfile, Profile


def page_of(profile: Profile | PairProfile) -> Page:
    """The page with the intervals, or why there are none."""
    one = profile if isinstance(profile, Profile) else profile.each[0]
    glance, said = overview(profile), Report.of(report(profile))
    heading, *parts = said.parts
    about = heading.plain.splitlines()[1:]  # type: ignore[union-attr]
    names = list(profile.names)
    captions = {
        one.name: "Intervals of the profile, the covariance and the posterior",
        "region spans": "Extent of the regions of both parameters",
    }
    settings = {
        "Law, load": f"{one.law}, {one.load}",
        "Data": f"{one.data['file']}, {rows_text(one.data)}",
        "Loss": one.loss,
    }
    what = "Chi squared" if one.loss == "linear" else "Minus twice the log-likelihood"
    caption = f"{what} over {join_words(names)}, all other parameters fitted again"
    sections = [
        section("measured", "What was measured", *(paragraph(sentence(line)) for line in about)),
        section("intervals", "Intervals", blocks_of(others(parts, glance.lines), captions)),
        warned(said.warnings, said.notes, names=names),
        drawings(drawing(profile_figure(profile), "profile", caption)),
        made_by(
            settings, [profile_command(one.data["file"], names)],
            ["The folder of the fit has the name that `curlfit fit` gives it, unless --out said "
             "otherwise."],
        ),
    ]  # fmt: skip
    return Page(
        title=f"{Path(one.data['file']).name}: profile of {join_words(names)}",
        subject=glance.subject.replace(one.data["file"], Path(one.data["file"]).name),
        finding=sentence(glance.finding, names),
        good=True,
        lines=tuple(glance.lines),
        warnings=len(said.warnings),
        sections=tuple(sections),
    )
