"""What a fit says, made from a `FitResult` alone; nothing is computed here."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.text import Text

from curlfit.inference.parameters import START
from curlfit.output.console import PlainTable
from curlfit.output.document import Document, Said, Section, command_line, show
from curlfit.output.text import (
    capital,
    decimals,
    format_estimate,
    from_to,
    join_words,
    lower,
    rows_text,
    stone_text,
    two_digits,
)
from curlfit.reports import posterior
from curlfit.reports.determined import identifiability
from curlfit.reports.estimates import (
    caution,
    derived_table,
    draw_text,
    estimate_cells,
    lines_of,
    quantities_line,
    quantities_table,
    reported,
    status_line,
    style_of,
    systematics,
)
from curlfit.stone import UNITS as STONE_UNITS
from curlfit.throws.throw import UNITS

if TYPE_CHECKING:
    from curlfit.inference.fit.result import FitResult

_MOST_NAMED = 6  # outliers that the report lists
_UNFINISHED = (
    "Sampling is unfinished; repeat the `curlfit fit` command with --resume to continue it."
)
_SEEN = ("determined", "prior", "fixed")


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
    loss = "" if fit.loss == "linear" else f", {fit.loss} loss"
    noise = "" if fit.noise.kind == "white" else f", {fit.noise.kind} noise"
    hidden = any(item.verdict not in _SEEN for item in fit.parameters.values())
    unfinished = Text(_UNFINISHED * (fit.sampling == "unfinished"), style="bold yellow")
    sections = (
        Section(
            "coefficients", "Coefficients",
            (_estimates(fit), _student(fit), derived_table(fit.derived)),
        ),
        Section(
            "path", "The path",
            (quantities_table(fit.quantities, discrepancy=bool(fit.noise.sizes)),
             draw_text(fit.quantities)),
        ),
        Section(
            "quality", "Systematic errors and residuals",
            (systematics(fit), _beside_reference(fit), _quality(fit), _events(fit)),
            brief=False,
        ),
        Section(
            "determined", f"What the path {'does not determine' if hidden else 'determines'}",
            (identifiability(fit),),
        ),
        Section("posterior", "The posterior", (_posterior(fit), unfinished)),
        Section("outliers", "Outliers", (outliers(fit),), brief=False),
    )  # fmt: skip
    return Document(
        finding=lower(fit.status),
        style=style_of(fit),
        subject=Text.assemble(
            (f"{fit.law} law", "bold"), f", {fit.load} load{loss}{noise}, fitted to {data['file']}"
        ),
        about=(
            f"{extent(fit)}; stone {stone_text(fit.stone)}",
            status_line(fit),
            Said(capital(quantities_line(fit.quantities)) or lines_of(fit)[0]),
            caution(fit),
        ),
        lines=[*lines_of(fit), quantities_line(fit.quantities)],
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
    events = f"{len(fit.events)} events at lines and at rest" * bool(fit.events)
    return "; ".join(filter(None, (rows_text(fit.data), events)))


def _estimates(fit: FitResult) -> PlainTable:
    reference, rows = fit.reference, []
    combinations = [(one.expression, one, one.weights) for one in fit.combinations]
    items: list[tuple[str, Any, dict[str, float]]] = []
    for name, item in fit.parameters.items():
        items += combinations * (name == START[0].name)
        items.append((name, item, {name: 1.0}))
    for name, item, weights in items:
        row = estimate_cells(name, item, fit.systematics)
        found = fit.posterior and fit.posterior.quantiles.get(name)
        row["68 % of posterior"] = from_to(found["16"], found["84"]) if found else ""
        if reference is not None:
            known = reference.of(name, weights)
            row[f">{reference.source}"] = "" if known is None else f"{known:g}"
        rows.append(row)
    return PlainTable(rows, "Estimates with standard errors")


def _beside_reference(fit: FitResult) -> PlainTable | None:
    """How the estimates vary with the stone's constants if those of a reference are rounded."""
    reference, fits = fit.reference, fit.reference_fits
    if reference is None or not fits:
        return None
    now, rows = fit.stone.as_dict(), []
    agree, there = True, []
    places = max(map(_places, reference.values.values()))
    for name, (value, stderr) in reported(fit).items():
        known = reference.values.get(name)
        if known is None or any(name not in item["values"] for item in fits):
            continue
        again = fits[0]["values"][name]
        shifts = [item["values"][name] - value for item in fits]
        agree &= abs(again - known) <= 0.5 * 10.0 ** -_places(known) + sum(map(abs, shifts[1:]))
        there.append(f"{again:.{places}f}")
        shifted = {
            f">shift, {_changes(item['stone'], now)}":
                f"{round(shift, places + 1) + 0.0:+.{places + 1}f}"
            for item, shift in zip(fits, shifts, strict=True)
        }  # fmt: skip
        rows.append(
            {"refitted parameter": name, ">std. error": format_estimate(value, stderr)[1]}
            | shifted
            | {f">with {_constants(fits[0]['stone'])}": there[-1],
               f">{reference.source}": f"{known:g}"}
        )  # fmt: skip
    if not rows:
        return None
    flags = ",".join(f"{name}={value:g}" for name, value in fits[0]["stone"].items())
    verdict = (
        f"which agree with {reference.source} within the rounding of its digits and of the stone's "
        "constants"
        if agree
        else f"which do not all agree with {reference.source}"
    )
    text = f"{reference.source}: {reference.note}. " if reference.note else ""
    text += f"`--stone {flags}` gives {join_words(there)}, {verdict}."
    caption = "Shift of the estimates with the constants of the stone"
    return PlainTable(rows, caption, note=Text(text))


def _changes(constants: dict[str, float], now: dict[str, Any]) -> str:
    return ", ".join(
        f"{name} {value - now[name]:+g} {STONE_UNITS[name]}" for name, value in constants.items()
    )


def _constants(constants: dict[str, float]) -> str:
    return ", ".join(f"{name} = {value:g} {STONE_UNITS[name]}" for name, value in constants.items())


def _places(value: float) -> int:
    """Decimal places of a printed number."""
    return len(f"{value:g}".partition(".")[2])


_FEW = 30.0  # degrees of freedom from which Student's t is Gaussian to within 4 %


def _student(fit: FitResult) -> PlainTable | None:
    """95 % intervals where sigma was estimated from few values."""
    items = {name: item for name, item in fit.coefficients.items() if item.stderr is not None}
    both: dict[str, Any] = items | {item.expression: item for item in fit.combinations}
    if min((item.dof or math.inf for item in both.values()), default=math.inf) >= _FEW:
        return None
    rows = []
    for name, item in both.items():
        interval = item.interval()
        if interval is None:
            continue
        digits = decimals(item.stderr or 0.0)
        low, high = (f"{end:.{digits}f}" for end in interval)
        rows.append(
            {
                "": name, "95 % interval (Student's t)": f"{low} .. {high}",
                ">degrees of freedom": "-" if item.dof is None else f"{item.dof:.0f}",
            }
        )  # fmt: skip
    text = "Sigma is estimated from few values, so that 95 % intervals exceed 1.96 standard errors."
    if fit.posterior is not None:
        text += " The posterior holds sigma fixed; its intervals are correspondingly too narrow."
    return PlainTable(rows, "Intervals at 95 %", note=Text(text))


def _quality(fit: FitResult) -> PlainTable:
    rows = []
    for name, rms in fit.rms.items():
        row = {
            "channel": name, ">rms": f"{rms:.3g}", "unit": UNITS[name],
            "noise assumed": _sigma(fit, name), "": fit.data["sigma"][name],
            "lag-1 correlation": _two(fit.lag1.get(name)),
        }  # fmt: skip
        if fit.noise.kind != "white":
            after = fit.independence.get(name)
            row["noise model"] = _memory(fit, name)
            row["lag-1 after whitening"] = _two(None if after is None else after.lag1)
        rows.append(row)
    return PlainTable(rows, "Residuals by channel")


def _sigma(fit: FitResult, name: str) -> str:
    """The noise of a channel."""
    if fit.data["sigma"][name] != "estimated":
        return "by row"
    by_row = fit.observed.get(f"sigma_{name}")
    most = "" if by_row is None else f" to {by_row.max():.3g}"
    return f"{fit.sigma[name]:.3g}{most} {UNITS[name]}"


def _events(fit: FitResult) -> PlainTable:
    """Values measured at lines and at rest, with the fitted ones."""
    rows = []
    for event, fitted in fit.timed:
        digits = max(decimals(event.sigma), 2)
        off = (event.value - fitted) / event.sigma
        rows.append(
            {
                "measured": event.name, ">value": f"{event.value:.{digits}f}",
                ">sigma": f"{event.sigma:.2g}", "unit": event.unit,
                ">fit": f"{fitted:.{digits}f}", ">measured - fit": f"{off + 0.0:.1f} sigma",
            }
        )  # fmt: skip
    return PlainTable(rows, "Timed events")


def _two(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"


def _memory(fit: FitResult, channel: str) -> str:
    """The correlation of a channel's noise, in a few words."""
    parts = ["discrepancy"] if fit.noise.sizes else []
    if memory := fit.noise.memory.get(channel):
        share = fit.noise.white_share(channel)
        parts.append(f"correlation time {memory:.2g} s, {share:.0%} independent")
    return ", ".join(parts) or "independent"


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
    text = f"Outliers: {'; '.join(named)}"
    return text + (f"; and {more} more (all in fit.json)." if more else ".")


def _posterior(fit: FitResult) -> Text | None:
    """How the posterior was sampled, and how well."""
    found = fit.posterior
    if found is None:
        return None
    return Text.assemble(
        "Posterior: ", (found.status, posterior.style(found)), f"; {posterior.sampled(found)}"
    )


def settings_of(fit: FitResult) -> dict[str, str]:
    """The settings of a fit, by name."""
    held = {name: item for name, item in fit.parameters.items() if item.verdict == "fixed"}
    found = {
        "Law, load": f"{fit.law}, {fit.load}",
        "Data": f"{fit.data['file']}, {rows_text(fit.data) or 'timed events alone'}",
        "Stone": stone_text(fit.stone),
        "Loss, noise": f"{fit.loss}, {fit.noise.kind}",
        "Sigma": ", ".join(
            f"{name} {_sigma(fit, name)} ({fit.data['sigma'][name]})" for name in fit.rms
        ),
        "Held": ", ".join(f"{name} = {item.value:g}" for name, item in held.items()),
        "Priors": ", ".join(
            f"{name} {item.prior}" for name, item in fit.parameters.items() if item.prior
        ),
        "Bounds": ", ".join(
            f"{name} {item.lower:g} .. {item.upper:g}"
            for name, item in fit.coefficients.items() if name not in held
        ),
        "Standard uncertainty of what is held": ", ".join(
            f"{name} {value:g}" for name, value in fit.systematics.settings.items() if value
        ),
    }  # fmt: skip
    if (sampled := fit.posterior) is not None:
        found["Posterior"] = (
            f"{sampled.samples} samples, {sampled.walkers} walkers, {sampled.steps} steps, "
            f"seed {sampled.seed}"
        )
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
    return list(dict.fromkeys([*flags, *(f"--derive={one.expression}" for one in result.derived)]))


def file_of(fit: FitResult) -> str:
    """The file of a throw, from a name that may include a row of the file."""
    return str(fit.data["file"]).partition(" row ")[0]
