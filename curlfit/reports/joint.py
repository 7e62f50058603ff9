"""What a joint fit says. Nothing is computed here."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.text import Text

from curlfit.output.console import PlainTable
from curlfit.output.document import Document, Section, command_line, show
from curlfit.output.text import (
    capital,
    compact,
    format_estimate,
    from_to,
    join_words,
    labelled,
    lower,
    p_text,
    two_digits,
)
from curlfit.reports.estimates import (
    caution,
    derived_table,
    estimate_cells,
    lines_of,
    status_line,
    style_of,
    systematics,
)
from curlfit.reports.fit import file_of, settings_of, with_derived
from curlfit.throws.throw import UNITS

if TYPE_CHECKING:
    from curlfit.inference.derived import Quantiles
    from curlfit.inference.joint.result import JointResult, Variation

_DRAWN = ("friction", "curl", "hog_to_hog")
_WORDS = {
    "curl": ("curl", "more", "less", "m"),
    "hog_to_hog": ("hog to hog", "longer", "shorter", "s"),
}
_CHANCE = 0.05  # probability above which an effect is within the errors
_R_HAT = 1.05  # of a sample that ended without the 1.02 that it aims at
_FIRST_ORDER = (
    "each throw counts as the quadratic about its own optimum; errors due to conditions, which all "
    "throws have in common, are not contained: see the fit of a throw"
)
_HIDDEN = ("x0", "y0", "phi0", "heading")


def print_joint(result: JointResult, console: Console | None = None) -> None:
    """Print the report of a joint fit.

    Examples
    --------
    >>> curlfit.print_joint(joint)
    front-back law, uniform load, 2 throws together; shared: mu1_xi, ...
    """
    show(document(result), console)


def document(result: JointResult) -> Document:
    """Shared coefficients, how the throws differ in them, and each throw's own parameters."""
    throws = f"{result.count} throws together"
    differing = [item.expression for item in result.variation if item.significant]
    hidden = result.rank < result.parameters
    determined = f"The throws determine {result.rank} of {result.parameters} parameters."
    return Document(
        finding=lower(result.status),
        style=style_of(result),
        subject=f"{result.law} law, {result.load} load, {throws}",
        headline=Text.assemble(
            (f"{result.law} law", "bold"),
            f", {result.load} load, {throws}; shared: {', '.join(result.share)}",
        ),
        about=(status_line(result), caution(result)),
        lines=[
            *effect_lines(result),
            *lines_of(result),
            f"Differs between throws: {', '.join(differing)}."
            if differing and not result.varies
            else "",
        ],
        sections=(
            Section(
                "coefficients", "Coefficients",
                (
                    *effect_lines(result), _shared(result), _effects(result),
                    derived_table(result.derived), _throws(result),
                ),
            ),
            Section("determined", f"What the throws{' do not' * hidden} determine", (determined,)),
            Section("quality", "Systematic errors", (systematics(result),), brief=False),
        ),
        warnings=(*result.warnings, *_unconverged(result)),
        notes=_notes(result),
        title=f"{throws}: {result.law} law",
        settings=(settings_of(result.throws[0]) if result.throws else {})
        | {"Data": ", ".join(_files(result)), "Sigma": "", "In common": ", ".join(result.share)},
        command=_command(result),
        names=result.throws[0].parameters if result.throws else result.coefficients,
    )  # fmt: skip


def _unconverged(result: JointResult) -> list[str]:
    if result.r_hat is None or result.r_hat < _R_HAT:
        return []
    return [f"the posterior of the spreads has not converged (R-hat {result.r_hat:.3f})"]


def _shared(result: JointResult) -> PlainTable:
    differences = {item.expression: item for item in result.variation}
    heading = "~spread between throws" if result.varies else "~differs between throws"
    items: dict[str, Any] = {one.expression: one for one in result.combinations}
    return PlainTable(
        (
            estimate_cells(name, item, result.systematics, "shared")
            | {heading: _said(differences.get(name), result.varies)}
            for name, item in (result.coefficients | items).items()
        ),
        f"{'Means of the throws' if result.varies else 'What the throws have in common'}, with "
        "standard errors",
    )


def effect_lines(result: JointResult) -> list[str]:
    """A draw to the tee, and what groups and trends do to it, in sentences."""
    of_all = {one.parameter: one for one in result.groups if not one.by}
    if not of_all:
        return []
    friction = of_all["friction"]
    found = [
        f"A draw to the tee: mean friction {compact(friction.value, friction.stderr)}, "
        + ", ".join(
            f"{said} {compact(of_all[name].value, of_all[name].stderr)} {unit}"
            for name, (said, *_, unit) in _WORDS.items()
            if name in of_all
        )
        + "."
    ]
    effects = [*result.differences, *result.trend]
    for about in dict.fromkeys((one.by, one.group, one.against) for one in effects):
        by, group, against = about
        mine = {one.parameter: one for one in effects if (one.by, one.group, one.against) == about}
        per = mine["friction"].unit.partition("/")[2]
        along = f"Per {per or 'unit'}" + f" of {by}" * (by != per)
        head = f"{by} {group} against {against}" if group else along
        first = mine["friction"]
        percent = (100 * abs(value) / friction.value for value in (first.value, first.stderr))
        parts = [f"friction {compact(*percent)} % {'higher' if first.value > 0 else 'lower'}"]
        for name, (said, more, less, unit) in _WORDS.items():
            if (one := mine.get(name)) is None:
                continue
            word = more if one.value > 0 else less
            parts.append(f"{said} {compact(abs(one.value), one.stderr)} {unit} {word}")
        chance = [name for name, one in mine.items() if name in _DRAWN and (one.p or 0) > _CHANCE]
        within = f" ({join_words(chance)} within the errors)".replace("_", " ") if chance else ""
        found.append(f"{capital(head)}: {', '.join(parts)}{within}.")
    return found


def _effects(result: JointResult) -> PlainTable:
    rows = []
    for one in [*result.groups, *result.differences, *result.trend]:
        if one.parameter in _DRAWN or not one.by:
            continue
        what = f"{one.by} {one.group}".strip() + (f" - {one.against}" if one.against else "")
        value, error = format_estimate(one.value, one.stderr)
        rows.append(
            {"": what, "quantity": labelled(one.parameter, one.unit), ">estimate": value}
            | {">std. error": error, "p": "" if one.p is None else p_text(one.p)}
            | _posterior(one.quantiles)
        )
    rows += [
        {"": "between throws", "quantity": item.expression, ">estimate": two_digits(item.spread)}
        | _posterior(item.quantiles)
        for item in result.variation
        if item.quantiles
    ]
    return PlainTable(rows, "Groups and trends")


def _posterior(quantiles: Quantiles) -> dict[str, str]:
    return {"68 % of posterior": from_to(quantiles["16"], quantiles["84"])} if quantiles else {}


def _said(item: Variation | None, varies: bool) -> Text | str:
    if item is None:
        return ""
    if varies:
        share = f", {abs(100 * item.spread / item.mean):.2g} %" if item.mean and item.spread else ""
        return f"{item.spread:.2g}{share} ({item.p_text})"
    if not item.significant:
        return Text(f"no ({item.p_text})", style="green")
    return Text(
        f"yes ({item.p_text}): spread {item.spread:.2g}, mean {compact(item.mean, item.stderr)}",
        style="yellow",
    )


def _throws(result: JointResult) -> PlainTable:
    if not result.throws:
        return PlainTable([])
    first = result.throws[0]
    own = [
        name
        for name, item in first.parameters.items()
        if name not in (*result.share, *_HIDDEN) and item.verdict != "fixed"
    ]
    rows = []
    for place, one in enumerate(result.throws):
        row = {"throw": Path(one.data["file"]).name}
        for name in own:
            item = one.parameters[name]
            row[f">{name}"] = format_estimate(item.value, item.stderr)[0]
        for difference in result.variation:
            alone = difference.each[place]
            row[f">{difference.expression} alone"] = "" if alone is None else compact(*alone)
        for name in first.rms:
            rms = one.rms.get(name)
            row[f">{name}\n(m{UNITS[name]})"] = "" if rms is None else f"{1000 * rms:.3g}"
        rows.append(row)
    return PlainTable(rows, "Each throw, with what it says alone")


def _notes(result: JointResult) -> list[str]:
    """Remarks of the reader on all throws."""
    if result.table is not None:
        return [*result.table.notes, _FIRST_ORDER]
    first, *others = (one.data["notes"] for one in result.throws)
    return [note for note in first if all(note in one for one in others)]


def _files(result: JointResult) -> list[str]:
    """The files of the throws, each once."""
    if result.table is not None:
        return [result.table.file]
    return list(dict.fromkeys(map(file_of, result.throws)))


def _command(result: JointResult) -> str:
    """The command of a joint fit: with the flags that all throws have in common."""
    first, *others = [one.data.get("flags", ()) for one in result.throws] or [()]
    flags = [flag for flag in first if all(flag in one for one in others)]
    if result.throws and tuple(result.share) != tuple(result.throws[0].coefficients):
        flags.append("--share=" + ",".join(result.share))
    elif not result.varies:
        flags.append("--share=all")
    else:
        assert result.means is not None
        flags += [f"--by={name}" for name in result.means.groups]
        flags += [f"--trend={name}" for name in result.means.trends]
    return command_line("fit", *_files(result), *with_derived(flags, result))
