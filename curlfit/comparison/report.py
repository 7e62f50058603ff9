"""What a comparison of laws says. Nothing is computed here."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.text import Text

from curlfit.comparison.candidate_columns import (
    CURL,
    DELTA_AICC,
    DELTA_BIC,
    DELTA_ELPD,
    DELTA_EVIDENCE,
    FOLLOWS,
    LAW,
    LOAD,
    NOISE,
    PARAMETERS,
    RANK,
    SIDES,
    SIZE_PHI,
    SIZE_X,
    SIZE_Y,
    share,
)
from curlfit.comparison.report_of_sets import document_of_sets
from curlfit.comparison.result import COMPONENTS, Candidate, Comparison
from curlfit.comparison.tables import coefficients_table, finding, order_by_bic
from curlfit.errors import Option
from curlfit.findings import Finding, Remedy
from curlfit.foreign import counted
from curlfit.losses import LOSSES
from curlfit.noises import WHITE
from curlfit.output.document import Document, Said, Section, command_line, show
from curlfit.output.table import Column, Table
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
    first_conclusion, *other_conclusions = conclusions(comparison)
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
        finding=finding(comparison),
        lines=[order_by_bic(comparison, " and {} more"), first_conclusion],
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
            Section(
                "conclusions",
                "What follows",
                (Said(first_conclusion), *other_conclusions),
            ),
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


class _Lack(NamedTuple):
    """Where most of an acceleration is lacking.

    Attributes
    ----------
    component, unit : of the acceleration.
    lacks, stderr : what the path has beyond the law there, and its standard error.
    significance : of the first over the second.
    speed, omega : of the stone, m/s and rad/s.
    of_law : the law's acceleration by friction along the path there or, of the spin,
        by what slows it.
    """

    component: str
    unit: str
    lacks: float
    stderr: float
    significance: float
    speed: float
    omega: float
    of_law: float


_LACK_COLUMNS: tuple[Column[_Lack], ...] = (
    Column("lacking", key="component"),
    Column(
        "most",
        words=lambda lack: f"{compact(lack.lacks, lack.stderr)} {lack.unit}",
        right=True,
        key="lacks",
    ),
    Column("std. errors", lambda lack: abs(lack.significance), ".1f", right=True),
    Column("at v", format=lambda speed: f"{speed:.2f} m/s", right=True, key="speed"),
    Column("spin", format=lambda omega: f"{omega:.2f} rad/s", right=True, key="omega"),
    Column(
        "of the law's",
        lambda lack: abs(lack.lacks) / lack.of_law if lack.of_law else None,
        lambda part: f"{100 * part:.2g} %",
        missing="",
        right=True,
    ),
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
    for row, (component, unit) in enumerate(COMPONENTS.items()):
        at = int(np.argmax(np.abs(by_error[row])))
        rows.append(
            _Lack(
                component,
                unit,
                lacking.lacks[row, at],
                lacking.stderr[row, at],
                by_error[row, at],
                lacking.speed[at],
                lacking.omega[at],
                friction[at] if row < 2 else abs(lacking.of_law[row, at]),
            )
        )
    table = Table(
        rows, _LACK_COLUMNS, "Accelerations that the path has beyond the first law"
    )
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


def _ranks(comparison: Comparison) -> Table[Candidate]:
    """Laws with their criteria and residuals, best first."""
    several_noises = len(comparison.noises) > 1
    candidates = comparison.candidates
    evidence = any(candidate.log_evidence is not None for candidate in candidates)
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
    columns = (
        RANK,
        LAW,
        LOAD,
        *([NOISE] if several_noises else []),
        PARAMETERS,
        DELTA_BIC,
        DELTA_EVIDENCE if evidence else DELTA_AICC,
        DELTA_ELPD,
        SIZE_X,
        SIZE_Y,
        SIZE_PHI,
        CURL,
        FOLLOWS,
        SIDES,
    )
    return Table(
        candidates,
        columns,
        "The laws, best first by BIC",
        keys=4 if several_noises else 3,
        note=note,
    )


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
    shares = join_words([f"{label} {share(weights[label])}" for label in named])
    return (
        "Posterior probabilities from the evidence, with equal prior probabilities "
        f"of the {len(weights)} laws: {shares}. They hold among these laws only; "
        "possibly none is correct."
    )


def _about_predictions(ranked: list[Candidate]) -> str:
    """Which laws leave-one-out does not distinguish from the best."""
    best, *other_laws = sorted(ranked, key=lambda law: -(law.delta_elpd or 0.0))
    alike = [
        law.label
        for law in other_laws
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
            excess = DELTA_BIC.cell(ranked[0])
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
        f"{text}; the closest explains {share(best.curl_explained)} of the "
        f"curl ({best.label})."
    )
