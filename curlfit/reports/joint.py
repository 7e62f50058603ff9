"""What a joint fit says. Nothing is computed here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
    throws = f"{result.count} throws together"
    effects = effect_lines(result)
    odd = " ".join(odd_rows_in_words(result.odd_rows))
    differing = ", ".join(
        variation.expression
        for variation in result.variation
        if variation.significant and not result.varies
    )
    all_determined = result.rank >= result.parameters
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
            f"Differs between throws: {differing}." if differing else "",
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
                "What the throws determine"
                if all_determined
                else "What the throws do not determine",
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
    """Shared coefficients and combinations, and how they vary between throws."""
    variations = {variation.expression: variation for variation in result.variation}
    heading = "~spread between throws" if result.varies else "~differs between throws"
    combinations: dict[str, Any] = {
        combination.expression: combination for combination in result.combinations
    }
    errors = result.systematics.errors
    rows = []
    for name, estimate in (result.coefficients | combinations).items():
        row = row_of("shared", name, estimate, errors.get(name))
        row[heading] = ""
        if name in variations:
            row[heading] = _variation_in_words(variations[name], result.varies)
        rows.append(row)
    what = "Means of the throws" if result.varies else "What the throws have in common"
    return PlainTable(rows, f"{what}, with standard errors")


def _variation_in_words(variation: Variation, varies: bool) -> Text | str:
    """How a coefficient varies between throws; `varies`, whether the fit lets it."""
    p = variation.p_text
    spread = f"{variation.spread:.2g}"
    if varies:
        if variation.mean and variation.spread:
            percent = abs(100 * variation.spread / variation.mean)
            spread += f", {percent:.2g} %"
        return f"{spread} ({p})"
    if not variation.significant:
        return Text(f"no ({p})", style="green")
    mean = compact(variation.mean, variation.stderr)
    return Text(f"yes ({p}): spread {spread}, mean {mean}", style="yellow")


def effect_lines(result: JointResult) -> list[str]:
    """A draw to the tee, and what groups and trends do to it, in sentences."""
    means = {effect.parameter: effect for effect in result.groups if not effect.by}
    if not means:
        return []
    friction = means["friction"]
    parts = [f"mean friction {compact(friction.value, friction.stderr)}"]
    for name, (words, *_, unit) in _WORDS.items():
        if name in means:
            size = compact(means[name].value, means[name].stderr)
            parts.append(f"{words} {size} {unit}")
    sentences = [f"A draw to the tee: {', '.join(parts)}."]
    effects_by_subject: dict[tuple[str, str, str], dict[str, Effect]] = {}
    trends = () if result.slopes else result.trend
    for effect in (*result.differences, *trends, *result.slopes):
        subject = (effect.along, effect.by, effect.group)
        effects_by_subject.setdefault(subject, {})[effect.parameter] = effect
    for effects in effects_by_subject.values():
        sentences.append(_effects_in_words(effects, friction.value))
    return [*sentences, *_alike_slopes(result)]


def _effects_in_words(effects: Mapping[str, Effect], mean_friction: float) -> str:
    """A sentence on what a group or a trend does to a draw to the tee.

    Parameters
    ----------
    effects : by name of what is drawn.
    """
    of_friction = effects["friction"]
    by = of_friction.by
    group = of_friction.group
    if of_friction.along or not group:
        trend = of_friction.along or by
        per = of_friction.unit.partition("/")[2] or "unit"
        subject = f"Per {per}"
        if trend != per:
            subject += f" of {trend}"
        if group:
            subject += f" on {by} {group}"
    else:
        subject = f"{capital(by)} {group} against {of_friction.against}"
    change = 100 * abs(of_friction.value) / mean_friction
    percent = compact(change, 100 * abs(of_friction.stderr) / mean_friction)
    parts = [f"friction {percent} % {'higher' if of_friction.value > 0 else 'lower'}"]
    for name, (words, more, less, unit) in _WORDS.items():
        if effect := effects.get(name):
            size = compact(abs(effect.value), effect.stderr)
            parts.append(f"{words} {size} {unit} {more if effect.value > 0 else less}")
    by_chance = [
        words
        for name, (words, *_) in _DRAWN.items()
        if name in effects and (effects[name].p or 0) > _CHANCE
    ]
    within = f" ({join_words(by_chance)} within the errors)" if by_chance else ""
    return f"{subject}: {', '.join(parts)}{within}."


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
    """Groups and trends in what varies, and the spreads if they were sampled."""
    rows = []
    trend_by = () if result.means is None else result.means.trend_by
    effects = [*result.groups, *result.differences, *result.trend, *result.slopes]
    effects += [effect for effect in result.slope_differences if effect.by in trend_by]
    for effect in effects:
        if effect.parameter in _DRAWN or not effect.by:
            continue
        subject = f"{effect.by} {effect.group}".strip()
        if effect.against:
            subject += f" - {effect.against}"
        if effect.along:
            subject += f", {effect.along}"
        value, error = format_estimate(effect.value, effect.stderr)
        row = {
            "": subject,
            "quantity": labelled(effect.parameter, effect.unit),
            ">estimate": value,
            ">std. error": error,
            "p": "" if effect.p is None else p_text(effect.p),
        }
        rows.append(row | of_posterior(effect.quantiles))
    for variation in result.variation:
        if variation.quantiles:
            row = {
                "": "between throws",
                "quantity": variation.expression,
                ">estimate": two_digits(variation.spread),
            }
            rows.append(row | of_posterior(variation.quantiles))
    return PlainTable(rows, "Groups and trends")


def _throws(result: JointResult) -> PlainTable:
    """Each throw's own parameters, what it says alone, and its residuals."""
    rows = []
    for number, throw in enumerate(result.throws):
        row = {"throw": Path(throw.data["file"]).name}
        for name, estimate in throw.parameters.items():
            if name not in (*result.share, *_HIDDEN) and estimate.verdict.is_free:
                row[f">{name}"] = format_estimate(estimate.value, estimate.stderr)[0]
        for variation in result.variation:
            alone = variation.each[number]
            heading = f">{variation.expression} alone"
            row[heading] = "" if alone is None else compact(*alone)
        for name, rms in throw.rms.items():
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
    flags = _of_all([throw.data.get("flags", ()) for throw in result.throws])
    if result.throws and tuple(result.share) != tuple(result.throws[0].coefficients):
        flags.append("--share=" + ",".join(result.share))
    elif result.means is None:
        flags.append("--share=all")
    else:
        flags += [f"--by={name}" for name in result.means.groups]
        flags += [f"--trend={name}" for name in result.means.trends]
        flags += [f"--trend-by={name}" for name in result.means.trend_by]
    return command_line("fit", *_files(result), *with_derived(flags, result))
