"""What a comparison of laws says. Nothing is computed here."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.text import Text

from curlfit.comparison.report_of_sets import document_of_sets
from curlfit.comparison.result import COMPONENTS, Candidate, Comparison
from curlfit.comparison.tables import (
    coefficients_table,
    difference,
    ranked_row,
    summary,
)
from curlfit.errors import Option
from curlfit.findings import Finding, Remedy
from curlfit.foreign import counted
from curlfit.losses import LOSSES
from curlfit.noises import WHITE
from curlfit.output.console import PlainTable
from curlfit.output.document import Document, Said, Section, command_line, show
from curlfit.output.text import stone_text
from curlfit.wording import compact, join_words

_PROBABLE = 0.01  # weight of a law that is named
_SEEN = 3.0  # standard errors, from which an acceleration is told from none
# below which differences and their errors are unreliable (Sivula, Magnusson, Matamoros
# and Vehtari 2020, Uncertainty in Bayesian leave-one-out)
_ELPD = 4.0


def print_comparison(comparison: Comparison, console: Console | None = None) -> None:
    """Print the report of a comparison.

    Examples
    --------
    >>> curlfit.print_comparison(comparison)
    2 fits to ...
    """
    show(document(comparison), console)


def document(comparison: Comparison) -> Document:
    """Ranks, coefficients, and what follows from them."""
    if comparison.sets:
        return document_of_sets(comparison)
    data = comparison.data
    first, *others = conclusions(comparison)
    count = len(comparison.candidates)
    loss = LOSSES[comparison.loss].suffix
    noise = ""
    if comparison.noises != (WHITE.kind,):
        noise = f", {join_words(comparison.noises)} noise"
    bend = "no more than its scatter"
    if comparison.side:
        bend = f"to the {comparison.side}"
    curl = f"curls {bend}: {comparison.curl:.3g} m (rms) off a straight line"
    fits = f"{counted(count, 'fit')} to {data['file']}{loss}{noise}"
    return Document(
        **summary(comparison, first, " and {} more"),
        subject=f"{fits}; the path {curl}",
        headline=Text(fits, style="bold"),
        about=(
            f"{data.in_words}; stone {stone_text(comparison.stone, mass=False)}",
            f"The path {curl}",
        ),
        sections=(
            Section("laws", "The laws", (_ranks(comparison),)),
            Section(
                "coefficients",
                "Coefficients",
                (coefficients_table(comparison),),
                brief=False,
            ),
            Section("conclusions", "What follows", (Said(first), *others)),
            Section(
                "lacking", "What the first law lacks", _lacking(comparison), brief=False
            ),
        ),
        warnings=_warnings(comparison),
        notes=_notes(comparison),
        title=f"{Path(data['file']).name}: which law?",
        settings={
            "Data": f"{data['file']}, {data.in_words}",
            "Stone": stone_text(comparison.stone),
            "Loss, noise": f"{comparison.loss}, {comparison.noise}",
        },
        command=command_line("compare", data.file, *data.flags),
    )


def _lacking(comparison: Comparison) -> tuple[Any, ...]:
    """Where the path has most beyond the first law, and which other law
    would add it."""
    lacking = comparison.lacking
    if lacking is None:
        return ()
    by_error = lacking.significance()
    friction = np.abs(lacking.of_law[1])
    rows = []
    for row, (name, unit) in enumerate(COMPONENTS.items()):
        at = int(np.argmax(np.abs(by_error[row])))
        lacks = lacking.lacks[row, at]
        error = lacking.stderr[row, at]
        # beside the friction along the path; in the spin beside what slows that
        of_law = friction[at] if row < 2 else abs(lacking.of_law[row, at])
        rows.append(
            {
                "lacking": name,
                ">most": f"{compact(lacks, error)} {unit}",
                ">std. errors": f"{abs(by_error[row, at]):.1f}",
                ">at v": f"{lacking.speed[at]:.2f} m/s",
                ">spin": f"{lacking.omega[at]:.2f} rad/s",
                ">of the law's": f"{100 * abs(lacks) / of_law:.2g} %" if of_law else "",
            }
        )
    table = PlainTable(rows, "Accelerations that the path has beyond the first law")
    if np.abs(by_error).max() < _SEEN:
        conclusion = (
            f"The path shows nothing that {lacking.law} lacks: all within {_SEEN:g} "
            "standard errors."
        )
    elif lacking.nearest:
        remaining = lacking.size(lacking.nearest)
        conclusion = (
            f"{lacking.nearest} would leave least of what {lacking.law} lacks: "
            f"a mean square of {remaining:.3g} of {lacking.size():.3g}, "
            "in standard errors."
        )
    else:
        conclusion = f"No other law has half of what {lacking.law} lacks."
    return table, Said(conclusion)


def _ranks(comparison: Comparison) -> PlainTable:
    """Laws with their criteria and residuals, best first."""
    several_noises = len(comparison.noises) > 1
    candidates = comparison.candidates
    evidence = any(candidate.log_evidence is not None for candidate in candidates)
    rows = [
        ranked_row(candidate, candidate.noise if several_noises else "")
        | _fitted(candidate, evidence=evidence)
        for candidate in candidates
    ]
    measure = "rms"
    by = ""
    if LOSSES[comparison.loss].is_robust:
        measure = "robust scale"
        by = (
            " BIC and AICc are those of the noise distribution of the "
            f"{comparison.loss} loss."
        )
    criteria = "dlnZ: log evidence minus the largest; " if evidence else ""
    if any(candidate.delta_elpd is not None for candidate in candidates):
        criteria += (
            "delpd: expected log predictive density of leave-one-out (elpd_loo) minus "
            "the largest, with the standard error of that in its last two digits; "
        )
    note = Text(
        "k: effective number of parameters, including those of the noise; "
        f"{criteria}x, y, phi: {measure} of the residuals; curl: "
        "fraction of the curl explained; ccw curls: sides to which the law can curl "
        "a counter-clockwise stone. A law follows the path if no residual exceeds "
        "a tenth of the deviation from uniform straight-line motion, or the noise, "
        f"nor five times that of another law.{by}",
        style="dim",
    )
    return PlainTable(
        rows, "The laws, best first by BIC", keys=4 if several_noises else 3, note=note
    )


def _fitted(candidate: Candidate, *, evidence: bool) -> dict[str, Any]:
    """Cells of the criteria and residuals of a fit."""
    if candidate.rms is None:
        return {"follows": Text("no fit", style="red")}
    size = candidate.residual_size
    criterion = {">dAICc": difference(candidate.delta_aicc)}
    if evidence:
        criterion = {">dlnZ": difference(candidate.delta_evidence)}
    elpd = difference(candidate.delta_elpd)
    if candidate.delta_elpd_se:
        elpd = compact(candidate.delta_elpd or 0.0, candidate.delta_elpd_se)
    curl = ""
    if candidate.curl_explained is not None:
        curl = _share(candidate.curl_explained)
    return {
        **criterion,
        ">delpd": elpd,
        **{
            f">{name} ({unit})": f"{1000 * size[name]:.3g}" if name in size else ""
            for name, unit in (("x", "mm"), ("y", "mm"), ("phi", "mrad"))
        },
        ">curl": curl,
        "follows": _FOLLOWS[candidate.follows],
        "ccw curls": " or ".join(candidate.sides) or "neither way",
    }


_FOLLOWS = {
    True: Text("yes", style="green"),
    None: Text("unclear"),
    False: Text("no", style="yellow"),
}


def _share(value: float) -> str:
    """A fraction in %, never rounded up to 100 %."""
    percent = 100 * max(value, 0.0)
    return f"{percent:.0f} %" if percent < 99 else f"{min(percent, 99.99):.2f} %"


def conclusions(comparison: Comparison) -> list[str]:
    """The conclusions from the comparison, in sentences."""
    fitted = [law for law in comparison.candidates if law.rms is not None]
    within_bounds = [law for law in fitted if not law.signs_free]
    physical = [law for law in within_bounds if not law.negative]
    following = [law.label for law in physical if law.follows is True]
    unclear = [law.label for law in physical if law.follows is None]
    sentences = []
    if following:
        sentences.append(
            f"Laws that follow the path within their bounds: {'; '.join(following)}."
        )
    if unclear:
        sentences.append(
            "Laws of which it is unclear whether they follow the path, as their "
            f"residuals may be correlated noise: {'; '.join(unclear)}."
        )
    if not (following or unclear):
        sentences.append("No law follows the path within its bounds.")
    isotropic = [law for law in within_bounds if law.isotropic]
    if isotropic:
        sentences.append(_about_isotropic(isotropic))
    for law in fitted:
        if law.negative and law.follows:
            names = join_words(law.negative)
            sentences.append(
                f"{law.label}: follows the path only with negative {names}."
            )
    weights = {law.label: law.weight for law in within_bounds if law.weight is not None}
    if weights:
        sentences.append(_about_evidence(weights))
    predicted = [
        law for law in within_bounds if law.rank and law.delta_elpd is not None
    ]
    if predicted:
        sentences.append(_about_predictions(predicted))
    if len(comparison.noises) > 1:
        sentences.append(_about_noise(comparison))
    return sentences


def _about_evidence(weights: Mapping[str, float]) -> str:
    """The laws that the evidence leaves probable, and their probabilities."""
    ordered = sorted(weights, key=lambda label: -weights[label])
    named = [label for label in ordered if weights[label] > _PROBABLE] or ordered[:1]
    shares = join_words([f"{label} {_share(weights[label])}" for label in named])
    return (
        "Posterior probabilities from the evidence, with equal prior probabilities "
        f"of the {len(weights)} laws: {shares}. They hold among these laws only; "
        "possibly none is correct."
    )


def _about_predictions(ranked: list[Candidate]) -> str:
    """Which laws leave-one-out does not distinguish from the best."""
    best, *others = sorted(ranked, key=lambda law: -(law.delta_elpd or 0.0))
    alike = [
        law.label
        for law in others
        if -(law.delta_elpd or 0.0) < max(_ELPD, 2 * (law.delta_elpd_se or 0.0))
    ]
    order = f"prefers {best.label} to all others"
    if alike:
        order = f"does not distinguish {best.label} from {'; '.join(alike)}"
    return f"Leave-one-out {order}: {_ELPD:g} or two standard errors apart would count."


def _about_noise(comparison: Comparison) -> str:
    """The noise model of the best fit, and how far the best fits of the others
    are from it."""
    best = comparison.best
    higher = ""
    for noise in comparison.noises:
        ranked = [
            law for law in comparison.candidates if law.noise == noise and law.rank
        ]
        if ranked and noise != best.noise:
            excess = difference(ranked[0].delta_bic)
            higher += f"; with {noise} noise it is {excess} higher"
    return (
        f"The lowest BIC is that of {best.noise} noise "
        f"({best.label}){higher}. The log evidence is not given, "
        "because the parameters of the noise have no prior, nor is leave-one-out, "
        "which would predict a row of correlated noise from its neighbours."
    )


def _warnings(comparison: Comparison) -> list[Finding]:
    """A warning that a ranking with correlated residuals is unreliable."""
    if not comparison.effective:
        return []
    worth = []
    for channel, effective in comparison.effective.items():
        values = comparison.observed.get(channel, [])
        rows = sum(value is not None and math.isfinite(value) for value in values)
        worth.append({"channel": channel, "effective": effective, "rows": rows or None})
    remedies = []
    if len(comparison.noises) == 1:
        remedies.append(Remedy("compare-noise", Option("noise", "white,ar1")))
    return [Finding.warning("ranking-not-reliable", *remedies, worth=worth)]


def _notes(comparison: Comparison) -> list[Finding]:
    """A note on the criteria that are not given; of several noise models the
    conclusions say it."""
    if not comparison.effective or len(comparison.noises) > 1:
        return []
    return [Finding.note("evidence-not-given")]


def _about_isotropic(isotropic: list[Candidate]) -> str:
    """Whether a law whose friction opposes sliding is enough, and how near the
    best of them comes."""
    positive = [law for law in isotropic if not law.negative]
    enough = "friction, opposite to sliding at every point, is enough"
    following = [law.label for law in positive if law.follows]
    if following:
        return f"Isotropic {enough}: {following[0]}."
    if any(law.follows is None for law in positive):
        return f"Whether isotropic {enough} is unclear."
    text = (
        "No isotropic law (friction opposite to sliding at every point) with "
        "non-negative coefficients follows the path"
    )
    best = max(positive, key=lambda law: law.curl_explained or 0.0, default=None)
    if best is None or best.curl_explained is None:
        return f"{text}."
    return (
        f"{text}; the closest explains {_share(best.curl_explained)} of the "
        f"curl ({best.label})."
    )
