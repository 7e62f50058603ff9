"""What a fit says, made from a `FitResult` alone; nothing is computed here."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.text import Text

from curlfit.foreign import counted, file_and_number
from curlfit.inference.derived.quantiles import Quantiles
from curlfit.inference.derived.quantity import Derived, scaled, to_its_side
from curlfit.inference.fit.entries import FittedEvent
from curlfit.inference.fit.estimate_columns import (
    NAME,
    POSTERIOR,
    STDERR,
    SYSTEMATIC,
    VALUE,
    EstimateRow,
)
from curlfit.inference.information.verdict import Verdict
from curlfit.inference.model.parameters import START
from curlfit.losses import LOSSES
from curlfit.output.document import Document, Section, command_line, show
from curlfit.output.table import Column, Table
from curlfit.output.text import stone_text
from curlfit.reports import posterior
from curlfit.reports.determined import sentences_on
from curlfit.reports.estimates import (
    about,
    derived_table,
    estimates_table,
    lines_of,
    reported,
    style_of,
    systematics,
)
from curlfit.sheet import FOOT
from curlfit.stone import UNITS as UNIT, Stone
from curlfit.throws.channels import UNITS
from curlfit.wording import (
    capital,
    compact,
    decimals,
    format_estimate,
    join_words,
    lower,
    two_digits,
)

if TYPE_CHECKING:
    from curlfit.inference.fit.estimates import Estimate
    from curlfit.inference.fit.result import FitResult
    from curlfit.inference.information.combinations import Combination
    from curlfit.throws.reference import Reference

_MOST_NAMED = 6  # outliers that the report lists
_UNFINISHED = (
    "Sampling is unfinished; repeat the `curlfit fit` command with "
    "--resume to continue it."
)
_FEW = 30.0  # degrees of freedom from which Student's t is Gaussian to within 4 %


def print_fit(fit: FitResult, console: Console | None = None) -> None:
    """Print the report of a fit.

    Examples
    --------
    >>> curlfit.print_fit(fit)
    front-back law, uniform load, fitted to ...
    """
    show(document(fit), console)


def document(fit: FitResult) -> Document:
    """What a fit says."""
    hidden = any(
        parameter.verdict.is_left_open or parameter.verdict == Verdict.AT_BOUND
        for parameter in fit.parameters.values()
    )
    unfinished = None
    if fit.sampling == "unfinished":
        unfinished = Text(_UNFINISHED, style="bold yellow")
    sections = (
        Section(
            "coefficients",
            "Coefficients",
            (
                _estimates(fit),
                _few_values(fit),
                derived_table(
                    [_with_settled(fit, quantity) for quantity in fit.all_derived]
                ),
            ),
        ),
        Section("path", "The path", (_quantities(fit), _draw(fit))),
        Section(
            "quality",
            "Systematic errors and residuals",
            (systematics(fit), _beside_reference(fit), _quality(fit), _events(fit)),
            brief=False,
        ),
        Section(
            "determined",
            f"What the path {'does not determine' if hidden else 'determines'}",
            (sentences_on(fit),),
        ),
        Section("posterior", "The posterior", (_posterior(fit), unfinished)),
        Section("outliers", "Outliers", (outliers(fit),), brief=False),
    )
    loss = LOSSES[fit.loss].suffix
    noise = fit.noise.suffix
    file = fit.data.file
    numbers = lines_of(fit)
    quantities = quantities_line(fit)
    return Document(
        finding=lower(fit.status),
        style=style_of(fit),
        subject=Text.assemble(
            (f"{fit.law} law", "bold"),
            f", {fit.load} load{loss}{noise}, fitted to {file}",
        ),
        about=(
            f"{extent(fit)}; stone {stone_text(fit.stone)}",
            *about(fit, fit.warnings, capital(quantities) or numbers[0]),
        ),
        lines=[*numbers, quantities],
        sections=sections,
        warnings=fit.warnings,
        notes=fit.data.notes,
        title=f"{Path(file).name}: {fit.law} law",
        settings=settings_of(fit),
        command=command_of(fit),
        names=fit.parameters,
    )


def extent(fit: FitResult) -> str:
    """Number of data, and the time that they span."""
    parts = [fit.data.in_words]
    if fit.events:
        parts.append(f"{counted(len(fit.events), 'event')} at lines and at rest")
    return "; ".join(filter(None, parts))


def _estimates(fit: FitResult) -> Table[EstimateRow]:
    """Coefficients, determined combinations, initial state and conditions, in this
    order, beside the posterior and a reference."""
    quantiles: Mapping[str, Quantiles] = {}
    if fit.posterior is not None and fit.posterior.converged:
        quantiles = fit.posterior.quantiles
    estimates: dict[str, Estimate | Combination] = {}
    for name, parameter in fit.parameters.items():
        if name == START[0].name:
            for combination in fit.combinations:
                estimates[combination.expression] = combination
        estimates[name] = parameter
    errors = fit.systematics.errors
    rows = [
        EstimateRow.of(name, estimate, errors.get(name), quantiles.get(name))
        for name, estimate in estimates.items()
    ]
    table = estimates_table("parameter", rows, "Estimates with standard errors")
    if fit.reference is None:
        return table
    return replace(table, columns=[*table.columns, _published(fit.reference)])


def _published(reference: Reference) -> Column[EstimateRow]:
    """The column of the values of a reference."""

    def value(row: EstimateRow) -> float | None:
        weights = getattr(row.estimate, "weights", {row.name: 1.0})
        return reference.of(row.name, weights)

    return Column(reference.source, value, "g", missing="", right=True)


def _few_values(fit: FitResult) -> str:
    """How far intervals of 95 % extend where sigma was estimated from few values."""
    degrees = [
        estimate.dof
        for estimate in (*fit.coefficients.values(), *fit.combinations)
        if estimate.stderr and estimate.dof
    ]
    fewest = min(degrees, default=math.inf)
    if fewest >= _FEW:
        return ""
    from scipy.special import stdtrit

    text = (
        "Sigma is estimated from few values: an interval of 95 % (Student's t) "
        f"extends up to {stdtrit(fewest, 0.975):.2f} standard errors to each side, "
        f"with {fewest:.0f} degrees of freedom."
    )
    if fit.posterior is not None:
        text += (
            " The posterior holds sigma fixed; its intervals are "
            "correspondingly too narrow."
        )
    return text


def _with_settled(fit: FitResult, quantity: Derived) -> Derived:
    """A quantity, without its quantiles if the sample has not converged."""
    if fit.posterior is None or fit.posterior.converged:
        return quantity
    return replace(quantity, quantiles={})


def _quantities(fit: FitResult) -> Table[EstimateRow]:
    """Quantities of the fitted path within the record; with a model discrepancy, of the
    path of the law without it."""
    heading = "along the fitted path"
    caption = "Along the fitted path"
    if fit.noise.sizes:
        heading = "along the path of the law"
        caption = "Along the path of the law, without the discrepancy"
    quantities = []
    for name, signed in fit.quantities.items():
        quantity = to_its_side(_with_settled(fit, signed))
        quantities.append(quantity)
        if name == "curl":
            quantities.append(scaled(replace(quantity, unit="ft"), 1 / FOOT))
    rows = [EstimateRow.of(quantity.meaning, quantity) for quantity in quantities]
    columns = (NAME.but(heading=heading), VALUE, STDERR, SYSTEMATIC, POSTERIOR)
    return Table(rows, columns, caption)


def _draw(fit: FitResult) -> str:
    """Time and curl of a draw, as curlers state them: "24.5 s / 4.0 ft"."""
    draw_time = fit.quantities.get("draw_time")
    curl = fit.quantities.get("curl")
    if draw_time is None or curl is None:
        return ""
    return (
        f"{draw_time.value:.1f} s / {abs(curl.value) / FOOT:.1f} ft: time of the draw "
        "from the near hog line, and its curl."
    )


def quantities_line(fit: FitResult) -> str:
    """The main quantities of the path in one line."""
    parts = []
    for name in ("friction", "curl", "turns", "hog_to_hog"):
        if name not in fit.quantities:
            continue
        quantity = to_its_side(fit.quantities[name])
        name_of_quantity, _, _ = quantity.meaning.partition(",")
        unit = "" if quantity.unit in ("", "1") else f" {quantity.unit}"
        value = compact(quantity.value, quantity.stderr)
        parts.append(f"{name_of_quantity} {value}{unit}")
    return ", ".join(parts)


@dataclass(frozen=True)
class _Refitted:
    """A parameter that was published, and its estimates.

    Attributes
    ----------
    name : of the parameter, or the expression of a combination.
    value, stderr : of the fit.
    refitted : values fitted with other constants of the stone, first with those on
        which the published value is based.
    published : the value of the reference.
    """

    name: str
    value: float
    stderr: float | None
    refitted: Sequence[float]
    published: float

    @property
    def shifts(self) -> list[float]:
        """By how much the values fitted again differ from that of the fit."""
        return [value - self.value for value in self.refitted]

    @property
    def agrees(self) -> bool:
        """Whether the first value fitted again is the published one, within the
        rounding of its digits and of the constants."""
        rounding = 0.5 * 10.0 ** -_decimal_places(self.published)
        tolerance = rounding + sum(map(abs, self.shifts[1:]))
        return abs(self.refitted[0] - self.published) <= tolerance


def _beside_reference(fit: FitResult) -> Table[_Refitted] | None:
    """How the estimates change with the constants of the stone that a reference is
    based on, and whether they then agree with it."""
    reference = fit.reference
    refits = fit.reference_fits
    if reference is None or not refits:
        return None
    rows = [
        _Refitted(
            name,
            value,
            stderr,
            [refit.values[name] for refit in refits],
            reference.values[name],
        )
        for name, (value, stderr) in reported(fit).items()
        if name in reference.values and all(name in refit.values for refit in refits)
    ]
    if not rows:
        return None
    based_on = refits[0]["stone"]
    constants = ", ".join(
        f"{constant} = {value:g} {UNIT[constant]}"
        for constant, value in based_on.items()
    )
    digits = max(map(_decimal_places, reference.values.values()))
    columns: list[Column[_Refitted]] = [
        Column("refitted parameter", key="name"),
        Column(
            "std. error",
            words=lambda row: format_estimate(row.value, row.stderr)[1],
            right=True,
            key="stderr",
        ),
    ]
    for index, refit in enumerate(refits):
        changes = _changes(refit.stone, fit.stone)
        columns.append(_shift_column(f"shift, {changes}", index, digits + 1))
    columns += [
        Column(
            f"with {constants}", lambda row: row.refitted[0], f".{digits}f", right=True
        ),
        Column(reference.source, format="g", right=True, key="published"),
    ]
    verdict = f"which do not all agree with {reference.source}"
    if all(row.agrees for row in rows):
        verdict = (
            f"which agree with {reference.source} within the rounding of its digits "
            "and of the stone's constants"
        )
    option = ",".join(f"{constant}={value:g}" for constant, value in based_on.items())
    text = f"{reference.source}: {reference.note}. " if reference.note else ""
    values = join_words([f"{row.refitted[0]:.{digits}f}" for row in rows])
    text += f"`--stone {option}` gives {values}, {verdict}."
    caption = "Shift of the estimates with the constants of the stone"
    return Table(rows, columns, caption, note=Text(text))


def _shift_column(heading: str, index: int, digits: int) -> Column[_Refitted]:
    """The column of the shifts in one of the refits, to some decimal places."""

    def in_words(shift: float) -> str:
        rounded = round(shift, digits) + 0.0  # no minus before a zero
        return f"{rounded:+.{digits}f}"

    return Column(heading, lambda row: row.shifts[index], in_words, right=True)


def _changes(constants: Mapping[str, float], stone: Stone) -> str:
    """By how much constants differ from those of a stone, as "rho +0.0025 m"."""
    present = stone.as_dict()
    return ", ".join(
        f"{constant} {value - present[constant]:+g} {UNIT[constant]}"
        for constant, value in constants.items()
    )


def _decimal_places(value: float) -> int:
    """Decimal places of a published number."""
    return len(f"{value:g}".partition(".")[2])


def _quality(fit: FitResult) -> Table[str]:
    """Size and correlation of the residuals, and the noise assumed, by channel."""
    columns: list[Column[str]] = [
        Column("channel", lambda channel: channel),
        Column("rms", lambda channel: fit.rms[channel], ".3g", right=True),
        Column("unit", lambda channel: UNITS[channel]),
        Column("noise assumed", lambda channel: _sigma(fit, channel)),
        Column("", lambda channel: fit.data.sigma[channel]),
        Column("lag-1 correlation", fit.lag1.get, ".2f", missing=""),
    ]
    if not fit.noise.is_white:
        columns += [
            Column("noise model", fit.noise.words),
            Column(
                "lag-1 after whitening",
                fit.independence.get,
                lambda whitened: f"{whitened.lag1:.2f}",
                missing="",
            ),
        ]
    return Table(list(fit.rms), columns, "Residuals by channel")


def _sigma(fit: FitResult, channel: str) -> str:
    """The noise of a channel with its unit, as "0.005 to 0.02 m" if it was given by
    row."""
    if fit.data.sigma[channel] != "estimated":
        return "by row"
    by_row = fit.observed.get(f"sigma_{channel}")
    largest = "" if by_row is None else f" to {by_row.max():.3g}"
    return f"{fit.sigma[channel]:.3g}{largest} {UNITS[channel]}"


def _in_digits(event: FittedEvent, value: float) -> str:
    """A value with the digits that sigma allows, two decimal places or more."""
    return f"{value:.{max(decimals(event.sigma), 2)}f}"


_EVENT_COLUMNS: tuple[Column[FittedEvent], ...] = (
    Column("measured", key="name"),
    Column("value", words=lambda event: _in_digits(event, event.value), right=True),
    Column("sigma", format=".2g", right=True),
    Column("unit", lambda event: event.event.unit),
    Column(
        "fit",
        words=lambda event: _in_digits(event, event.fitted),
        right=True,
        key="fitted",
    ),
    Column(
        "measured - fit",
        lambda event: event.residual + 0.0,  # no minus before a zero
        lambda residual: f"{residual:.1f} sigma",
        right=True,
    ),
)


def _events(fit: FitResult) -> Table[FittedEvent]:
    """Values measured at lines and at rest, with the fitted ones."""
    return Table(fit.events, _EVENT_COLUMNS, "Timed events")


def outliers(fit: FitResult) -> str:
    """The values far from the fit, by channel and time, the farthest first."""
    if not fit.outliers:
        return ""
    parts = []
    for outlier in fit.outliers[:_MOST_NAMED]:
        channel = outlier.channel
        line = "" if outlier.line is None else f" (line {outlier.line})"
        parts.append(
            f"{channel} at {outlier.t:g} s{line} by {outlier.off:.3g} "
            f"{UNITS[channel]} ({two_digits(outlier.sigmas)} robust sigma)"
        )
    more = len(fit.outliers) - len(parts)
    if more:
        parts.append(f"and {more} more (all in fit.json)")
    return f"Outliers: {'; '.join(parts)}."


def _posterior(fit: FitResult) -> Text | None:
    """How the posterior was sampled, and how well."""
    if fit.posterior is None:
        return None
    return Text.assemble(
        "Posterior: ",
        (fit.posterior.status, posterior.style(fit.posterior)),
        f"; {posterior.sampled(fit.posterior)}",
    )


def settings_of(fit: FitResult) -> dict[str, str]:
    """The settings of a fit, by name; empty where it has none of a kind."""
    held = {
        name: f"= {parameter.value:g}"
        for name, parameter in fit.parameters.items()
        if parameter.verdict == Verdict.FIXED
    }
    priors = {
        name: parameter.prior
        for name, parameter in fit.parameters.items()
        if parameter.prior
    }
    bounds = {
        name: f"{coefficient.lower:g} .. {coefficient.upper:g}"
        for name, coefficient in fit.coefficients.items()
        if name not in held
    }
    sigmas = {
        channel: f"{_sigma(fit, channel)} ({fit.data.sigma[channel]})"
        for channel in fit.rms
    }
    uncertainties = {
        condition: f"{width:g}"
        for condition, width in fit.systematics.settings.items()
        if width
    }
    settings = {
        "Law, load": f"{fit.law}, {fit.load}",
        "Data": f"{fit.data.file}, {fit.data.in_words or 'timed events alone'}",
        "Stone": stone_text(fit.stone),
        "Loss, noise": f"{fit.loss}, {fit.noise.kind}",
        "Sigma": _listed(sigmas),
        "Held": _listed(held),
        "Priors": _listed(priors),
        "Bounds": _listed(bounds),
        "Standard uncertainty of what is held": _listed(uncertainties),
    }
    if fit.posterior is not None:
        settings["Posterior"] = (
            f"{fit.posterior.samples} samples, {fit.posterior.walkers} walkers, "
            f"{fit.posterior.steps} steps, seed {fit.posterior.seed}"
        )
    return settings


def _listed(texts: Mapping[str, str]) -> str:
    """Texts by name in one line."""
    return ", ".join(f"{name} {text}" for name, text in texts.items())


def command_of(fit: FitResult) -> str:
    """The command that makes a fit."""
    words = [file_of(fit), *with_derived(fit.data.flags, fit)]
    if fit.posterior is not None:
        words.append(f"--seed={fit.posterior.seed}")
    elif fit.sampling == "none":
        words.append("--no-sample")
    return command_line("fit", *words)


def with_derived(flags: Sequence[str], result: Any) -> list[str]:
    """Flags of a command, each once, with those of quantities that were derived
    later."""
    derived = [f"--derive={quantity.expression}" for quantity in result.derived]
    return list(dict.fromkeys([*flags, *derived]))


def file_of(fit: FitResult) -> str:
    """The file of a throw, from a name that may include a row of the file."""
    return file_and_number(str(fit.data.file))[0]
