"""Columns of tables of candidates, each once: reports, CSV, LaTeX and pandas pick from
them. A row is a `Candidate`."""

from __future__ import annotations

from typing import Any

from rich.text import Text

from curlfit.output.table import Column
from curlfit.wording import compact


def difference(value: float) -> str:
    """A difference of a criterion."""
    return f"{value:.1f}" if abs(value) < 1000 else f"{value:.0f}"


def share(value: float) -> str:
    """A fraction in %, never rounded up to 100 %."""
    percent = 100 * max(value, 0.0)
    return f"{percent:.0f} %" if percent < 99 else f"{min(percent, 99.99):.2f} %"


def _rank_in_words(candidate: Any) -> str:
    return "-" if candidate.rank is None else str(candidate.rank)


def _law_in_words(candidate: Any) -> Text:
    """The law, and whether its coefficients may have any sign."""
    sign = " any sign" if candidate.signs_free else ""
    return Text.assemble(candidate.law, (sign, "dim"))


def _elpd_in_words(candidate: Any) -> str:
    """The difference of leave-one-out with its standard error; empty without one."""
    if candidate.delta_elpd_se:
        return compact(candidate.delta_elpd or 0.0, candidate.delta_elpd_se)
    return "" if candidate.delta_elpd is None else difference(candidate.delta_elpd)


def _follows_in_words(candidate: Any) -> Text:
    """Whether a law follows the path."""
    if candidate.rms is None:
        return Text("no fit", style="red")
    if candidate.follows is None:
        return Text("unclear")
    if candidate.follows:
        return Text("yes", style="green")
    return Text("no", style="yellow")


def _sides_in_words(candidate: Any) -> str:
    """The sides to which a law can curl; empty without a fit."""
    if candidate.rms is None:
        return ""
    return " or ".join(candidate.sides) or "neither way"


def _coefficients_as_text(candidate: Any) -> str:
    """Coefficients with their values in one cell."""
    return "; ".join(
        f"{name} = {coefficient['value']:.6g}"
        for name, coefficient in (candidate.coefficients or {}).items()
    )


def residual_size(channel: str, unit: str) -> Column[Any]:
    """The column of the residuals in a channel: their rms in SI units for programs, and
    on a page their size, of the bulk under a robust loss, in thousandths of these."""

    def rms(candidate: Any) -> Any:
        return (candidate.rms or {}).get(channel)

    def in_words(candidate: Any) -> str:
        size = candidate.residual_size.get(channel)
        return "" if size is None else f"{1000 * size:.3g}"

    return Column(
        channel, rms, words=in_words, unit=f"m{unit}", key=f"rms_{channel}", right=True
    )


CandidateColumn = Column[Any]
RANK = CandidateColumn("", words=_rank_in_words, key="rank", right=True)
LAW = CandidateColumn("law", words=_law_in_words)
LABEL = CandidateColumn("law, load", key="label")
LOAD = CandidateColumn("load")
NOISE = CandidateColumn("noise")
SIGNS_FREE = CandidateColumn("signs_free")
CONVERGED = CandidateColumn("converged")
STATUS = CandidateColumn("status")
PARAMETERS = CandidateColumn(
    "k", format=".3g", key="n_parameters", missing="", right=True
)
BIC = CandidateColumn("bic")
DELTA_BIC = CandidateColumn(
    "dBIC", format=difference, key="delta_bic", missing="", right=True
)
AICC = CandidateColumn("aicc")
DELTA_AICC = CandidateColumn(
    "dAICc", format=difference, key="delta_aicc", missing="", right=True
)
EVIDENCE = CandidateColumn("log_evidence")
DELTA_EVIDENCE = CandidateColumn(
    "dlnZ", format=difference, key="delta_evidence", missing="", right=True
)
DELTA_ELPD = CandidateColumn(
    "delpd", words=_elpd_in_words, key="delta_elpd", right=True
)
WEIGHT = CandidateColumn("weight")
SIZE_X = residual_size("x", "m")
SIZE_Y = residual_size("y", "m")
SIZE_PHI = residual_size("phi", "rad")
CURL = CandidateColumn(
    "curl", format=share, key="curl_explained", missing="", right=True
)
FOLLOWS = CandidateColumn("follows", words=_follows_in_words)
SIDES = CandidateColumn("ccw curls", words=_sides_in_words, key="sides")
COEFFICIENTS = CandidateColumn("coefficients", _coefficients_as_text)

IN_FRAME = (
    LAW,
    LOAD,
    SIGNS_FREE,
    RANK,
    CONVERGED,
    STATUS,
    PARAMETERS,
    DELTA_BIC,
    DELTA_AICC,
    DELTA_EVIDENCE,
    WEIGHT,
    CURL,
    FOLLOWS,
    SIZE_X,
    SIZE_Y,
    SIZE_PHI,
)
"""Columns of a DataFrame."""
IN_CSV = (
    RANK,
    LAW,
    LOAD,
    SIGNS_FREE,
    CONVERGED,
    PARAMETERS,
    BIC,
    DELTA_BIC,
    AICC,
    DELTA_AICC,
    EVIDENCE,
    DELTA_EVIDENCE,
    WEIGHT,
    CURL,
    FOLLOWS,
    SIZE_X,
    SIZE_Y,
    SIZE_PHI,
    COEFFICIENTS,
)
"""Columns of a CSV file."""
