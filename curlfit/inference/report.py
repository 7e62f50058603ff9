"""What a fit says, made from a `FitResult` alone; nothing is computed here."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.text import Text

from curlfit.inference.conditions import CALIBRATION, if_off
from curlfit.inference.derived import Derived, scaled, to_its_side
from curlfit.inference.parameters import START
from curlfit.output.console import PlainTable
from curlfit.output.document import Document, Said, Section, command_line, show
from curlfit.output.text import (
    capital,
    compact,
    decimals,
    format_estimate,
    from_to,
    join_words,
    judged,
    labelled,
    lower,
    rows_text,
    stone_text,
    two_digits,
)
from curlfit.sheet import FOOT
from curlfit.stone import UNITS as STONE_UNITS
from curlfit.throws.throw import UNITS

if TYPE_CHECKING:
    from curlfit.inference.fit.estimates import Estimate, Posterior, Systematics
    from curlfit.inference.fit.result import FitResult
    from curlfit.inference.identifiability import Combination

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


def posterior_document(posterior: Posterior) -> Document:
    """What a posterior says."""
    spans = {">68 %": ("16", "84"), ">95 %": ("2.5", "97.5")}
    table = PlainTable(
        {"quantity": name}
        | {
            head: from_to(found[low], found[high], (found["84"] - found["16"]) / 3)
            for head, (low, high) in spans.items()
        }
        for name, found in posterior.quantiles.items()
    )
    said = _sampled(posterior)
    return Document(
        finding=posterior.status,
        style=_style(posterior),
        subject=f"{len(posterior.ess)} parameters",
        lines=[said],
        sections=[Section("quantiles", "Quantiles", (table, said))],
    )


def status_line(result: Any) -> Said:
    """Whether a fit, of one throw or several, converged, as a line."""
    return Said(capital(result.status), style=style_of(result))


def caution(result: Any) -> Said:
    """What the warnings of a fit that may be used are about, in a line."""
    if not result.converged:
        return Said("")
    of_throws = dict.fromkeys(
        one for throw in getattr(result, "throws", ()) for one in throw.warnings
    )
    own = [one for one in result.warnings if not one.endswith(tuple(of_throws))]
    about = dict.fromkeys(re.split(r" \(|[;:,] ", one)[0] for one in (*own, *of_throws))
    return Said(f"Caution: {'; '.join(about)}." if about else "No warnings.")


def style_of(result: Any) -> str:
    """The style of the status of a fit."""
    return "green" if result.converged else "bold red"


def lines_of(result: Any) -> list[str]:
    """Coefficients and determined combinations in a line, and what is not identifiable."""
    unseen = [
        name for name, item in result.coefficients.items() if item.verdict == "not identifiable"
    ]
    known = [
        f"{name} = {compact(item.value, item.stderr)}"
        + ("" if item.verdict == "determined" else f" ({item.verdict})")
        for name, item in result.coefficients.items()
        if name not in unseen
    ]
    known += [f"{one.expression} = {compact(one.value, one.stderr)}" for one in result.combinations]
    return [", ".join(known), f"not identifiable: {', '.join(unseen)}" if unseen else ""]


def extent(fit: FitResult) -> str:
    """Number of data, and the time that they span."""
    events = f"{len(fit.events)} events at lines and at rest" * bool(fit.events)
    return "; ".join(filter(None, (rows_text(fit.data), events)))


def estimate_cells(
    name: str, item: Estimate | Combination, systematics: Systematics, head: str = "parameter"
) -> dict[str, Any]:
    """Cells of a row of a table of estimates."""
    verdict, error = getattr(item, "verdict", "determined"), systematics.errors.get(name)
    cells = _cells(head, name, item, getattr(item, "unit", ""), error)
    return cells | {"verdict": judged(verdict)}


def _cells(head: str, name: str, item: Any, unit: str, error: float | None) -> dict[str, Any]:
    """An estimate with its standard and systematic errors."""
    hidden = getattr(item, "verdict", "") == "not identifiable"
    value, stderr = ("-", "-") if hidden else format_estimate(item.value, item.stderr)
    return {
        head: labelled(name, unit), ">estimate": value, ">std. error": stderr,
        ">systematic": None if error is None else f"{error:.2g}",
    }  # fmt: skip


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


def reported(result: Any) -> dict[str, tuple[float, float | None]]:
    """Value and standard error of coefficients and determined combinations."""
    found = {name: (item.value, item.stderr) for name, item in result.coefficients.items()}
    return found | {item.expression: (item.value, item.stderr) for item in result.combinations}


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


def systematics(result: Any) -> str:
    """The largest systematic error of each coefficient or combination, and that due to the
    calibration of a camera, in sentences."""
    found, named = result.systematics, dict[str, list[str]]()
    for name, (_, stderr) in reported(result).items():
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
        for name, (_, stderr) in reported(result).items()
        if stderr and found.of_calibration.get(name, 0.0) >= _NOTABLE * stderr
    ]
    if calibration:
        text += (
            f"The calibration of the camera contributes {join_words(calibration)}, according to "
            "the residual of its known points."
        )
    return text.strip()


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
        also = join_words(channels) if remedy["all"] else join_words(channels, "or")
        return f"Measuring {also} as well would determine {join_words(names)}."
    text = f"No further measurement along this path would determine {join_words(names)}"
    own = [name for name in names if name in fit.coefficients]
    if fit.data["law_file"] or len(own) != 2:
        return text + "."
    return text + f"; `curlfit design --separate {own[0]},{own[1]}` searches for throws that would."


def _instead(fit: FitResult, names: list[str]) -> str:
    """The combinations of some parameters that are determined, as a sentence."""
    what = [item.expression for item in fit.combinations if set(item.weights) & set(names)]
    verb = "are" if len(what) > 1 else "is"
    return f" Only {join_words(what)} {verb} determined." if what else ""


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


def _posterior(fit: FitResult) -> Text | None:
    """How the posterior was sampled, and how well."""
    found = fit.posterior
    if found is None:
        return None
    return Text.assemble("Posterior: ", (found.status, _style(found)), f"; {_sampled(found)}")


def _style(found: Posterior) -> str:
    return "green" if found.converged else "bold yellow"


def _sampled(found: Posterior) -> str:
    sizes = []
    for part, ess in (("bulk", found.ess), ("tail", found.ess_tail)):
        if ess:  # records of earlier versions have none of the tails
            least = min(ess, key=ess.__getitem__)
            sizes.append(f"{ess[least]:.0f} in the {part} ({least})")
    worst = max(found.r_hat, key=found.r_hat.__getitem__)
    return (
        f"{found.samples} samples ({found.ensembles} ensembles, {found.walkers} walkers, "
        f"{found.steps} steps), effective sample size at least {' and '.join(sizes)}, "
        f"R-hat at most {found.r_hat[worst]:.4f} ({worst}), acceptance {found.acceptance:.0%}."
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
    if (posterior := fit.posterior) is not None:
        found["Posterior"] = (
            f"{posterior.samples} samples, {posterior.walkers} walkers, {posterior.steps} steps, "
            f"seed {posterior.seed}"
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


def derived_table(items: Sequence[Derived]) -> PlainTable:
    """Derived quantities with their errors."""
    return PlainTable(
        (_derived_row("derived", item) | {"verdict": judged(item.verdict)} | _quantiles(item)
         for item in items),
        "Derived quantities",
    )  # fmt: skip


def quantities_table(quantities: Mapping[str, Derived], *, discrepancy: bool) -> PlainTable:
    """Quantities of the fitted path within the record, or of that of the law without the model
    discrepancy."""
    path = "path of the law" if discrepancy else "fitted path"
    rows = []
    for name, item in quantities.items():
        item = to_its_side(item)
        rows.append(item)
        if name == "curl":
            rows.append(scaled(replace(item, unit="ft"), 1 / FOOT))
    return PlainTable(
        (_derived_row(f"along the {path}", item) | _quantiles(item) for item in rows),
        f"Along the {path}" + ", without the discrepancy" * discrepancy,
    )


def draw_text(quantities: Mapping[str, Derived]) -> str:
    """Time and curl of a draw, as curlers state them."""
    if not {"draw_time", "curl"} <= quantities.keys():
        return ""
    time, curl = quantities["draw_time"].value, abs(quantities["curl"].value) / FOOT
    return f"{time:.1f} s / {curl:.1f} ft: time of the draw from the near hog line, and its curl."


def quantities_line(quantities: Mapping[str, Derived]) -> str:
    """The main quantities of the path in one line."""
    parts = []
    for name in ("friction", "curl", "turns", "hog_to_hog"):
        if name not in quantities:
            continue
        item = quantities[name]
        one = to_its_side(item)
        unit = "" if item.unit in ("", "1") else f" {item.unit}"
        parts.append(f"{one.meaning.partition(',')[0]} {compact(one.value, one.stderr)}{unit}")
    return ", ".join(parts)


def _derived_row(head: str, item: Derived) -> dict[str, Any]:
    return _cells(head, item.meaning or item.expression, item, item.unit, item.systematic)


def _quantiles(item: Derived) -> dict[str, str]:
    found = item.quantiles
    return {"68 % of posterior": from_to(found["16"], found["84"]) if found else ""}
