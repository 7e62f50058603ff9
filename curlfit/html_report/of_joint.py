"""The page of a joint fit of several throws."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from curlfit.html_report.document import (
    Page,
    Report,
    blocks_of,
    drawings,
    others,
    paragraph,
    rows,
    section,
    sentence,
    warned,
)
from curlfit.html_report.of_fit import direction_blocks, drawing, throw_section
from curlfit.html_report.provenance import (
    data_files,
    fit_settings,
    joint_command,
    made_by,
)
from curlfit.inference.derived_report import quantities_line
from curlfit.inference.joint.report import report
from curlfit.inference.joint.result import JointResult
from curlfit.inference.overview import overview
from curlfit.inference.report import extent

_MOVING = 6  # animated throws in a page
_CAPTIONS = {
    "shared": "What the throws have in common, with standard errors",
    "throw": "Each throw, with what it says alone",
    "derived": "Derived quantities",
}


def page_of(joint: JointResult) -> Page:
    """The page with the joint estimates and each throw animated."""
    from curlfit.inference.figures import joint_figure

    glance, said = overview(joint), Report.of(report(joint))
    data: dict[str, Any] = {}
    first = joint.throws[0]
    shared = [one for one in first.null_directions if set(one) <= set(joint.share)]
    determined = f"The throws determine {joint.rank} of {joint.parameters} parameters."
    names = [Path(one.data["file"]).name for one in joint.throws]
    more = len(joint.throws) - _MOVING
    note = [paragraph(f"The first {_MOVING} of {len(joint.throws)} throws.", "note")] * (more > 0)
    warnings = said.warnings
    for one, name in zip(joint.throws, names, strict=True):
        warnings = [text.replace(f"{one.data['file']}:", f"{name}:") for text in warnings]
    moving = throw_section(list(joint.throws[:_MOVING]), data)
    settings = fit_settings(first) | {
        "Data": ", ".join(data_files(joint)),
        "In common": ", ".join(joint.share),
    }
    parts = others(said.parts[1:], [determined])
    sections = [
        section("measured", "What was measured", _measured(joint)),
        section("coefficients", "Coefficients", blocks_of(parts, _CAPTIONS)),
        section(
            "determined", "What the throws do not determine",
            direction_blocks(joint.throws, shared, data),
        ),
        warned(warnings, names=first.parameters),
        section(moving.id, moving.heading, note * bool(moving.blocks), moving.blocks),
        drawings(drawing(joint_figure(joint), "joint", "All throws with their fits, and what each "
                         "alone says of what they have in common")),
        made_by(settings, [joint_command(joint)]),
    ]  # fmt: skip
    return Page(
        title=f"{len(names)} throws together: {joint.law} law",
        subject=f"{glance.subject}: {', '.join(names)}",
        finding=f"{sentence(joint.status)} {determined}",
        good=joint.converged,
        lines=tuple(line for line in glance.lines if line),
        warnings=len(warnings),
        sections=tuple(sections),
        data=data,
    )


def _measured(joint: JointResult) -> list[Any]:
    """The rows of each throw, and its commonly quoted quantities."""
    found = {
        Path(one.data["file"]).name: "; ".join(
            part
            for part in (extent(one.data, len(one.events)), quantities_line(one.quantities))
            if part
        )
        for one in joint.throws
    }
    return [rows("The throws", found)]
