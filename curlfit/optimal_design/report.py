"""The report of a design. Nothing is computed here."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from rich.console import Console, Group, JustifyMethod, RenderableType
from rich.padding import Padding
from rich.text import Text

from curlfit.inference.conditions import WIDTHS, if_off
from curlfit.output.console import terminal
from curlfit.output.display import Overview
from curlfit.output.text import STYLE, join_words, plain_table, two_digits

if TYPE_CHECKING:
    from curlfit.optimal_design.result import (
        Candidate,
        Design,
        ExpectedErrors,
        LoadScenario,
        Proof,
        Scenario,
        Separation,
    )

_CRITERIA = {
    "D": "smallest volume of the confidence ellipsoid (D-optimal)",
    "A": "smallest mean squared standard error, in units of typical sizes (A-optimal)",
}
_WEAK = 0.05  # relative error above which a difference is weakly determined
_SCATTER = 0.01  # relative variation of the ice from throw to throw
_WORTH = 1.2  # factor of reduction of a systematic error above which a scenario is recommended
_MAX_LISTED = 24  # candidates; the others are in design.json
_LENGTH_AND_ANGLE = {"x": ("m", "mm", "um"), "phi": ("rad", "mrad", "urad")}
_UNITS = {
    "x": _LENGTH_AND_ANGLE["x"], "y": _LENGTH_AND_ANGLE["x"], "phi": _LENGTH_AND_ANGLE["phi"],
    "speed": ("m/s", "mm/s", "um/s"), "omega": ("rad/s", "mrad/s", "urad/s"),
}  # fmt: skip


def print_design(design: Design, console: Console | None = None) -> None:
    """Print the report of a design.

    Examples
    --------
    >>> curlfit.print_design(plan)
    front-back law, uniform load: expected errors of 3 throws selected from 4
    ...
    """
    console = console or terminal()
    console.print(report(design))


def report(design: Design) -> RenderableType:
    """The report of a design, for a rich console."""
    parts: list[RenderableType] = [_heading(design), _best(design)]
    parts += [_paragraph(line) for line in _summary(design)]
    if design.scenarios:
        parts += [Text("Systematic errors of these throws", style="bold"), _scenarios(design)]
        parts.append(_paragraph(_recommended(design.scenarios)))
    parts += [Text("Expected errors from a single throw", style="bold"), _single_throws(design)]
    if design.separation is not None:
        parts += _separation(design, design.separation)
    parts += [Text(f"Note: {note}.", style="dim") for note in design.notes]
    return Group(*parts)


def overview(design: Design) -> Overview:
    """A design at a glance: the best throws and the errors that they give."""
    title, about = _heading(design).plain.splitlines()
    best, *others = _summary(design)
    return Overview(
        best[:1].lower() + best[1:].rstrip("."),
        title,
        [about, *others],
        [about, _best(design), *others, *(f"Note: {note}." for note in design.notes)],
    )


def _paragraph(text: str, style: str = "") -> RenderableType:
    return Padding(Text(text, style=style), (0, 0, 1, 0))


def noise_text(sigma: dict[str, float], factor: float = 1.0) -> str:
    """Noise by channel, as in "5 mm in x and y, 10 mrad in phi"."""
    same: dict[str, list[str]] = {}
    for name, value in sigma.items():
        same.setdefault(with_unit(value * factor, name), []).append(name)
    return ", ".join(f"{size} in {join_words(names)}" for size, names in same.items())


def with_unit(value: float, channel: str) -> str:
    """A value in a suitable unit, as in "12 um"."""
    index = min(max(math.ceil(-math.log10(value) / 3 - 1e-9), 0), 2)
    return f"{two_digits(value * 1000**index)} {_UNITS[channel][index]}"


def percent(fraction: float) -> str:
    """A fraction as in "0.12 %"."""
    return f"{two_digits(100 * fraction)} %"


def throws_text(design: Design, indices: Iterable[int]) -> str:
    """Throws as in "2 x (2.2 m/s, 10 rad/s)"."""
    return " and ".join(
        f"{count} x ({_start(design, design.candidates[index])})"
        for index, count in Counter(indices).items()
    )


def _start(design: Design, one: Candidate) -> str:
    rates = {item.rate for item in design.candidates}
    more = f", {one.rate:g} Hz" if len(rates) > 1 else ""
    return f"{one.v0:g} m/s, {one.omega0:g} rad/s{more}"


def _throws(count: int) -> str:
    return "1 throw" if count == 1 else f"{count} throws"


def _heading(design: Design) -> Text:
    stone, until = design.stone, design.until
    rates = sorted({one.rate for one in design.candidates})
    text = Text()
    text.append(f"{design.law} law", style="bold")
    text.append(f", {design.load} load: expected errors of ")
    text.append(f"{_throws(design.throws)} selected from {len(design.candidates)}\n")
    text.append(
        f"{', '.join(f'{rate:g}' for rate in rates)} Hz "
        f"{'until the stone is at rest' if until is None else f'for {until:g} s'}, independent "
        f"noise of {noise_text(design.sigma)}"
        + (
            f", a discrepancy of {100 * design.discrepancy:.2g} % of what friction does"
            if design.discrepancy
            else ""
        )
        + f"; stone R = {stone.R:g} m, rho = {stone.rho:g} m, "
        f"h = {stone.h:g} m"
    )
    return text


def _scenarios(design: Design) -> RenderableType:
    """The systematic error of each quantity in each scenario."""
    table = plain_table()
    table.add_column("coefficient", no_wrap=True)
    for one in design.scenarios:
        table.add_column(one.name, justify="right", no_wrap=True)
    for name in design.quantities:
        table.add_row(name, *(two_digits(one.systematic[name]) for one in design.scenarios))
    return Padding(table, (1, 0))


def _recommended(scenarios: Sequence[Scenario]) -> str:
    """The recommended scenario, and the largest shifts that remain."""
    planned, *others = scenarios
    first = planned.systematic
    gains = {
        one.name: max(first[name] / max(error, 1e-300) for name, error in one.systematic.items())
        for one in others
    }
    # Of scenarios with about the same gain, the simplest.
    best = next(name for name, gain in gains.items() if gain > 0.8 * max(gains.values()))
    chosen = next(one for one in others if one.name == best)
    left = []
    for name, shifts in chosen.shifts.items():
        condition = max(shifts, key=lambda key: abs(shifts[key]))
        verb = "higher" if shifts[condition] > 0 else "lower"
        text = if_off(condition, WIDTHS[condition])
        left.append(f"{text}, {name} is {two_digits(abs(shifts[condition]))} {verb}")
    said = "What is left" if gains[best] > _WORTH else "The largest shifts"
    remains = f"{said}: {'; '.join(left)}."
    if gains[best] <= _WORTH:
        return f"Throwing with both spins or in both directions cancels little. {remains}"
    return (
        f"Throw with {best}, in equal shares: the systematic errors, mostly by ice that is not "
        f"level, become smaller by up to a factor of {gains[best]:.2g}. {remains}"
    )


def _best(design: Design) -> RenderableType:
    table = plain_table()
    table.add_column("coefficient", no_wrap=True)
    table.add_column("assumed", justify="right", no_wrap=True)
    same_throws = len({item.throws for item in design.best.values()}) == 1
    shown = dict(list(design.best.items())[:1]) if same_throws else design.best
    for name in shown:
        by = "" if same_throws else f" by {name}"
        table.add_column(
            f"std. error, best {_throws(design.throws)}{by}", justify="right", no_wrap=True
        )
    table.add_column("verdict", no_wrap=True)
    first = next(iter(design.best.values()))
    for name in first.stderr:
        known = name in design.coefficients
        verdict = first.verdicts.get(name, "determined")
        unit = design.units.get(name, "1")
        table.add_row(
            name if unit == "1" else f"{name} ({unit})",
            f"{design.coefficients[name] if known else _value(first, name):.6g}",
            *(_error(item.stderr.get(name)) for item in shown.values()),
            Text(verdict, style=STYLE[verdict]),
        )
    return Padding(table, (1, 0))


def _value(found: ExpectedErrors, expression: str) -> float:
    return next(item.value for item in found.combinations if item.expression == expression)


def _error(stderr: float | None) -> str:
    return "-" if stderr is None else f"{stderr:.2g}"


def _summary(design: Design) -> list[str]:
    lines = []
    best = {name: throws_text(design, item.throws) for name, item in design.best.items()}
    if len(set(best.values())) == 1:
        lines.append(
            f"Best {_throws(design.throws)}: {next(iter(best.values()))}, by "
            + " and by ".join(_CRITERIA[name] for name in best)
            + "."
        )
    else:
        for name, text in best.items():
            lines.append(f"Best {_throws(design.throws)} by {_CRITERIA[name]}: {text}.")
    first = next(iter(design.best.values()))
    if design.rank < design.free:
        hidden = [name for name, verdict in first.verdicts.items() if verdict == "not identifiable"]
        changes = "; or ".join(
            join_words([f"{n} {'grows' if w > 0 else 'falls'}" for n, w in item.items()])
            for item in first.null_directions
        )
        lines.append(
            f"All candidates together determine {design.rank} of {design.free} directions of the "
            "coefficients; the design is optimal for these. Not identifiable: "
            f"{join_words(hidden)}. The trajectories are unchanged when {changes}."
        )
    return lines


def _single_throws(design: Design) -> RenderableType:
    table = plain_table(keys=2)
    rates = len({one.rate for one in design.candidates}) > 1
    heads = ["v0\n(m/s)", "omega0\n(rad/s)", *(["rate\n(Hz)"] if rates else []), "rows"]
    for head in (*heads, "at rest\n(s)", "after\n(m)"):
        table.add_column(head, justify="right", no_wrap=True)
    for name in design.quantities:
        table.add_column(f"error of\n{name}", justify="right", no_wrap=True)
    for one in design.candidates[:_MAX_LISTED]:
        table.add_row(
            f"{one.v0:g}", f"{one.omega0:g}", *([f"{one.rate:g}"] if rates else []),
            str(one.rows), f"{one.rest:.1f}", f"{one.distance:.1f}",
            *(_error(one.stderr[name]) for name in design.quantities),
        )  # fmt: skip
    more = len(design.candidates) - _MAX_LISTED
    parts: list[RenderableType] = [table]
    if more > 0:
        parts.append(Text(f"and {more} more (in design.json)", style="dim"))
    return Padding(Group(*parts), (1, 0))


def target_text(separation: Separation) -> str:
    """The required error, as in "20 % of their mean, 0.009"."""
    reference = "their mean" if separation.of == "mean" else "their difference"
    return f"{100 * separation.wanted:g} % of {reference}, {separation.size:g}"


def _separation(design: Design, separation: Separation) -> list[RenderableType]:
    a, b = separation.pair
    parts: list[RenderableType] = [
        Text(f"Separation of {a} and {b}", style="bold"),
        _paragraph(
            f"Required: standard error of {a} - {b} {separation.wanted * separation.size:.2g}, "
            f"{target_text(separation)}."
        ),
    ]
    if separation.proof.hidden:
        parts.append(_paragraph("Uniform load: no throw can separate them.", "bold red"))
        if separation.proof.because:
            parts.append(_paragraph(f"{separation.proof.because}."))
        parts.append(_paragraph(_proof(separation.proof)))
    for scenario in separation.ways:
        if scenario.load == "uniform" and separation.proof.hidden:
            continue
        parts += _scenario(design, separation, scenario)
    if separation.changes:
        parts += _changes(design, separation)
    return parts


def _proof(proof: Proof) -> str:
    def sizes(values: tuple[float, ...]) -> str:
        return ", ".join(
            f"{name} {value:.1g}"
            for name, value in zip(("T_xi", "T_eta", "M"), values, strict=True)
        )

    return (
        f"Computed: over {proof.states} random speeds and spins, the largest derivatives of force "
        "(over m g) and moment (over m g R) along the difference are "
        f"{sizes(proof.by_difference)}; along the sum {sizes(proof.by_sum)}. {proof.throws} "
        "throws of various speeds and spins together have the singular values "
        f"{', '.join(f'{value:.2g}' for value in proof.singular_values)}: the last is zero to "
        "rounding error."
    )


def _scenario(
    design: Design, separation: Separation, scenario: LoadScenario
) -> list[RenderableType]:
    name = f"{scenario.load.capitalize()} load" + (
        " (eq. 8-9)" if scenario.load == "consistent" else ""
    )
    if scenario.throws is None or scenario.stderr is None:
        return [_paragraph(f"{name}: none of these throws can separate them.", "bold red")]
    weak = scenario.stderr > _WEAK * separation.size
    table = plain_table(keys=2)
    for head in (
        "omega0\n(rad/s)", "v0\n(m/s)", "error from\none throw", "relative",
        "noise for the\nrequired error", "or throws at\nthis noise",
    ):  # fmt: skip
        side: JustifyMethod = "left" if head.startswith("noise") else "right"
        table.add_column(head, justify=side, no_wrap=True)
    for index in _by_spin(design, scenario):
        one, stderr = design.candidates[index], scenario.each[index]
        assert stderr is not None
        table.add_row(
            f"{one.omega0:g}", f"{one.v0:g}", f"{stderr:.2g}", percent(stderr / separation.size),
            noise_text(design.sigma, separation.noise_factor(stderr)),
            _count(separation.throws_needed(stderr, 1)),
        )  # fmt: skip
    factor = separation.noise_factor(scenario.stderr)
    text = (
        f"The optimal {_throws(design.throws)}: {throws_text(design, scenario.throws)}. Error "
        f"{scenario.stderr:.2g}, that is {percent(scenario.stderr / separation.size)}: "
    )
    if factor < 1:
        needed = _count(separation.throws_needed(scenario.stderr, design.throws))
        text += (
            f"needs noise of {noise_text(design.sigma, factor)}, or {needed} throws at the present "
            f"noise, or {two_digits(1 / factor**2)} times as many rows per second."
        )
    else:
        text += f"sufficient, up to a noise of {noise_text(design.sigma, factor)}."
    if scenario.steady is not None:
        text += (
            f" The sum of both must then be the same in all of them to {percent(scenario.steady)}: "
            "such a change of the ice between throws has the same effect as the required error. "
            "The errors of single throws, above, do not depend on it."
        )
    return [
        Text(
            f"{name}: the difference is {'weakly ' if weak else ''}determined.", style="bold yellow"
        ),
        Padding(table, (1, 0)),
        _paragraph(text),
    ]


def _by_spin(design: Design, scenario: LoadScenario) -> list[int]:
    """For each spin the candidate with the smallest error by itself."""
    found: dict[float, int] = {}
    for index, stderr in enumerate(scenario.each):
        spin = design.candidates[index].omega0
        if stderr is None:
            continue
        best = scenario.each[found[spin]] if spin in found else None
        if best is None or stderr < best:
            found[spin] = index
    return list(found.values())


def _count(number: float) -> str:
    """A number of throws: an integer, rounded where it is large."""
    whole = math.ceil(number - 1e-9)
    return str(whole) if whole < 1000 else two_digits(number)


def _changes(design: Design, separation: Separation) -> list[RenderableType]:
    scenario, draw = separation.scenario("consistent"), design.candidates[separation.ordinary]
    assert scenario.stderr is not None
    count = _throws(design.throws)
    table = plain_table()
    for head in (
        "stone", f"error, {count}\nas above", "relative",
        f"error, {count} of\n{draw.v0:g} m/s, {draw.omega0:g} rad/s,\nhalf with each stone",
        "relative", "ice constant\nto", f"throws, ice\nscatter {percent(_SCATTER)}",
    ):  # fmt: skip
        table.add_column(head, justify="left" if head == "stone" else "right", no_wrap=True)

    def shown(stderr: float | None) -> tuple[str, str]:
        return _error(stderr), "-" if stderr is None else percent(stderr / separation.size)

    alone = scenario.each[separation.ordinary]
    table.add_row(
        "original", *shown(scenario.stderr),
        *shown(None if alone is None else alone / math.sqrt(design.throws)), "", "",
    )  # fmt: skip
    for item in separation.changes:
        steady = item.steady
        table.add_row(
            f"{item.name} = {1000 * item.value:.3g} mm", *shown(item.all), *shown(item.half),
            *("--" if steady is None else (
                percent(steady), _count(separation.throws_for_scatter(_SCATTER, steady))
            )),
        )  # fmt: skip
    return [_paragraph(_about_changes(separation)), Padding(table, (0, 0, 1, 0))]


def _about_changes(separation: Separation) -> str:
    a, b = separation.pair
    return (
        "Changes of the stone, under consistent load. Within one throw a change of the sum "
        "compensates nearly the whole effect of the difference. The compensation depends on the "
        "stone (it is proportional to h/R), so two stones on the same ice, with the same "
        "coefficients, are more informative than one. The last columns are the relative change of "
        f"{a} + {b} between the halves that has the same effect as the required error, and the "
        "number of throws, alternately with one stone and the other, that averages out a scatter "
        f"of the ice of {percent(_SCATTER)} from throw to throw."
    )
