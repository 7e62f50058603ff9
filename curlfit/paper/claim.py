"""A recomputed claim, and how the claims are shown: table, verdicts and page."""

from __future__ import annotations

import tomllib
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from importlib.resources import files
from typing import Any, Literal, NamedTuple

from rich import box
from rich.table import Table as RichTable
from rich.text import Text

from curlfit.output.console import renderable
from curlfit.output.document import Document, Section
from curlfit.output.table import Column, Table
from curlfit.wording import lower

Verdict = Literal["holds", "holds with a correction", "does not hold"]

_STYLE = {
    "holds": "green",
    "holds with a correction": "yellow",
    "does not hold": "bold red",
}


@dataclass(frozen=True)
class Claim:
    """A numbered statement of the paper beside the result of the model.

    Attributes
    ----------
    id : equation or proposition, "eq14x" or "prop2" for instance.
    claim : a short statement of the claim.
    printed, computed : the paper's result and the one computed, with units.
    verdict : "holds", "holds with a correction" or "does not hold".
    why : one sentence.

    Examples
    --------
    >>> claim = curlfit.Claim(
    ...     "eq13", "speed at t = 0", "2 m/s", "2.06 m/s", "holds", "as computed"
    ... )
    >>> claim.as_dict()["verdict"]
    'holds'
    """

    id: str
    claim: str
    printed: str
    computed: str
    verdict: Verdict
    why: str

    def as_dict(self) -> dict[str, str]:
        """The fields by name."""
        return asdict(self)


class Judged(NamedTuple):
    """The verdict on a claim, and the numbers that its words name besides those of
    the studies."""

    verdict: Verdict
    numbers: dict[str, Any]


def judged(holds: Any, *, corrected: Any = False, **numbers: Any) -> Judged:
    """The verdict on a claim that holds or not, as printed or with a correction."""
    if not holds:
        return Judged("does not hold", numbers)
    return Judged("holds with a correction" if corrected else "holds", numbers)


def claims_of(
    studies: Mapping[str, Any], judged_by_id: Mapping[str, Judged]
) -> tuple[Claim, ...]:
    """The claims in the words of `claims.toml`, with the numbers of the studies and of
    each judgement."""
    file = files("curlfit.paper").joinpath("claims.toml")
    claims = []
    for id, texts in tomllib.loads(file.read_text("utf-8")).items():
        verdict, numbers = judged_by_id[id]
        words = {key: text.format(**studies, **numbers) for key, text in texts.items()}
        claims.append(Claim(id=id, verdict=verdict, **words))
    return tuple(claims)


def _statement(claim: Claim) -> Text:
    """A claim, and why it holds or not below."""
    statement = Text(claim.claim + "\n", style="bold")
    statement.append(claim.why, style="not bold dim")
    return statement


def claims_table(claims: tuple[Claim, ...]) -> Table[Claim]:
    """The claims beside what was computed."""
    columns: tuple[Column[Claim], ...] = (
        Column("", key="id"),
        Column("claim, and why", words=_statement, key="claim"),
        Column("printed"),
        Column("computed"),
        Column("verdict", format=lambda verdict: Text(verdict, style=_STYLE[verdict])),
    )
    return Table(claims, columns)


def printed_claims(claims: tuple[Claim, ...]) -> RichTable:
    """The claims as they are printed, readable at 80 columns or more: cells of long
    lines wrapped, in widths of a fixed ratio."""
    layouts: tuple[dict[str, Any], ...] = (
        {"no_wrap": True, "style": "bold"},
        {"ratio": 33, "overflow": "fold"},
        {"ratio": 27, "overflow": "fold"},
        {"ratio": 30, "overflow": "fold"},
        {"width": 12},
    )
    table = claims_table(claims)
    printed = RichTable(
        box=box.SIMPLE_HEAD,
        show_lines=False,
        pad_edge=False,
        padding=(0, 1, 1, 0),
        expand=True,
    )
    for column, layout in zip(table.columns, layouts, strict=True):
        printed.add_column(column.title, **layout)
    for claim in claims:
        printed.add_row(*(renderable(column.cell(claim)) for column in table.columns))
    return printed


def verdicts(claims: tuple[Claim, ...]) -> str:
    """Number of claims by verdict, as a sentence."""
    count = Counter(claim.verdict for claim in claims)
    failed = count["does not hold"]
    return (
        f"Of {len(claims)} claims {count['holds']} hold, "
        f"{count['holds with a correction']} hold with a correction, "
        f"{failed} {'does' if failed == 1 else 'do'} not hold."
    )


def document(reproduction: Any) -> Document:
    """The verdicts and the table of claims of a `Reproduction`."""
    claims = reproduction.claims
    ids_by_verdict: dict[str, list[str]] = {}
    for claim in claims:
        ids_by_verdict.setdefault(claim.verdict, []).append(claim.id)
    return Document(
        finding=lower(verdicts(claims)).rstrip("."),
        subject="claims of Ivanov and Shuvalov (2012), recomputed",
        lines=[
            f"{verdict}: {', '.join(ids)}" for verdict, ids in ids_by_verdict.items()
        ],
        sections=[Section("claims", "Claims", [claims_table(claims)])],
    )


def page(reproduction: Any, format: str = "png") -> str:
    """`claims.md`: the claims of a `Reproduction`, and what is behind them, with
    figures of a format."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    pages = Environment(
        loader=PackageLoader("curlfit.paper", ""),
        undefined=StrictUndefined,
        trim_blocks=True,
        keep_trailing_newline=True,
    )
    pages.filters["as"] = lambda value, form: f"{value:{form}}"
    pages.filters["each"] = lambda values, form, between=" | ": between.join(
        f"{value:{form}}" for value in values
    )
    pages.filters["cell"] = lambda text: text.replace("|", r"\|")
    return pages.get_template("claims.md.j2").render(
        vars(reproduction), verdicts=verdicts(reproduction.claims), format=format
    )
