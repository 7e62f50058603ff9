"""The page of a prediction."""

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
    section,
    sentence,
    warned,
)
from curlfit.html_report.of_fit import drawing
from curlfit.html_report.provenance import made_by, prediction_command, stone_text
from curlfit.html_report.replay import replay_of_prediction
from curlfit.html_report.rests import rests_of
from curlfit.prediction.figures import prediction_figure
from curlfit.prediction.report import describe_rest, overview, report
from curlfit.prediction.result import Prediction

_CAPTIONS = {
    "": "Predicted quantities: best estimate, standard deviations by the errors of the parameters "
    "and by the model discrepancy, intervals by both",
    "held out": "Rows that were not fitted",
}


def page_of(prediction: Prediction) -> Page:
    """The page with the resting position and its uncertainty."""
    glance, said = overview(prediction), Report.of(report(prediction))
    heading, *parts = said.parts
    about = heading.plain.splitlines()[1:]  # type: ignore[union-attr]
    data: dict[str, Any] = {}
    block, data["replay-0"] = replay_of_prediction(prediction, "replay-0")
    moving = rests_of(prediction, "rests")
    old = "This record was written without draws of the posterior; `curlfit predict` adds them."
    draws = [paragraph(old, "note")]
    if moving is not None:
        draws, data["rests"] = [moving[0]], moving[1]
    fit = prediction.fit
    settings = {
        "Law, load": f"{prediction.law}, {prediction.load}",
        "Fit": f"{fit['file']}, {fit['rows']} rows, t = {fit['from']:g} .. {fit['to']:g} s",
        "Stone": stone_text(prediction.stone),
        "Start": ", ".join(
            f"{name} = {item['value']:.6g} {item['unit']} ({item['origin']})"
            for name, item in prediction.start.items()
        ),
        "Draws": f"{prediction.draws['used']} of {prediction.draws['number']}, seed "
        f"{prediction.draws['seed']}",
    }
    caption = "The path on the sheet, the resting position, the bands, speed and spin"
    sections = [
        section("predicted", "What is predicted", *(paragraph(sentence(line)) for line in about),
                blocks_of(others(parts, [describe_rest(prediction)]), _CAPTIONS)),
        warned(said.warnings, said.notes, names=prediction.start),
        section("throw", "The throw on the sheet", block),
        section("draws", "Where it may come to rest", draws),
        drawings(drawing(prediction_figure(prediction), "prediction", caption)),
        made_by(
            settings, [prediction_command(prediction)],
            ["The folder of the fit has the name that `curlfit fit` gives it, unless --out said "
             "otherwise."],
        ),
    ]  # fmt: skip
    return Page(
        title=f"{Path(fit['file']).name}: "
        + ("the throw to rest" if prediction.of == "fitted" else "another throw"),
        subject=glance.subject.replace(fit["file"], Path(fit["file"]).name),
        finding=describe_rest(prediction),
        good=True,
        lines=tuple(line for line in glance.lines[:-1] if line),
        warnings=len(said.warnings),
        sections=tuple(sections),
        data=data,
    )
