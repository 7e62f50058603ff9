"""What a fit says, made from a `FitResult` alone; nothing is computed here."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.text import Text

from curlfit.foreign import counted, file_and_number
from curlfit.inference.derived import Derived, Quantiles, scaled, to_its_side
from curlfit.inference.parameters import START
from curlfit.inference.verdict import Verdict
from curlfit.losses import LOSSES
from curlfit.output.console import PlainTable
from curlfit.output.document import Document, Section, command_line, show
from curlfit.output.text import rows_text, stone_text
from curlfit.reports import posterior
from curlfit.reports.determined import identifiability
from curlfit.reports.estimates import (
    about,
    derived_table,
    lines_of,
    reported,
    row_of,
    style_of,
    systematics,
)
from curlfit.sheet import FOOT
from curlfit.stone import UNITS as UNIT
from curlfit.throws.throw import UNITS
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
    from curlfit.inference.fit.result import FitResult

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
    data = fit.data
    loss = LOSSES[fit.loss].suffix
    noise = fit.noise.kind.suffix
    hidden = any(
        item.verdict.is_open or item.verdict == Verdict.AT_BOUND
        for item in fit.parameters.values()
    )
    unfinished = Text(_UNFINISHED * (fit.sampling == "unfinished"), style="bold yellow")
    numbers, line = lines_of(fit), quantities_line(fit)
    sections = (
        Section(
            "coefficients",
            "Coefficients",
            (
                _estimates(fit),
                _few_values(fit),
                derived_table([_shown(fit, item) for item in fit.all_derived]),
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
            (identifiability(fit),),
        ),
        Section("posterior", "The posterior", (_posterior(fit), unfinished)),
        Section("outliers", "Outliers", (outliers(fit),), brief=False),
    )
    return Document(
        finding=lower(fit.status),
        style=style_of(fit),
        subject=Text.assemble(
            (f"{fit.law} law", "bold"),
            f", {fit.load} load{loss}{noise}, fitted to {data['file']}",
        ),
        about=(
            f"{extent(fit)}; stone {stone_text(fit.stone)}",
            *about(fit, fit.warnings, capital(line) or numbers[0]),
        ),
        lines=[*numbers, line],
        sections=sections,
        warnings=fit.warnings,
        notes=data["notes"],
        title=f"{Path(data['file']).name}: {fit.law} law",
        settings=settings_of(fit),
        command=command_of(fit),
        names=fit.parameters,
    )


def extent(fit: FitResult) -> str:
    """Number of data, and the time that they span."""
    parts = [rows_text(fit.data)]
    if fit.events:
        parts.append(f"{counted(len(fit.events), 'event')} at lines and at rest")
    return "; ".join(filter(None, parts))


def _estimates(fit: FitResult) -> PlainTable:
    """The combinations stand between coefficients and initial state."""
    sampled: Mapping[str, Quantiles] = {}
    if fit.posterior is not None and fit.posterior.converged:
        sampled = fit.posterior.quantiles
    items: dict[str, Any] = {}
    for name, item in fit.parameters.items():
        if name == START[0].name:
            items |= {one.expression: one for one in fit.combinations}
        items[name] = item
    rows = []
    for name, item in items.items():
        row = row_of(
            "parameter", name, item, fit.systematics.errors.get(name), sampled.get(name)
        )
        if fit.reference is not None:
            known = fit.reference.of(name, getattr(item, "weights", {name: 1.0}))
            row[f">{fit.reference.source}"] = "" if known is None else f"{known:g}"
        rows.append(row)
    return PlainTable(rows, "Estimates with standard errors")


def _few_values(fit: FitResult) -> str:
    """How far intervals of 95 % extend where sigma was estimated from few values."""
    items = (*fit.coefficients.values(), *fit.combinations)
    degrees = min(
        (one.dof for one in items if one.stderr and one.dof), default=math.inf
    )
    if degrees >= _FEW:
        return ""
    from scipy.special import stdtrit

    text = (
        "Sigma is estimated from few values: an interval of 95 % (Student's t) "
        f"extends up to {stdtrit(degrees, 0.975):.2f} standard errors to each side, "
        f"with {degrees:.0f} degrees of freedom."
    )
    if fit.posterior is not None:
        text += (
            " The posterior holds sigma fixed; its intervals are "
            "correspondingly too narrow."
        )
    return text


def _shown(fit: FitResult, item: Derived) -> Derived:
    """A quantity without the quantiles of a sample that has not converged."""
    if fit.posterior is None or fit.posterior.converged:
        return item
    return replace(item, quantiles={})


def _quantities(fit: FitResult) -> PlainTable:
    """Quantities of the fitted path within the record, or of that of the law without
    the model discrepancy."""
    discrepancy, rows = bool(fit.noise.sizes), []
    along = f"along the {'path of the law' if discrepancy else 'fitted path'}"
    for name, item in fit.quantities.items():
        item = to_its_side(_shown(fit, item))
        units = [item, scaled(replace(item, unit="ft"), 1 / FOOT)][
            : 1 + (name == "curl")
        ]
        rows += [
            row_of(along, one.meaning, one, one.systematic, one.quantiles)
            | {"verdict": ""}
            for one in units
        ]
    return PlainTable(rows, capital(along) + ", without the discrepancy" * discrepancy)


def _draw(fit: FitResult) -> str:
    """Time and curl of a draw, as curlers state them."""
    known = fit.quantities
    if not {"draw_time", "curl"} <= known.keys():
        return ""
    time, curl = known["draw_time"].value, abs(known["curl"].value) / FOOT
    return (
        f"{time:.1f} s / {curl:.1f} ft: time of the draw from the near hog "
        "line, and its curl."
    )


def quantities_line(fit: FitResult) -> str:
    """The main quantities of the path in one line."""
    parts = []
    for name in ("friction", "curl", "turns", "hog_to_hog"):
        if item := fit.quantities.get(name):
            one = to_its_side(item)
            unit = "" if item.unit in ("", "1") else f" {item.unit}"
            parts.append(
                f"{one.meaning.partition(',')[0]} "
                f"{compact(one.value, one.stderr)}{unit}"
            )
    return ", ".join(parts)


def _beside_reference(fit: FitResult) -> PlainTable | None:
    """How the estimates vary with the stone's constants if those of a reference
    are rounded."""
    reference, fits, now = fit.reference, fit.reference_fits, fit.stone.as_dict()
    if reference is None or not fits:
        return None
    places = max(map(_places, reference.values.values()))
    first, agree = fits[0], True
    constants = ", ".join(
        f"{k} = {value:g} {UNIT[k]}" for k, value in first["stone"].items()
    )
    there, rows = [], []
    for name, (value, stderr) in reported(fit).items():
        known = reference.values.get(name)
        if known is None or any(name not in one["values"] for one in fits):
            continue
        again, row = first["values"][name], {"refitted parameter": name}
        row[">std. error"] = format_estimate(value, stderr)[1]
        shifts = [one["values"][name] - value for one in fits]
        for one, shift in zip(fits, shifts, strict=True):
            by = ", ".join(
                f"{k} {new - now[k]:+g} {UNIT[k]}" for k, new in one["stone"].items()
            )
            row[f">shift, {by}"] = f"{round(shift, places + 1) + 0.0:+.{places + 1}f}"
        there.append(f"{again:.{places}f}")
        rows.append(
            row
            | {f">with {constants}": there[-1], f">{reference.source}": f"{known:g}"}
        )
        agree &= abs(again - known) <= 0.5 * 10.0 ** -_places(known) + sum(
            map(abs, shifts[1:])
        )
    if not rows:
        return None
    flags = ",".join(f"{name}={value:g}" for name, value in first["stone"].items())
    verdict = f"which do not all agree with {reference.source}"
    if agree:
        verdict = (
            f"which agree with {reference.source} within the rounding of its digits "
            "and of the stone's constants"
        )
    text = f"{reference.source}: {reference.note}. " if reference.note else ""
    text += f"`--stone {flags}` gives {join_words(there)}, {verdict}."
    caption = "Shift of the estimates with the constants of the stone"
    return PlainTable(rows, caption, note=Text(text))


def _places(value: float) -> int:
    """Decimal places of a printed number."""
    return len(f"{value:g}".partition(".")[2])


def _quality(fit: FitResult) -> PlainTable:
    rows = []
    for name, rms in fit.rms.items():
        row = {
            "channel": name,
            ">rms": f"{rms:.3g}",
            "unit": UNITS[name],
            "noise assumed": _sigma(fit, name),
            "": fit.data["sigma"][name],
            "lag-1 correlation": f"{fit.lag1[name]:.2f}" if name in fit.lag1 else "",
        }
        if not fit.noise.is_white:
            after = fit.independence.get(name)
            row["noise model"] = _memory(fit, name)
            row["lag-1 after whitening"] = f"{after.lag1:.2f}" if after else ""
        rows.append(row)
    return PlainTable(rows, "Residuals by channel")


def _sigma(fit: FitResult, name: str) -> str:
    """The noise of a channel."""
    if fit.data["sigma"][name] != "estimated":
        return "by row"
    by_row = fit.observed.get(f"sigma_{name}")
    most = "" if by_row is None else f" to {by_row.max():.3g}"
    return f"{fit.sigma[name]:.3g}{most} {UNITS[name]}"


def _memory(fit: FitResult, channel: str) -> str:
    """The correlation of a channel's noise, in a few words."""
    parts = ["discrepancy"] if fit.noise.sizes else []
    if memory := fit.noise.memory.get(channel):
        share = fit.noise.white_share(channel)
        parts.append(f"correlation time {memory:.2g} s, {share:.0%} independent")
    return ", ".join(parts) or "independent"


def _events(fit: FitResult) -> PlainTable:
    """Values measured at lines and at rest, with the fitted ones."""
    rows = []
    for event, fitted in fit.timed:
        digits = max(decimals(event.sigma), 2)
        off = (event.value - fitted) / event.sigma
        rows.append(
            {
                "measured": event.name,
                ">value": f"{event.value:.{digits}f}",
                ">sigma": f"{event.sigma:.2g}",
                "unit": event.unit,
                ">fit": f"{fitted:.{digits}f}",
                ">measured - fit": f"{off + 0.0:.1f} sigma",
            }
        )
    return PlainTable(rows, "Timed events")


def outliers(fit: FitResult) -> str:
    """The values far from the fit, by channel and time, the farthest first."""
    if not fit.outliers:
        return ""
    named = []
    for item in fit.outliers[:_MOST_NAMED]:
        line = "" if item["line"] is None else f" (line {item['line']})"
        named.append(
            f"{item['channel']} at {item['t']:g} s{line} by {item['off']:.3g} "
            f"{UNITS[item['channel']]} ({two_digits(item['sigmas'])} robust sigma)"
        )
    more = len(fit.outliers) - len(named)
    if more:
        named.append(f"and {more} more (all in fit.json)")
    return f"Outliers: {'; '.join(named)}."


def _posterior(fit: FitResult) -> Text | None:
    """How the posterior was sampled, and how well."""
    if (found := fit.posterior) is None:
        return None
    return Text.assemble(
        "Posterior: ",
        (found.status, posterior.style(found)),
        f"; {posterior.sampled(found)}",
    )


def settings_of(fit: FitResult) -> dict[str, str]:
    """The settings of a fit, by name."""
    known, sampled = fit.parameters, fit.posterior
    held = {name: item for name, item in known.items() if item.verdict == Verdict.FIXED}
    listed = {
        "Sigma": {
            name: f"{_sigma(fit, name)} ({fit.data['sigma'][name]})" for name in fit.rms
        },
        "Held": {name: f"= {item.value:g}" for name, item in held.items()},
        "Priors": {name: item.prior for name, item in known.items() if item.prior},
        "Bounds": {
            name: f"{item.lower:g} .. {item.upper:g}"
            for name, item in fit.coefficients.items()
            if name not in held
        },
        "Standard uncertainty of what is held": {
            name: f"{value:g}"
            for name, value in fit.systematics.settings.items()
            if value
        },
    }
    found = {
        "Law, load": f"{fit.law}, {fit.load}",
        "Data": f"{fit.data['file']}, {rows_text(fit.data) or 'timed events alone'}",
        "Stone": stone_text(fit.stone),
        "Loss, noise": f"{fit.loss}, {fit.noise.kind}",
        **{
            head: ", ".join(f"{name} {said}" for name, said in items.items())
            for head, items in listed.items()
        },
    }
    if sampled is not None:
        size = (
            f"{sampled.samples} samples, {sampled.walkers} walkers, "
            f"{sampled.steps} steps"
        )
        found["Posterior"] = f"{size}, seed {sampled.seed}"
    return found


def command_of(fit: FitResult) -> str:
    """The command that makes a fit."""
    words = [file_of(fit), *with_derived(fit.data.get("flags", ()), fit)]
    if fit.posterior is not None:
        words.append(f"--seed={fit.posterior.seed}")
    elif fit.sampling == "none":
        words.append("--no-sample")
    return command_line("fit", *words)


def with_derived(flags: Sequence[str], result: Any) -> list[str]:
    """The flags, with those of quantities that were derived later."""
    return list(
        dict.fromkeys(
            [*flags, *(f"--derive={one.expression}" for one in result.derived)]
        )
    )


def file_of(fit: FitResult) -> str:
    """The file of a throw, from a name that may include a row of the file."""
    return file_and_number(str(fit.data["file"]))[0]
