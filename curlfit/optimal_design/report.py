"""What a design says. Nothing is computed here."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

from rich.console import Console
from rich.text import Text

from curlfit.foreign import counted
from curlfit.inference.verdict import Verdict
from curlfit.optimal_design.result import (
    Design,
    LoadScenario,
    Proof,
    Scenario,
    Separation,
    StoneChange,
)
from curlfit.output.console import PlainTable
from curlfit.output.document import Document, Part, Said, Section, show
from curlfit.output.text import (
    join_words,
    judged,
    labelled,
    lower,
    stone_text,
    two_digits,
)
from curlfit.stone import Stone

_CRITERIA = {
    "D": "smallest volume of the confidence ellipsoid (D-optimal)",
    "A": "smallest mean squared standard error, in units of typical sizes (A-optimal)",
}
_FORCES = ("T_xi", "T_eta", "M")
_WEAK = 0.05  # relative error above which a difference is weakly determined
_SCATTER = 0.01  # relative variation of the ice from throw to throw
# factor of reduction of a systematic error above which a scenario is recommended
_WORTH = 1.2
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
    best, *others = _summary(design)
    law = f"{design.law} law"
    about = (
        f", {design.load} load: expected errors of {counted(design.throws, 'throw')} "
        f"selected from {len(design.candidates)}"
    )
    scenarios = design.scenarios
    what = measured(
        design.rate, design.until, design.sigma, design.stone, design.discrepancy
    )
    return Document(
        finding=lower(best).rstrip("."),
        subject=Text.assemble((law, "bold"), about),
        about=(what,),
        lines=[what, *others],
        sections=(
            Section(
                "errors",
                "Expected errors",
                (_best(design), Said(best), *map(Said, others)),
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
            *(
                []
                if design.separation is None
                else [_separation(design, design.separation)]
            ),
        ),
        notes=design.notes,
        title=f"Design: {law}",
        settings={
            "Law, load": f"{design.law}, {design.load}",
            "Coefficients": ", ".join(
                f"{name} = {v:g}" for name, v in design.coefficients.items()
            ),
            "Stone": stone_text(design.stone),
            "Noise": noise_text(design.sigma),
            "Throws": str(design.throws),
        },
        command=design.command,
        names=design.coefficients,
    )


def noise_text(sigma: dict[str, float], factor: float = 1.0) -> str:
    """Noise by channel, as in "5 mm in x and y, 10 mrad in phi"."""
    same: dict[str, list[str]] = {}
    for name, value in sigma.items():
        same.setdefault(with_unit(value * factor, name), []).append(name)
    return ", ".join(f"{size} in {join_words(names)}" for size, names in same.items())


def with_unit(value: float, channel: str) -> str:
    """A value in a suitable unit, as in "12 um"."""
    index = min(max(math.ceil(-math.log10(value) / 3 - 1e-9), 0), 2)
    return f"{two_digits(value * 1000**index)} {('', 'm', 'u')[index]}{_UNITS[channel]}"


def percent(fraction: float) -> str:
    """A fraction as in "0.12 %"."""
    return f"{two_digits(100 * fraction)} %"


def throws_text(candidates: Sequence[Any], indices: Iterable[int]) -> str:
    """Throws as in "2 x (2.2 m/s, 10 rad/s)"."""
    return " and ".join(
        f"{count} x ({_start(candidates[index])})"
        for index, count in Counter(indices).items()
    )


def _start(one: Any) -> str:
    return f"{one.v0:g} m/s, {one.omega0:g} rad/s"


def measured(
    rate: float,
    until: float | None,
    sigma: dict[str, float],
    stone: Stone,
    discrepancy: float = 0.0,
) -> str:
    """What is measured of each throw, in a line."""
    end = "until the stone is at rest" if until is None else f"for {until:g} s"
    lacking = f", a discrepancy of {100 * discrepancy:.2g} % of what friction does"
    return (
        f"{rate:g} Hz {end}, independent noise of {noise_text(sigma)}"
        f"{lacking * bool(discrepancy)}; stone {stone_text(stone, mass=False)}"
    )


def _scenarios(design: Design) -> PlainTable:
    """The systematic error of each quantity in each scenario."""
    return PlainTable(
        (
            {"coefficient": name}
            | {
                f">{one.name}": two_digits(one.systematic[name])
                for one in design.scenarios
            }
            for name in design.quantities
        ),
        "Systematic errors by how the throws are divided",
    )


def _recommended(scenarios: Sequence[Scenario]) -> str:
    """The simplest scenario with nearly the largest gain, if there is a gain."""
    first, *others = (one.systematic for one in scenarios)
    gains = {
        one.name: max(
            first[name] / max(error, 1e-300) for name, error in systematic.items()
        )
        for one, systematic in zip(scenarios[1:], others, strict=True)
    }
    best = next(
        name for name, gain in gains.items() if gain > 0.8 * max(gains.values())
    )
    if gains[best] <= _WORTH:
        return "Throwing with both spins or in both directions cancels little."
    return (
        f"Throw with {best}, in equal shares: the systematic errors, mostly by ice "
        f"that is not level, become smaller by up to a factor of {gains[best]:.2g}."
    )


def _best(design: Design) -> PlainTable:
    first, *others = design.best.values()
    same = all(item.throws == first.throws for item in others)
    shown = (
        {"": first}
        if same
        else {f" by {name}": item for name, item in design.best.items()}
    )
    assumed = {
        one.expression: one.value for one in first.combinations
    } | design.coefficients
    head = f">std. error, best {counted(design.throws, 'throw')}"
    rows = [
        {
            "coefficient": labelled(name, design.units.get(name, "1")),
            ">assumed": f"{assumed[name]:.6g}",
            **{
                f"{head}{by}": _error(item.stderr.get(name))
                for by, item in shown.items()
            },
            "verdict": judged(first.verdicts.get(name, Verdict.DETERMINED)),
        }
        for name in first.stderr
    ]
    return PlainTable(rows, "The best throws: expected standard errors")


def _error(stderr: float | None) -> str:
    return "-" if stderr is None else f"{stderr:.2g}"


def _summary(design: Design) -> list[str]:
    throws: dict[str, list[str]] = {}
    for name, item in design.best.items():
        throws.setdefault(throws_text(design.candidates, item.throws), []).append(
            _CRITERIA[name]
        )
    lines = [
        f"Best {counted(design.throws, 'throw')}: {text}, "
        f"by {' and by '.join(criteria)}."
        for text, criteria in throws.items()
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
                [f"{n} {'grows' if w > 0 else 'falls'}" for n, w in item.items()]
            )
            for item in first.null_directions
        )
        lines.append(
            f"All candidates together determine {design.rank} of {design.free} "
            "directions of the coefficients; the design is optimal for these. "
            f"Not identifiable: {join_words(hidden)}. The trajectories are "
            f"unchanged when {changes}."
        )
    return lines


def _single_throws(design: Design) -> PlainTable:
    rows = [
        {
            ">v0\n(m/s)": f"{one.v0:g}",
            ">omega0\n(rad/s)": f"{one.omega0:g}",
            ">rows": str(one.rows),
            ">at rest\n(s)": f"{one.rest:.1f}",
            ">after\n(m)": f"{one.distance:.1f}",
            **{
                f">error of\n{name}": _error(one.stderr[name])
                for name in design.quantities
            },
        }
        for one in design.candidates[:_MAX_LISTED]
    ]
    more = len(design.candidates) - _MAX_LISTED
    note = Text(f"and {more} more (in design.json)", style="dim") if more > 0 else None
    return PlainTable(rows, "Expected errors from a single throw", keys=2, note=note)


def _separation(design: Design, separation: Separation) -> Section:
    (a, b), proof, size = separation.pair, separation.proof, separation.size
    parts: list[Part] = [
        f"Required: standard error of {a} - {b} {separation.wanted * size:.2g}, "
        f"{100 * separation.wanted:g} % of their {separation.of}, {size:g}."
    ]
    if proof.hidden:
        parts += [
            Text("Uniform load: no throw can separate them.", style="bold red"),
            f"{proof.because}." if proof.because else "",
            _proof(proof),
        ]
    for scenario in separation.ways:
        if not (scenario.load == "uniform" and proof.hidden):
            parts += _scenario(design, separation, scenario)
    if separation.changes:
        parts += [_about_changes(separation), _changes(design, separation)]
    heading = f"Separation of {a} and {b}"
    return Section("separation", heading, parts, titled=True, brief=False)


def _proof(proof: Proof) -> str:
    by_difference, by_sum = (
        ", ".join(
            f"{name} {value:.1g}" for name, value in zip(_FORCES, values, strict=True)
        )
        for values in (proof.by_difference, proof.by_sum)
    )
    return (
        f"Computed: over {proof.states} random speeds and spins, "
        "the largest derivatives of force (over m g) and moment (over m g R) along "
        f"the difference are {by_difference}; along the sum {by_sum}. {proof.throws} "
        "throws of various speeds and spins together have the singular values "
        f"{', '.join(f'{value:.2g}' for value in proof.singular_values)}: "
        "the last is zero to rounding error."
    )


def _scenario(
    design: Design, separation: Separation, scenario: LoadScenario
) -> list[Part]:
    name = (
        f"{scenario.load.capitalize()} "
        f"load{' (eq. 8-9)' * (scenario.load == 'consistent')}"
    )
    if scenario.throws is None or scenario.stderr is None:
        return [
            Text(f"{name}: none of these throws can separate them.", style="bold red")
        ]
    weak, rows = scenario.stderr > _WEAK * separation.size, []
    for spin in dict.fromkeys(one.omega0 for one in design.candidates):
        own = [
            (stderr, one.v0)
            for one, stderr in zip(design.candidates, scenario.each, strict=True)
            if one.omega0 == spin and stderr is not None
        ]
        for stderr, v0 in sorted(own)[:1]:
            noise = noise_text(design.sigma, separation.noise_factor(stderr))
            rows.append(
                {
                    ">omega0\n(rad/s)": f"{spin:g}",
                    ">v0\n(m/s)": f"{v0:g}",
                    ">error from\none throw": f"{stderr:.2g}",
                    ">relative": percent(stderr / separation.size),
                    "noise for the\nrequired error": noise,
                    ">or throws at\nthis noise": _count(
                        separation.throws_needed(stderr, 1)
                    ),
                }
            )
    return [
        Text(
            f"{name}: the difference is {'weakly ' * weak}determined.",
            style="bold yellow",
        ),
        PlainTable(rows, f"{name}: the best throw of each spin", keys=2),
        _optimal(design, separation, scenario, scenario.stderr),
    ]


def _optimal(
    design: Design, separation: Separation, scenario: LoadScenario, stderr: float
) -> str:
    """The optimal throws for a separation, and what they would need."""
    factor = separation.noise_factor(stderr)
    text = (
        f"The optimal {counted(design.throws, 'throw')}: "
        f"{throws_text(design.candidates, scenario.throws or ())}. Error "
        f"{stderr:.2g}, that is {percent(stderr / separation.size)}: "
    )
    if factor < 1:
        needed = _count(separation.throws_needed(stderr, design.throws))
        text += (
            f"needs noise of {noise_text(design.sigma, factor)}, "
            f"or {needed} throws at the present noise, or {two_digits(1 / factor**2)} "
            "times as many rows per second."
        )
    else:
        text += f"sufficient, up to a noise of {noise_text(design.sigma, factor)}."
    if scenario.steady is not None:
        text += (
            " The sum of both must then be the same in all of them to "
            f"{percent(scenario.steady)}: such a change of the ice between throws "
            "has the same effect as the required error. The errors of single throws, "
            "above, do not depend on it."
        )
    return text


def _count(number: float) -> str:
    """A number of throws: an integer, rounded where it is large."""
    whole = math.ceil(number - 1e-9)
    return str(whole) if whole < 1000 else two_digits(number)


def _changes(design: Design, separation: Separation) -> PlainTable:
    scenario, draw = (
        separation.scenario("consistent"),
        design.candidates[separation.ordinary],
    )
    count, alone = counted(design.throws, "throw"), scenario.each[separation.ordinary]
    single = None if alone is None else alone / math.sqrt(design.throws)
    original = StoneChange("", 0.0, scenario.stderr, single, None)
    rows = []
    for item in (original, *separation.changes):
        whole, half = (
            "-" if one is None else percent(one / separation.size)
            for one in (item.all, item.half)
        )
        steady = averaged = "--" * bool(item.name)
        if item.steady:
            steady = percent(item.steady)
            averaged = _count((2 * _SCATTER / item.steady) ** 2)
        rows.append(
            {
                "stone": f"{item.name} = {1000 * item.value:.3g} mm"
                if item.name
                else "original",
                f">error, {count}\nas above": _error(item.all),
                ">relative": whole,
                f">error, {count} of\n{_start(draw)},\nhalf with each stone": _error(
                    item.half
                ),
                "> relative": half,
                ">ice constant\nto": steady,
                f">throws, ice\nscatter {percent(_SCATTER)}": averaged,
            }
        )
    return PlainTable(rows, "Changes of the stone")


def _about_changes(separation: Separation) -> str:
    a, b = separation.pair
    return (
        "Changes of the stone, under consistent load. Within one throw a change "
        "of the sum compensates nearly the whole effect of the difference. "
        "The compensation depends on the stone (it is proportional to h/R), "
        "so two stones on the same ice, with the same coefficients, "
        "are more informative than one. The last columns are the relative change of "
        f"{a} + {b} between the halves that has the same effect as the required error, "
        "and the number of throws, alternately with one stone and the other, that "
        f"averages out a scatter of the ice of {percent(_SCATTER)} from throw to throw."
    )
