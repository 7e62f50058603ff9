"""What a design says. Nothing is computed here."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

from rich.console import Console
from rich.text import Text

from curlfit.foreign import counted
from curlfit.inference.information.verdict import Verdict
from curlfit.optimal_design.result import (
    Candidate,
    Design,
    ExpectedErrors,
    Scenario,
    Separation,
)
from curlfit.optimal_design.throw_columns import (
    DISTANCE,
    OMEGA0,
    REST,
    ROWS,
    V0,
    error_in_words,
    stderr_column,
)
from curlfit.output.document import Document, Said, Section, show
from curlfit.output.table import Column, Table
from curlfit.output.text import coloured_verdict, labelled, stone_text
from curlfit.stone import Stone
from curlfit.wording import join_words, lower, two_digits

_CRITERIA = {
    "D": "smallest volume of the confidence ellipsoid (D-optimal)",
    "A": "smallest mean squared standard error, in units of typical sizes (A-optimal)",
}
_WORTH = 1.2
"""Factor by which a scenario that is recommended reduces a systematic error."""
_NEARLY = 0.8
"""Share of the largest such factor that a simpler scenario has to reach."""
_MAX_LISTED = 24  # candidates; the others are in design.json
_UNITS = {"x": "m", "y": "m", "phi": "rad", "speed": "m/s", "omega": "rad/s"}


def print_design(design: Design, console: Console | None = None) -> None:
    """Print the report of a design.

    Examples
    --------
    >>> curlfit.print_design(plan)
    front-back law, uniform load: expected errors of 3 throws selected from 4
    ...
    """
    show(document(design), console)


def document(design: Design) -> Document:
    """The best throws and the errors that they give."""
    sentences = _summary(design)
    law = f"{design.law} law"
    about = (
        f", {design.load} load: expected errors of {counted(design.throws, 'throw')} "
        f"selected from {len(design.candidates)}"
    )
    scenarios = design.scenarios
    record = measured(
        design.rate, design.until, design.sigma, design.stone, design.discrepancy
    )
    return Document(
        finding=lower(sentences[0]).rstrip("."),
        subject=Text.assemble((law, "bold"), about),
        about=(record,),
        lines=[record, *sentences[1:]],
        sections=(
            Section(
                "errors",
                "Expected errors",
                (_best(design), *map(Said, sentences)),
            ),
            Section(
                "systematic",
                "Systematic errors of these throws",
                (_scenarios(design), _recommended(scenarios)) if scenarios else (),
                titled=True,
                brief=False,
            ),
            Section(
                "single",
                "Expected errors from a single throw",
                (_single_throws(design),),
                titled=True,
                brief=False,
            ),
        ),
        notes=design.notes,
        title=f"Design: {law}",
        settings={
            "Law, load": f"{design.law}, {design.load}",
            "Coefficients": ", ".join(
                f"{name} = {value:g}" for name, value in design.coefficients.items()
            ),
            "Stone": stone_text(design.stone),
            "Noise": noise_text(design.sigma),
            "Throws": str(design.throws),
        },
        command=design.command,
        names=design.coefficients,
    )


def noise_text(sigma: dict[str, float]) -> str:
    """Noise by channel, as in "5 mm in x and y, 10 mrad in phi"."""
    channels: dict[str, list[str]] = {}
    for name, value in sigma.items():
        channels.setdefault(with_unit(value, name), []).append(name)
    return ", ".join(
        f"{size} in {join_words(names)}" for size, names in channels.items()
    )


def with_unit(value: float, channel: str) -> str:
    """A value in a suitable unit, as in "12 um"."""
    # the power of a thousandth in which the value is 1 or more, if milli or micro is
    power = min(max(math.ceil(-math.log10(value) / 3 - 1e-9), 0), 2)
    prefix = ("", "m", "u")[power]
    return f"{two_digits(value * 1000**power)} {prefix}{_UNITS[channel]}"


def throws_text(candidates: Sequence[Any], indices: Iterable[int]) -> str:
    """Throws as in "2 x (2.2 m/s, 10 rad/s)"."""
    return " and ".join(
        f"{count} x ({_start(candidates[index])})"
        for index, count in Counter(indices).items()
    )


def _start(throw: Any) -> str:
    return f"{throw.v0:g} m/s, {throw.omega0:g} rad/s"


def measured(
    rate: float,
    until: float | None,
    sigma: dict[str, float],
    stone: Stone,
    discrepancy: float = 0.0,
) -> str:
    """What is measured of each throw, in a line."""
    end = "until the stone is at rest" if until is None else f"for {until:g} s"
    lacking = ""
    if discrepancy:
        lacking = f", a discrepancy of {100 * discrepancy:.2g} % of what friction does"
    return (
        f"{rate:g} Hz {end}, independent noise of {noise_text(sigma)}{lacking}; "
        f"stone {stone_text(stone, mass=False)}"
    )


def _scenarios(design: Design) -> Table[str]:
    """The systematic error of each quantity in each scenario."""
    columns: list[Column[str]] = [
        Column("coefficient", lambda name: name),
        *map(_scenario_column, design.scenarios),
    ]
    return Table(
        list(design.quantities),
        columns,
        "Systematic errors by how the throws are divided",
    )


def _scenario_column(scenario: Scenario) -> Column[str]:
    """The column of the systematic errors in a scenario, by quantity."""
    return Column(
        scenario.name, scenario.systematic.__getitem__, two_digits, right=True
    )


def _recommended(scenarios: Sequence[Scenario]) -> str:
    """The simplest scenario with nearly the largest gain, if there is a gain."""
    planned = scenarios[0].systematic
    gains = {
        scenario.name: max(
            planned[name] / max(error, 1e-300)
            for name, error in scenario.systematic.items()
        )
        for scenario in scenarios[1:]
    }
    best = next(
        name for name, gain in gains.items() if gain > _NEARLY * max(gains.values())
    )
    if gains[best] <= _WORTH:
        return "Throwing with both spins or in both directions cancels little."
    return (
        f"Throw with {best}, in equal shares: the systematic errors, mostly by ice "
        f"that is not level, become smaller by up to a factor of {gains[best]:.2g}."
    )


def _best(design: Design) -> Table[str]:
    """The expected errors of the best throws, by quantity; a column for each selection,
    as criteria may select different throws."""
    first = next(iter(design.best.values()))
    criteria: dict[tuple[int, ...], list[str]] = {}
    for name, errors in design.best.items():
        criteria.setdefault(errors.throws, []).append(name)
    assumed = {sum_.expression: sum_.value for sum_ in first.combinations}
    for name, weights in design.quantities.items():
        assumed[name] = sum(
            weight * design.coefficients[coefficient]
            for coefficient, weight in weights.items()
        )
    assumed |= design.coefficients
    heading = f"std. error, best {counted(design.throws, 'throw')}"
    columns: list[Column[str]] = [
        Column("coefficient", lambda name: labelled(name, design.units.get(name, "1"))),
        Column("assumed", assumed.__getitem__, ".6g", right=True),
    ]
    for names in criteria.values():
        by = f" by {join_words(names)}" if len(criteria) > 1 else ""
        columns.append(_best_column(f"{heading}{by}", design.best[names[0]]))
    columns.append(
        Column(
            "verdict",
            lambda name: first.verdicts.get(name, Verdict.DETERMINED),
            coloured_verdict,
        )
    )
    return Table(
        list(first.stderr), columns, "The best throws: expected standard errors"
    )


def _best_column(heading: str, errors: ExpectedErrors) -> Column[str]:
    """The column of the standard errors of a selection of throws, by quantity."""
    return Column(
        heading, words=lambda name: error_in_words(errors.stderr.get(name)), right=True
    )


def _criterion(design: Design, name: str) -> str:
    """What a criterion of optimality makes smallest."""
    if name == "C" and design.separation is not None:
        return f"smallest standard error of {design.separation.difference} (C-optimal)"
    return _CRITERIA[name]


def _summary(design: Design) -> list[str]:
    criteria_by_throws: dict[str, list[str]] = {}
    for name, errors in design.best.items():
        throws = throws_text(design.candidates, errors.throws)
        criteria_by_throws.setdefault(throws, []).append(_criterion(design, name))
    lines = [
        f"Best {counted(design.throws, 'throw')}: {throws}, "
        f"by {' and by '.join(criteria)}."
        for throws, criteria in criteria_by_throws.items()
    ]
    first = next(iter(design.best.values()))
    if design.rank < design.free:
        hidden = [
            name
            for name, verdict in first.verdicts.items()
            if verdict == Verdict.NOT_IDENTIFIABLE
        ]
        changes = "; or ".join(
            join_words(
                [
                    f"{name} {'grows' if weight > 0 else 'falls'}"
                    for name, weight in direction.items()
                ]
            )
            for direction in first.null_directions
        )
        lines.append(
            f"All candidates together determine {design.rank} of {design.free} "
            "directions of the coefficients; the design is optimal for these. "
            f"Not identifiable: {join_words(hidden)}. The trajectories are "
            f"unchanged when {changes}."
        )
    if design.separation is not None:
        lines += _not_separated(design.separation)
    return lines


def _single_throws(design: Design) -> Table[Candidate]:
    """The expected errors from each candidate alone."""
    errors = map(stderr_column, design.quantities)
    more = len(design.candidates) - _MAX_LISTED
    note = Text(f"and {more} more (in design.json)", style="dim") if more > 0 else None
    return Table(
        design.candidates[:_MAX_LISTED],
        (V0, OMEGA0, ROWS, REST, DISTANCE, *errors),
        "Expected errors from a single throw",
        keys=2,
        note=note,
    )


def _not_separated(separation: Separation) -> list[str]:
    """The loads under which no throws separate two coefficients, a sentence each."""
    pair = join_words(separation.pair)
    return [
        f"Under {scenario.load} load, none of these throws separate {pair}."
        for scenario in separation.ways
        if scenario.throws is None
    ]
