"""What a joint fit says. Nothing is computed here."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from rich.console import Console
from rich.text import Text

from curlfit.findings import Finding
from curlfit.inference.derived.quantiles import Quantiles
from curlfit.inference.fit.estimate_columns import (
    POSTERIOR,
    STDERR,
    VALUE,
    EstimateRow,
    interval_in_words,
)
from curlfit.inference.together.effects import SLOPES_DIFFER, chances_of_alike_slopes
from curlfit.losses import LOSSES
from curlfit.output.document import Document, Section, command_line, show
from curlfit.output.table import Column, Table
from curlfit.output.text import labelled
from curlfit.reports.estimates import (
    about,
    derived_table,
    estimates_table,
    lines_of,
    style_of,
    systematics,
)
from curlfit.reports.fit import file_of, settings_of, with_derived
from curlfit.throws.channels import UNITS
from curlfit.throws.odd_row import odd_rows_in_words
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
    from curlfit.inference.fit.estimates import Estimate
    from curlfit.inference.fit.result import FitResult
    from curlfit.inference.together.effects import Effect
    from curlfit.inference.together.result import JointResult, Variation


class _Words(NamedTuple):
    """Words for a quantity of a draw, for a change of it, and the unit of this."""

    noun: str
    more: str
    less: str
    unit: str


_OF_A_DRAW = {
    "friction": _Words("friction", "higher", "lower", "%"),
    "curl": _Words("curl", "more", "less", "m"),
    "hog_to_hog": _Words("hog to hog", "longer", "shorter", "s"),
}
_CHANCE = 0.05  # probability above which an effect is within the errors
_R_HAT = 1.05  # of a sample that ended without the 1.01 that it aims at
_HIDDEN = ("x0", "y0", "phi0", "heading")
_Entry = TypeVar("_Entry")


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
    count = f"{result.count} throws together"
    effects = effect_lines(result)
    odd_rows = " ".join(odd_rows_in_words(result.odd_rows))
    differing = ", ".join(
        variation.expression for variation in result.variation if variation.significant
    )
    differs = ""
    if differing and not result.varies:
        differs = f"Differs between throws: {differing}."
    rank = result.identifiability.rank
    free = result.identifiability.parameters
    hidden = rank < free
    determined = f"The throws determine {rank} of {free} parameters."
    warnings = list(result.warnings)
    if result.r_hat is not None and result.r_hat >= _R_HAT:
        warnings.append(Finding.warning("spreads-not-converged", r_hat=result.r_hat))
    sections = (
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
            f"What the throws {'do not determine' if hidden else 'determine'}",
            (determined,),
        ),
        Section("quality", "Systematic errors", (systematics(result),), brief=False),
    )
    settings = {}
    names: Collection[str] = result.coefficients
    model = f"{result.load} load"
    if result.throws:
        first = result.throws[0]
        settings = settings_of(first)
        names = first.parameters
        model += LOSSES[first.loss].suffix + first.noise.suffix
    settings["Data"] = ", ".join(_files(result))
    settings["Sigma"] = ""
    settings["In common"] = ", ".join(result.share)
    return Document(
        finding=lower(result.status),
        style=style_of(result),
        subject=f"{result.law} law, {model}, {count}",
        headline=Text.assemble(
            (f"{result.law} law", "bold"),
            f", {model}, {count}; shared: {', '.join(result.share)}",
        ),
        about=about(result, result.warnings, odd_rows),
        lines=[odd_rows, *effects, *lines_of(result), differs],
        sections=sections,
        warnings=warnings,
        notes=_notes(result),
        title=f"{count}: {result.law} law",
        settings=settings,
        command=_command(result),
        names=names,
    )


def _shared(result: JointResult) -> Table[EstimateRow]:
    """What the throws have in common or, where they vary, their means, and how they
    differ."""
    variations = {variation.expression: variation for variation in result.variation}
    heading = "differs between throws"
    caption = "What the throws have in common, with standard errors"
    if result.varies:
        heading = "spread between throws"
        caption = "Means of the throws, with standard errors"
    estimates: dict[str, Any] = dict(result.coefficients)
    for combination in result.combinations:
        estimates[combination.expression] = combination
    errors = result.systematics.errors
    rows = [
        EstimateRow.of(name, estimate, errors.get(name))
        for name, estimate in estimates.items()
    ]
    differs: Column[EstimateRow] = Column(
        heading,
        lambda row: variations.get(row.name),
        lambda variation: _differs(variation, result.varies),
        missing="",
        wraps=True,
    )
    table = estimates_table("shared", rows, caption)
    return replace(table, columns=[*table.columns, differs])


def _differs(variation: Variation, varies: bool) -> Text | str:
    """How a coefficient varies between throws, in the cell of a table."""
    spread = f"{variation.spread:.2g}"
    if varies:
        if variation.mean and variation.spread:
            percent = abs(100 * variation.spread / variation.mean)
            spread += f", {percent:.2g} %"
        return f"{spread} ({variation.p_text})"
    if not variation.significant:
        return Text(f"no ({variation.p_text})", style="green")
    mean = compact(variation.mean, variation.stderr)
    text = f"yes ({variation.p_text}): spread {spread}, mean {mean}"
    return Text(text, style="yellow")


def effect_lines(result: JointResult) -> list[str]:
    """Sentences on a draw to the tee: its friction, curl and time, what groups and
    trends change in them, and which labels have groups that change alike; none of
    throws without a draw."""
    draw = {effect.parameter: effect for effect in result.groups if not effect.by}
    if not draw:
        return []
    friction = draw["friction"]
    parts = [f"mean friction {compact(friction.value, friction.stderr)}"]
    for name in ("curl", "hog_to_hog"):
        if name in draw:
            words = _OF_A_DRAW[name]
            size = compact(draw[name].value, draw[name].stderr)
            parts.append(f"{words.noun} {size} {words.unit}")
    sentences = [f"A draw to the tee: {', '.join(parts)}."]

    # effects of one group or trend: on friction, and on curl and time if measured
    trends = () if result.slopes else result.trend
    effects_by_cause: dict[tuple[str, str, str], dict[str, Effect]] = {}
    for effect in (*result.differences, *trends, *result.slopes):
        cause = (effect.along, effect.by, effect.group)
        effects_by_cause.setdefault(cause, {})[effect.parameter] = effect
    for effects in effects_by_cause.values():
        sentences.append(_effect_sentence(effects, friction.value))
    return [*sentences, *_alike_slopes(result)]


def _effect_sentence(effects: Mapping[str, Effect], mean_friction: float) -> str:
    """What a group or a trend changes of a draw, as "Sheet 2 against 1: friction 2.1(3)
    % higher, curl 0.12(5) m less.", from its effects by quantity."""
    parts = []
    by_chance = []
    for name, words in _OF_A_DRAW.items():
        if name not in effects:
            continue
        effect = effects[name]
        size = abs(effect.value)
        stderr = effect.stderr
        if name == "friction":  # in percent of the mean
            size = 100 * size / mean_friction
            stderr = 100 * stderr / mean_friction
        side = words.more if effect.value > 0 else words.less
        parts.append(f"{words.noun} {compact(size, stderr)} {words.unit} {side}")
        if (effect.p or 0) > _CHANCE:
            by_chance.append(words.noun)
    within = f" ({join_words(by_chance)} within the errors)" if by_chance else ""
    return f"{_cause(effects['friction'])}: {', '.join(parts)}{within}."


def _cause(effect: Effect) -> str:
    """The group or trend that has an effect: "Sheet 2 against 1", "Per h of start on
    sheet 2"."""
    if effect.group and not effect.along:
        return f"{capital(effect.by)} {effect.group} against {effect.against}"
    label = effect.along or effect.by
    unit = effect.unit.partition("/")[2] or "unit"
    text = f"Per {unit}"
    if label != unit:
        text += f" of {label}"
    if effect.group:
        text += f" on {effect.by} {effect.group}"
    return text


def _alike_slopes(result: JointResult) -> list[str]:
    """Sentences on labels whose groups change along the trends by slopes that differ no
    more than by chance."""
    chances = chances_of_alike_slopes(result.slope_differences)
    return [
        f"The slopes by {label} differ no more than by chance ({p_text(chance)})."
        for label, chance in chances.items()
        if chance >= SLOPES_DIFFER
    ]


@dataclass(frozen=True)
class _EffectRow:
    """What a group or a trend changes in a quantity, or the spread between throws, of
    which only the value is known besides its posterior.

    Attributes
    ----------
    cause : the group or trend.
    quantity : with its unit.
    value, stderr : in words.
    p : probability of a value at least as far from zero by chance.
    """

    cause: str
    quantity: str
    value: str
    quantiles: Quantiles
    stderr: str = ""
    p: float | None = None

    @classmethod
    def of(cls, effect: Effect) -> _EffectRow:
        """The row of an effect."""
        cause = f"{effect.by} {effect.group}".strip()
        if effect.against:
            cause += f" - {effect.against}"
        if effect.along:
            cause += f", {effect.along}"
        value, stderr = format_estimate(effect.value, effect.stderr)
        quantity = labelled(effect.parameter, effect.unit)
        return cls(cause, quantity, value, effect.quantiles, stderr, effect.p)


_EFFECT_COLUMNS: tuple[Column[_EffectRow], ...] = (
    Column("", key="cause"),
    Column("quantity"),
    Column(VALUE.heading, right=True, key="value"),
    Column(STDERR.heading, right=True, key="stderr"),
    Column("p", format=p_text, missing=""),
    Column(POSTERIOR.heading, format=interval_in_words, key="quantiles"),
)


def _effects(result: JointResult) -> Table[_EffectRow]:
    """What groups and trends change in each coefficient, with the posterior of the
    spreads between throws below."""
    effects = [*result.groups, *result.differences, *result.trend, *result.slopes]
    if result.means is not None:
        effects += [
            effect
            for effect in result.slope_differences
            if effect.by in result.means.trend_by
        ]
    rows = [
        _EffectRow.of(effect)
        for effect in effects
        if effect.by and effect.parameter not in _OF_A_DRAW
    ]
    for variation in result.variation:
        if variation.quantiles:
            rows.append(
                _EffectRow(
                    cause="between throws",
                    quantity=variation.expression,
                    value=two_digits(variation.spread),
                    quantiles=variation.quantiles,
                )
            )
    return Table(rows, _EFFECT_COLUMNS, "Groups and trends")


class _ThrowRow(NamedTuple):
    """A throw of a joint fit, and its number in the lists of all throws, from 0."""

    fit: FitResult
    number: int


def _throws(result: JointResult) -> Table[_ThrowRow]:
    """Each throw: its own parameters, what it alone says of those in common, and the
    size of its residuals."""
    own_names: dict[str, None] = {}
    channels: dict[str, None] = {}
    for throw in result.throws:
        for name, parameter in throw.parameters.items():
            if name not in (*result.share, *_HIDDEN) and parameter.verdict.is_free:
                own_names[name] = None
        channels |= dict.fromkeys(throw.rms)
    columns: list[Column[_ThrowRow]] = [
        Column("throw", lambda row: Path(row.fit.data.file).name),
        *map(_parameter_column, own_names),
        *map(_alone_column, result.variation),
        *map(_rms_column, channels),
    ]
    rows = [_ThrowRow(fit, number) for number, fit in enumerate(result.throws)]
    return Table(rows, columns, "Each throw, with what it says alone")


def _parameter_column(name: str) -> Column[_ThrowRow]:
    """The column of the estimates of a parameter of each throw's own."""

    def estimate(row: _ThrowRow) -> Estimate | None:
        parameter = row.fit.parameters.get(name)
        return parameter if parameter and parameter.verdict.is_free else None

    return Column(
        name,
        estimate,
        lambda parameter: format_estimate(parameter.value, parameter.stderr)[0],
        missing="",
        right=True,
    )


def _alone_column(variation: Variation) -> Column[_ThrowRow]:
    """The column of what each throw alone says of a shared parameter."""
    return Column(
        f"{variation.expression} alone",
        lambda row: variation.each[row.number],
        lambda alone: compact(*alone),
        missing="",
        right=True,
    )


def _rms_column(channel: str) -> Column[_ThrowRow]:
    """The column of the residuals in a channel, in mm or mrad."""

    def thousandths(row: _ThrowRow) -> float | None:
        rms = row.fit.rms.get(channel)
        return None if rms is None else 1000 * rms

    return Column(
        f"{channel}\n",
        thousandths,
        ".3g",
        unit=f"m{UNITS[channel]}",
        missing="",
        right=True,
    )


def _notes(result: JointResult) -> list[Finding]:
    """Notes of the reader on all throws."""
    if result.table is not None:
        return [*result.table.notes, Finding.note("quadratic-throws")]
    return _of_all([throw.data.notes for throw in result.throws])


def _of_all(lists: Sequence[Sequence[_Entry]]) -> list[_Entry]:
    """The items that are in all of some lists."""
    if not lists:
        return []
    first_list, *other_lists = lists
    return [
        entry
        for entry in first_list
        if all(entry in other_list for other_list in other_lists)
    ]


def _files(result: JointResult) -> list[str]:
    """The files of the throws, each once."""
    if result.table is not None:
        return [result.table.file]
    return list(dict.fromkeys(file_of(throw) for throw in result.throws))


def _command(result: JointResult) -> str:
    """The command of a joint fit, with the flags that all throws have in common."""
    flags = _of_all([throw.data.flags for throw in result.throws])
    if result.throws and tuple(result.share) != tuple(result.throws[0].coefficients):
        flags.append("--share=" + ",".join(result.share))
    elif result.means is None:
        flags.append("--share=all")
    else:
        flags += [f"--by={label}" for label in result.means.groups]
        flags += [f"--trend={label}" for label in result.means.trends]
        flags += [f"--trend-by={label}" for label in result.means.trend_by]
    return command_line("fit", *_files(result), *with_derived(flags, result))
