"""What a joint fit says. Nothing is computed here."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from rich.console import Console
from rich.text import Text

from curlfit.findings import Finding
from curlfit.inference.joint.effects import SLOPES_DIFFER, chances_of_alike_slopes
from curlfit.output.console import PlainTable
from curlfit.output.document import Document, Section, command_line, show
from curlfit.output.text import labelled
from curlfit.reports.estimates import (
    about,
    derived_table,
    lines_of,
    of_posterior,
    row_of,
    style_of,
    systematics,
)
from curlfit.reports.fit import file_of, settings_of, with_derived
from curlfit.throws.odd_row import odd_rows_in_words
from curlfit.throws.throw import UNITS
from curlfit.wording import (
    capital,
    compact,
    format_estimate,
    join_words,
    lower,
    p_text,
    two_digits,
)

if TYPE_CHECKING:
    from curlfit.inference.joint.effects import Effect
    from curlfit.inference.joint.result import JointResult, Variation

_WORDS = {
    "curl": ("curl", "more", "less", "m"),
    "hog_to_hog": ("hog to hog", "longer", "shorter", "s"),
}
_DRAWN = {"friction": ("friction",), **_WORDS}
_CHANCE = 0.05  # probability above which an effect is within the errors
_R_HAT = 1.05  # of a sample that ended without the 1.01 that it aims at
_HIDDEN = ("x0", "y0", "phi0", "heading")
_Item = TypeVar("_Item")


def print_joint(result: JointResult, console: Console | None = None) -> None:
    """Print the report of a joint fit.

    Examples
    --------
    >>> curlfit.print_joint(joint)
    front-back law, uniform load, 2 throws together; shared: mu1_xi, ...
    """
    show(document(result), console)


def document(result: JointResult) -> Document:
    """Shared coefficients, how the throws differ in them, and each throw's
    own parameters."""
    throws, effects = f"{result.count} throws together", effect_lines(result)
    odd = " ".join(odd_rows_in_words(result.odd_rows))
    differing = ", ".join(
        item.expression for item in result.variation if item.significant
    )
    hidden = result.rank < result.parameters
    determined = (
        f"The throws determine {result.rank} of {result.parameters} parameters."
    )
    unconverged = []
    if result.r_hat is not None and result.r_hat >= _R_HAT:
        unconverged.append(Finding.warning("spreads-not-converged", r_hat=result.r_hat))
    return Document(
        finding=lower(result.status),
        style=style_of(result),
        subject=f"{result.law} law, {result.load} load, {throws}",
        headline=Text.assemble(
            (f"{result.law} law", "bold"),
            f", {result.load} load, {throws}; shared: {', '.join(result.share)}",
        ),
        about=about(result, result.warnings, odd),
        lines=[
            odd,
            *effects,
            *lines_of(result),
            f"Differs between throws: {differing}."
            if differing and not result.varies
            else "",
        ],
        sections=(
            Section(
                "coefficients",
                "Coefficients",
                (
                    *effects,
                    _shared(result),
                    _effects(result),
                    derived_table(result.derived),
                    _throws(result),
                ),
            ),
            Section(
                "determined",
                f"What the throws{' do not' * hidden} determine",
                (determined,),
            ),
            Section(
                "quality", "Systematic errors", (systematics(result),), brief=False
            ),
        ),
        warnings=(*result.warnings, *unconverged),
        notes=_notes(result),
        title=f"{throws}: {result.law} law",
        settings=(settings_of(result.throws[0]) if result.throws else {})
        | {
            "Data": ", ".join(_files(result)),
            "Sigma": "",
            "In common": ", ".join(result.share),
        },
        command=_command(result),
        names=result.throws[0].parameters if result.throws else result.coefficients,
    )


def _shared(result: JointResult) -> PlainTable:
    differences = {item.expression: item for item in result.variation}
    heading = "~spread between throws" if result.varies else "~differs between throws"
    items: dict[str, Any] = {one.expression: one for one in result.combinations}
    errors = result.systematics.errors
    rows = []
    for name, item in (result.coefficients | items).items():
        difference = differences.get(name)
        said = "" if difference is None else _said(difference, result.varies)
        rows.append(row_of("shared", name, item, errors.get(name)) | {heading: said})
    what = "Means of the throws" if result.varies else "What the throws have in common"
    return PlainTable(rows, f"{what}, with standard errors")


def _said(item: Variation, varies: bool) -> Text | str:
    """How a coefficient varies between throws."""
    if varies:
        share = (
            f", {abs(100 * item.spread / item.mean):.2g} %"
            if item.mean and item.spread
            else ""
        )
        return f"{item.spread:.2g}{share} ({item.p_text})"
    if not item.significant:
        return Text(f"no ({item.p_text})", style="green")
    mean = compact(item.mean, item.stderr)
    return Text(
        f"yes ({item.p_text}): spread {item.spread:.2g}, mean {mean}", style="yellow"
    )


def effect_lines(result: JointResult) -> list[str]:
    """A draw to the tee, and what groups and trends do to it, in sentences."""
    of_all = {one.parameter: one for one in result.groups if not one.by}
    if not of_all:
        return []
    friction = of_all["friction"]
    parts = [f"mean friction {compact(friction.value, friction.stderr)}"]
    parts += [
        f"{said} {compact(of_all[name].value, of_all[name].stderr)} {unit}"
        for name, (said, *_, unit) in _WORDS.items()
        if name in of_all
    ]
    found = [f"A draw to the tee: {', '.join(parts)}."]
    of_what: dict[tuple[str, str, str], dict[str, Effect]] = {}
    trends = () if result.slopes else result.trend
    for one in (*result.differences, *trends, *result.slopes):
        key = (one.along, one.by, one.group)
        of_what.setdefault(key, {})[one.parameter] = one
    for (along, by, group), mine in of_what.items():
        first = mine["friction"]
        if along or not group:
            trend = along or by
            per = first.unit.partition("/")[2] or "unit"
            head = f"Per {per}" + (f" of {trend}" if trend != per else "")
            head += f" on {by} {group}" if group else ""
        else:
            head = f"{capital(by)} {group} against {first.against}"
        percent = compact(
            *(100 * abs(one) / friction.value for one in (first.value, first.stderr))
        )
        parts = [f"friction {percent} % {'higher' if first.value > 0 else 'lower'}"]
        for name, (said, more, less, unit) in _WORDS.items():
            if effect := mine.get(name):
                size = compact(abs(effect.value), effect.stderr)
                parts.append(
                    f"{said} {size} {unit} {more if effect.value > 0 else less}"
                )
        chance = [
            said
            for name, (said, *_) in _DRAWN.items()
            if name in mine and (mine[name].p or 0) > _CHANCE
        ]
        within = f" ({join_words(chance)} within the errors)" if chance else ""
        found.append(f"{head}: {', '.join(parts)}{within}.")
    return [*found, *_alike_slopes(result)]


def _alike_slopes(result: JointResult) -> list[str]:
    """Sentences on labels whose groups change alike along the trends, as far as
    is known."""
    chances = chances_of_alike_slopes(result.slope_differences)
    return [
        f"The slopes by {label} differ no more than by chance ({p_text(chance)})."
        for label, chance in chances.items()
        if chance >= SLOPES_DIFFER
    ]


def _effects(result: JointResult) -> PlainTable:
    rows = []
    trend_by = () if result.means is None else result.means.trend_by
    effects = [*result.groups, *result.differences, *result.trend, *result.slopes]
    effects += [one for one in result.slope_differences if one.by in trend_by]
    for one in effects:
        if one.parameter in _DRAWN or not one.by:
            continue
        what = f"{one.by} {one.group}".strip()
        what += f" - {one.against}" if one.against else ""
        what += f", {one.along}" if one.along else ""
        value, error = format_estimate(one.value, one.stderr)
        rows.append(
            {
                "": what,
                "quantity": labelled(one.parameter, one.unit),
                ">estimate": value,
            }
            | {">std. error": error, "p": "" if one.p is None else p_text(one.p)}
            | of_posterior(one.quantiles)
        )
    rows += [
        {
            "": "between throws",
            "quantity": item.expression,
            ">estimate": two_digits(item.spread),
        }
        | of_posterior(item.quantiles)
        for item in result.variation
        if item.quantiles
    ]
    return PlainTable(rows, "Groups and trends")


def _throws(result: JointResult) -> PlainTable:
    rows = []
    for place, one in enumerate(result.throws):
        row = {"throw": Path(one.data["file"]).name}
        for name, item in one.parameters.items():
            if name not in (*result.share, *_HIDDEN) and item.verdict.is_free:
                row[f">{name}"] = format_estimate(item.value, item.stderr)[0]
        for difference in result.variation:
            alone = difference.each[place]
            row[f">{difference.expression} alone"] = (
                "" if alone is None else compact(*alone)
            )
        for name, rms in one.rms.items():
            row[f">{name}\n(m{UNITS[name]})"] = f"{1000 * rms:.3g}"
        rows.append(row)
    return PlainTable(rows, "Each throw, with what it says alone")


def _notes(result: JointResult) -> list[Finding]:
    """Notes of the reader on all throws."""
    if result.table is not None:
        return [*result.table.notes, Finding.note("quadratic-throws")]
    return _of_all([throw.data["notes"] for throw in result.throws])


def _of_all(lists: Sequence[Sequence[_Item]]) -> list[_Item]:
    """The items that are in all of some lists."""
    if not lists:
        return []
    return [item for item in lists[0] if all(item in other for other in lists)]


def _files(result: JointResult) -> list[str]:
    """The files of the throws, each once."""
    if result.table is not None:
        return [result.table.file]
    return list(dict.fromkeys(map(file_of, result.throws)))


def _command(result: JointResult) -> str:
    """The command of a joint fit: with the flags that all throws have in common."""
    flags = _of_all([one.data.get("flags", ()) for one in result.throws])
    if result.throws and tuple(result.share) != tuple(result.throws[0].coefficients):
        flags.append("--share=" + ",".join(result.share))
    elif result.means is None:
        flags.append("--share=all")
    else:
        flags += [f"--by={name}" for name in result.means.groups]
        flags += [f"--trend={name}" for name in result.means.trends]
        flags += [f"--trend-by={name}" for name in result.means.trend_by]
    return command_line("fit", *_files(result), *with_derived(flags, result))
