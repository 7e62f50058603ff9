"""Report of a fit as text, made from a `FitResult` alone; nothing is computed here."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from rich.console import Console, Group, RenderableType
from rich.padding import Padding
from rich.text import Text

from curlfit.inference.conditions import CALIBRATION, if_off
from curlfit.inference.derived_report import derived_table, quantities_table
from curlfit.inference.parameters import START
from curlfit.output.console import terminal
from curlfit.output.text import (
    STYLE,
    decimals,
    format_estimate,
    from_to,
    join_words,
    plain_table,
    two_digits,
)
from curlfit.stone import UNITS as STONE_UNITS
from curlfit.throws.events import Event
from curlfit.throws.throw import UNITS

if TYPE_CHECKING:
    from curlfit.inference.fit.result import Estimate, FitResult, Posterior, Systematics

_NOTABLE = 0.1  # systematic shift that is reported, over the standard error
_MOST_NAMED = 6  # outliers that the report lists
_UNFINISHED = (
    "Sampling is unfinished; repeat the `curlfit fit` command with --resume to continue it."
)
_PLURAL = {
    "its standard error is": "their standard errors are", "its standard error": "their standard "
    "errors", "its typical size": "their typical size",
}  # fmt: skip
_WORDS = {
    "x": "x", "y": "y", "phi": "the angle", "speed": "the speed", "omega": "the spin",
}  # fmt: skip


def print_fit(fit: FitResult, console: Console | None = None) -> None:
    """Print the report of a fit.

    Examples
    --------
    >>> curlfit.print_fit(fit)
    front-back law, uniform load, fitted to ...
    """
    console = console or terminal()
    console.print(report(fit))


def report(fit: FitResult) -> RenderableType:
    """The report of a fit, for a rich console."""
    return Group(*(part for parts in sections(fit).values() for part in parts))


def sections(fit: FitResult) -> dict[str, list[RenderableType]]:
    """The parts of the report by name, in their order; some are empty."""
    said = systematics(fit.systematics, _reported(fit))
    posterior = fit.posterior
    return {
        "heading": [_heading(fit)],
        "estimates": [_coefficients(fit), *_student(fit)],
        "derived": derived_table(fit.derived),
        "path": quantities_table(fit.quantities, discrepancy=bool(fit.noise.sizes)),
        "systematics": [_spaced(said)] * bool(said),
        "reference": _beside_reference(fit),
        "quality": [_quality(fit)] * bool(fit.rms),
        "events": [_events(fit)] * bool(fit.events),
        "identifiability": [_spaced(identifiability(fit))],
        "posterior": []
        if posterior is None
        else [Padding(about_posterior(posterior), (0, 0, 1, 0))],
        "outliers": [_spaced(outliers(fit))] * bool(fit.outliers),
        "sampling": [_spaced(_UNFINISHED, "bold yellow")] * (fit.sampling == "unfinished"),
        "warnings": [_spaced(f"Warning: {warning}.", "yellow") for warning in fit.warnings],
        "notes": [Text(f"Note: {note}.", style="dim") for note in fit.data["notes"]],
    }


def _spaced(text: str, style: str = "") -> RenderableType:
    return Padding(Text(text, style=style), (0, 0, 1, 0))


def _heading(fit: FitResult) -> RenderableType:
    data, stone = fit.data, fit.stone
    lines = Text()
    lines.append(f"{fit.law} law", style="bold")
    loss = "" if fit.loss == "linear" else f", {fit.loss} loss"
    noise = "" if fit.noise.kind == "white" else f", {fit.noise.kind} noise"
    lines.append(f", {fit.load} load{loss}{noise}, fitted to {data['file']}\n")
    lines.append(
        f"{extent(data, len(fit.events))}; "
        f"stone R = {stone.R:g} m, rho = {stone.rho:g} m, h = {stone.h:g} m, m = {stone.m:g} kg\n"
    )
    lines.append(
        fit.status[:1].upper() + fit.status[1:], style="green" if fit.converged else "bold red"
    )
    return lines


def extent(data: Mapping[str, Any], events: int) -> str:
    """Number of data, and the time that they span."""
    rows = f"{data['rows']} rows, t = {data['from']:g} .. {data['to']:g} s"
    others = f"{events} events at lines and at rest"
    return "; ".join([rows] * bool(data["rows"]) + [others] * bool(events))


def _beside_reference(fit: FitResult) -> list[RenderableType]:
    """How the estimates vary with the stone's constants if those of a reference are rounded."""
    reference, fits = fit.reference, fit.reference_fits
    if reference is None or not fits:
        return []
    now, table = fit.stone.as_dict(), plain_table()
    table.add_column("refitted parameter", no_wrap=True)
    table.add_column("std. error", justify="right", no_wrap=True)
    for item in fits:
        table.add_column(f"shift, {_changes(item['stone'], now)}", justify="right", no_wrap=True)
    table.add_column(f"with {_constants(fits[0]['stone'])}", justify="right", no_wrap=True)
    table.add_column(reference.source, justify="right", no_wrap=True)
    agree, there = True, []
    places = max(map(_places, reference.values.values()))
    for name, (value, stderr) in _reported(fit).items():
        known = reference.values.get(name)
        if known is None or any(name not in item["values"] for item in fits):
            continue
        again = fits[0]["values"][name]
        shifts = [item["values"][name] - value for item in fits]
        agree &= abs(again - known) <= 0.5 * 10.0 ** -_places(known) + sum(map(abs, shifts[1:]))
        there.append(f"{again:.{places}f}")
        table.add_row(
            name, format_estimate(value, stderr)[1],
            *(f"{round(shift, places + 1) + 0.0:+.{places + 1}f}" for shift in shifts),
            there[-1], f"{known:g}",
        )  # fmt: skip
    if not there:
        return []
    flags = ",".join(f"{name}={value:g}" for name, value in fits[0]["stone"].items())
    verdict = (
        f"which agree with {reference.source} within the rounding of its digits and of the stone's "
        "constants"
        if agree
        else f"which do not all agree with {reference.source}"
    )
    text = f"{reference.source}: {reference.note}. " if reference.note else ""
    text += f"`--stone {flags}` gives {join_words(there)}, {verdict}."
    return [Padding(Group(table, Text(text)), (0, 0, 1, 0))]


def _reported(fit: FitResult) -> dict[str, tuple[float, float | None]]:
    """Value and standard error of coefficients and determined combinations."""
    found = {name: (item.value, item.stderr) for name, item in fit.coefficients.items()}
    return found | {item.expression: (item.value, item.stderr) for item in fit.combinations}


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


def _student(fit: FitResult) -> list[RenderableType]:
    """95 % intervals where sigma was estimated from few values."""
    items = {name: item for name, item in fit.coefficients.items() if item.stderr is not None}
    both = items | {item.expression: item for item in fit.combinations}
    if min((item.dof or math.inf for item in both.values()), default=math.inf) >= _FEW:
        return []
    table = plain_table()
    table.add_column("", no_wrap=True)
    table.add_column("95 % interval (Student's t)", no_wrap=True)
    table.add_column("degrees of freedom", justify="right", no_wrap=True)
    for name, item in both.items():
        interval = item.interval()
        if interval is None:
            continue
        digits = decimals(item.stderr or 0.0)
        low, high = (f"{end:.{digits}f}" for end in interval)
        table.add_row(name, f"{low} .. {high}", "-" if item.dof is None else f"{item.dof:.0f}")
    text = "Sigma is estimated from few values, so that 95 % intervals exceed 1.96 standard errors."
    if fit.posterior is not None:
        text += " The posterior holds sigma fixed; its intervals are correspondingly too narrow."
    return [Padding(Group(table, Text(text)), (0, 0, 1, 0))]


def _interval(posterior: Posterior, name: str) -> str:
    found = posterior.quantiles.get(name)
    if found is None:
        return ""
    return from_to(found["16"], found["84"])


def _coefficients(fit: FitResult) -> RenderableType:
    table = plain_table()
    table.add_column("parameter", no_wrap=True)
    table.add_column("estimate", justify="right", no_wrap=True)
    table.add_column("std. error", justify="right", no_wrap=True)
    errors = fit.systematics.errors
    if errors:
        table.add_column("systematic", justify="right", no_wrap=True)
    table.add_column("verdict", no_wrap=True)
    posterior, reference = fit.posterior, fit.reference
    if posterior is not None:
        table.add_column("68 % of posterior", no_wrap=True)
    if reference is not None:
        table.add_column(reference.source, justify="right", no_wrap=True)

    def row(
        name: str, unit: str, value: str, stderr: str, verdict: str, weights: dict[str, float]
    ) -> None:
        label = f"{name} ({unit})" if unit not in ("", "1") else name
        cells: list[str | Text] = [label, value, stderr]
        if errors:
            cells.append(f"{errors[name]:.2g}" if name in errors else "-")
        cells.append(Text(verdict, style=STYLE[verdict]))
        if posterior is not None:
            cells.append(_interval(posterior, name))
        if reference is not None:
            known = reference.of(name, weights)
            cells.append("" if known is None else f"{known:g}")
        table.add_row(*cells)

    first_start = START[0].name
    for name, item in fit.parameters.items():
        if name == first_start:
            for one in fit.combinations:
                shown = format_estimate(one.value, one.stderr)
                row(one.expression, "", *shown, "determined", one.weights)
        row(name, item.unit, *_estimate(item), item.verdict, {name: 1.0})
    return Padding(table, (1, 0))


def systematics(found: Systematics, reported: Mapping[str, tuple[float, float | None]]) -> str:
    """The largest systematic error of each coefficient or combination, and that due to the
    calibration of a camera, in sentences.

    Parameters
    ----------
    reported : value and standard error by name.
    """
    named: dict[str, list[str]] = {}
    for name, (_, stderr) in reported.items():
        shifts = {
            condition: shift
            for condition, shift in found.shifts.get(name, {}).items()
            if not condition.startswith(CALIBRATION)
        }
        condition = max(shifts, key=lambda one: abs(shifts[one]), default="")
        size = abs(shifts.get(condition, 0.0))
        if stderr is None or size < _NOTABLE * stderr:
            continue
        verb = "higher" if shifts[condition] > 0 else "lower"
        named.setdefault(condition, []).append(f"{name} is {size:.2g} {verb}")
    text = ""
    if named:
        sentences = [
            f"{if_off(condition, found.widths[condition])}, the true {join_words(parts)}"
            for condition, parts in named.items()
        ]
        text = (
            "Systematic errors come from conditions that the fit holds fixed; the largest: "
            + "; ".join(sentences)
            + ". `--systematic` sets the standard uncertainties of the conditions; `--prior` or "
            "`--free` estimates them with the coefficients. "
        )
    calibration = [
        f"{found.of_calibration.get(name, 0.0):.2g} to {name}"
        for name, (_, stderr) in reported.items()
        if stderr and found.of_calibration.get(name, 0.0) >= _NOTABLE * stderr
    ]
    if calibration:
        text += (
            f"The calibration of the camera contributes {join_words(calibration)}, according to "
            "the residual of its known points."
        )
    return text.strip()


def _estimate(item: Estimate) -> tuple[str, str]:
    if item.verdict == "not identifiable":
        return "-", "-"
    return format_estimate(item.value, item.stderr)


def _quality(fit: FitResult) -> RenderableType:
    table = plain_table()
    white = fit.noise.kind == "white"
    heads = ["channel", "rms", "unit", "noise assumed", "", "lag-1 correlation"]
    for head in heads if white else [*heads, "noise model", "lag-1 after whitening"]:
        table.add_column(head, justify="right" if head == "rms" else "left", no_wrap=True)
    for name, rms in fit.rms.items():
        origin = fit.data["sigma"][name]
        noise = f"{fit.sigma[name]:.3g} {UNITS[name]}" if origin == "estimated" else "by row"
        if origin == "estimated" and (by_row := fit.observed.get(f"sigma_{name}")) is not None:
            noise = f"{fit.sigma[name]:.3g} to {by_row.max():.3g} {UNITS[name]}"
        lag1 = fit.lag1.get(name)
        cells = [name, f"{rms:.3g}", UNITS[name], noise, origin, _two(lag1)]
        if not white:
            after = fit.independence.get(name)
            cells += [_memory(fit, name), _two(None if after is None else after.lag1)]
        table.add_row(*cells)
    return Padding(table, (0, 0, 1, 0))


def _events(fit: FitResult) -> RenderableType:
    """Values measured at lines and at rest, with the fitted ones."""
    table = plain_table()
    for head in ("measured", "value", "sigma", "unit", "fit", "measured - fit"):
        justify = "left" if head in ("measured", "unit") else "right"
        table.add_column(head, justify=justify, no_wrap=True)  # type: ignore[arg-type]
    for item in fit.events:
        event = Event(**{key: value for key, value in item.items() if key != "fitted"})
        digits = max(decimals(event.sigma), 2)
        off = (event.value - item["fitted"]) / event.sigma
        table.add_row(
            event.name, f"{event.value:.{digits}f}", f"{event.sigma:.2g}", event.unit,
            f"{item['fitted']:.{digits}f}", f"{off + 0.0:.1f} sigma",
        )  # fmt: skip
    return Padding(table, (0, 0, 1, 0))


def _two(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"


def _memory(fit: FitResult, channel: str) -> str:
    """The correlation of a channel's noise, in a few words."""
    parts = ["discrepancy"] if fit.noise.sizes else []
    if memory := fit.noise.memory.get(channel):
        share = fit.noise.white_share(channel)
        parts.append(f"correlation time {memory:.2g} s, {share:.0%} independent")
    return ", ".join(parts) or "independent"


def identifiability(fit: FitResult) -> str:
    """What the path determines and what it does not, in sentences."""
    free = [name for name, item in fit.parameters.items() if item.verdict != "fixed"]
    by_prior = [name for name, item in fit.parameters.items() if item.verdict == "prior"]
    held = [name for name in free if name not in fit.covariance["names"]]
    given = any(item.prior for item in fit.parameters.values())
    what = "The path" if fit.rms else _counted(len(fit.events))
    singular = bool(fit.rms) or len(fit.events) == 1
    what += " and the priors determine" if given else " determine" + "s" * singular
    if not fit.rms and fit.rank == len(free) and len(fit.coefficients) == 1:
        return (
            f"{what} one coefficient of friction and the initial state ({', '.join(free[1:])}): a "
            f"mean friction, as in the {fit.law} law. Use `--law` to fit another law."
        )
    text = f"{what} {fit.rank} of {len(free) - len(held)} parameters"
    text += f" ({', '.join(held)} at a bound not counted)." if held else "."
    unseen = [name for name in free if fit.parameters[name].verdict == "not identifiable"]
    if unseen:
        text += (
            f" {join_words(unseen)} {'are' if len(unseen) > 1 else 'is'} not identifiable: "
            "the path stays the same when "
            + "; or when ".join(_change(item) for item in fit.null_directions)
            + "."
        )
        text += _instead(fit, unseen)
    if by_prior:
        text += (
            f" {join_words(by_prior)} {'rest' if len(by_prior) > 1 else 'rests'} on the priors: "
            "the path alone does not determine " + ("them." if len(by_prior) > 1 else "it.")
        )
    weak = [name for name in free if fit.parameters[name].verdict == "weak"]
    for reason in dict.fromkeys(fit.parameters[name].reason for name in weak):
        alike = [name for name in weak if fit.parameters[name].reason == reason]
        text += f" {join_words(alike)} {'are' if len(alike) > 1 else 'is'} weakly determined"
        if len(alike) > 1:
            for one, several in _PLURAL.items():
                reason = reason.replace(one, several)
        text += f": {reason}." if reason else "."
    if weak and not unseen:
        text += _instead(fit, weak)
    return text + "".join(f" {_remedy(fit, item)}" for item in fit.remedies)


def _counted(number: int) -> str:
    words = ("No", "One", "Two", "Three", "Four", "Five", "Six", "Seven", "Eight")
    return f"{words[number]} measured value{'s' * (number != 1)}"


def _remedy(fit: FitResult, remedy: dict[str, Any]) -> str:
    """Measurements that would determine some parameters, as a sentence."""
    names, channels = remedy["parameters"], [_WORDS[name] for name in remedy["measure"]]
    if channels:
        also = join_words(channels) if remedy["all"] else _either(channels)
        return f"Measuring {also} as well would determine {join_words(names)}."
    text = f"No further measurement along this path would determine {join_words(names)}"
    own = [name for name in names if name in fit.coefficients]
    if fit.data["law_file"] or len(own) != 2:
        return text + "."
    return text + f"; `curlfit design --separate {own[0]},{own[1]}` searches for throws that would."


def _either(words: list[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"


def _instead(fit: FitResult, names: list[str]) -> str:
    """The combinations of some parameters that are determined, as a sentence."""
    what = [item.expression for item in fit.combinations if set(item.weights) & set(names)]
    verb = "are" if len(what) > 1 else "is"
    return f" Only {join_words(what)} {verb} determined." if what else ""


def outliers(fit: FitResult) -> str:
    """The values far from the fit, by channel and time, the farthest first."""
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


def _change(direction: dict[str, float]) -> str:
    """A null direction as a change that leaves the path the same."""
    parts = []
    for name, weight in direction.items():
        verb = "grows" if weight > 0 else "falls"
        size = abs(weight)
        by = "" if size == max(map(abs, direction.values())) else f" {size:.3g} times as much"
        parts.append(f"{name} {verb}{by}")
    if len(parts) == 2 and " times " not in "".join(parts):
        return f"{parts[0]} and {parts[1]} by the same amount"
    return join_words(parts)


def about_posterior(found: Posterior) -> Text:
    """How a posterior was sampled, and how well."""
    sizes = []
    for part, ess in (("bulk", found.ess), ("tail", found.ess_tail)):
        if ess:  # records of earlier versions have none of the tails
            least = min(ess, key=ess.__getitem__)
            sizes.append(f"{ess[least]:.0f} in the {part} ({least})")
    worst = max(found.r_hat, key=found.r_hat.__getitem__)
    text = Text("Posterior: ")
    text.append(found.status, style="green" if found.converged else "bold yellow")
    text.append(
        f"; {found.samples} samples ({found.ensembles} ensembles, {found.walkers} walkers, "
        f"{found.steps} steps), effective sample size at least {' and '.join(sizes)}, "
        f"R-hat at most {found.r_hat[worst]:.4f} ({worst}), acceptance {found.acceptance:.0%}."
    )
    return text
