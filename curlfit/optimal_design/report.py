"""What planned throws would tell, as text. Nothing is computed here."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from typing import TYPE_CHECKING

from rich.console import Console, Group, JustifyMethod, RenderableType
from rich.padding import Padding
from rich.text import Text

from curlfit.output.console import terminal
from curlfit.output.text import STYLE, join_words, plain_table

if TYPE_CHECKING:
    from curlfit.optimal_design.result import Candidate, Design, Expected, Proof, Separation, Way

_CRITERIA = {
    "D": "smallest volume of the errors together (D-optimal)",
    "A": "smallest mean squared error over typical sizes (A-optimal)",
}
_WEAK = 0.05  # relative error of a difference above which it shows but weakly
_SCATTER = 0.01  # of the ice from throw to throw, relative, for what it costs in throws
_MOST_LISTED = 24  # candidates; the rest is in design.json
_SMALL = {"x": ("m", "mm", "um"), "phi": ("rad", "mrad", "urad")}
_UNITS = {
    "x": _SMALL["x"], "y": _SMALL["x"], "phi": _SMALL["phi"],
    "speed": ("m/s", "mm/s", "um/s"), "omega": ("rad/s", "mrad/s", "urad/s"),
}  # fmt: skip


def print_design(design: Design, console: Console | None = None) -> None:
    """Print what planned throws would tell."""
    console = console or terminal()
    console.print(report(design))


def report(design: Design) -> RenderableType:
    """The report of a design, for a rich console."""
    parts: list[RenderableType] = [_heading(design), _best(design)]
    parts += [_paragraph(line) for line in _sentences(design)]
    parts += [Text("What one of these throws alone would tell", style="bold"), _alone(design)]
    if design.separation is not None:
        parts += _separation(design, design.separation)
    parts += [Text(f"Note: {note}.", style="dim") for note in design.notes]
    return Group(*parts)


def _paragraph(text: str, style: str = "") -> RenderableType:
    return Padding(Text(text, style=style), (0, 0, 1, 0))


def noise(sigma: dict[str, float], factor: float = 1.0) -> str:
    """Noise by channel in words, as in "5 mm in x and y, 10 mrad in phi"."""
    same: dict[str, list[str]] = {}
    for name, value in sigma.items():
        same.setdefault(small(value * factor, name), []).append(name)
    return ", ".join(f"{size} in {join_words(names)}" for size, names in same.items())


def small(value: float, channel: str) -> str:
    """A size in a unit that suits it, as in "12 um"."""
    place = min(max(math.ceil(-math.log10(value) / 3 - 1e-9), 0), 2)
    return f"{rough(value * 1000**place)} {_UNITS[channel][place]}"


def rough(value: float) -> str:
    """Two digits of a number, without an exponent up to a million."""
    return f"{float(f'{value:.2g}'):g}"


def percent(share: float) -> str:
    """A share as in "0.12 %"."""
    return f"{rough(100 * share)} %"


def made(design: Design, places: Iterable[int]) -> str:
    """Throws in words, as in "2 x (2.2 m/s, 10 rad/s)"."""
    return " and ".join(
        f"{count} x ({_start(design, design.candidates[place])})"
        for place, count in Counter(places).items()
    )


def _start(design: Design, one: Candidate) -> str:
    rates = {item.rate for item in design.candidates}
    more = f", {one.rate:g} Hz" if len(rates) > 1 else ""
    return f"{one.v0:g} m/s, {one.omega0:g} rad/s{more}"


def _throws(count: int) -> str:
    return "1 throw" if count == 1 else f"{count} throws"


def _heading(design: Design) -> RenderableType:
    stone, until = design.stone, design.until
    rates = sorted({one.rate for one in design.candidates})
    text = Text()
    text.append(f"{design.law} law", style="bold")
    text.append(f", {design.load} load: what ")
    text.append(f"{_throws(design.throws)} would tell, {len(design.candidates)} to choose from\n")
    text.append(
        f"{', '.join(f'{rate:g}' for rate in rates)} Hz "
        f"{'until the stone is at rest' if until is None else f'for {until:g} s'}, independent "
        f"noise of {noise(design.sigma)}; stone R = {stone.R:g} m, rho = {stone.rho:g} m, "
        f"h = {stone.h:g} m"
    )
    return text


def _best(design: Design) -> RenderableType:
    table = plain_table()
    table.add_column("coefficient", no_wrap=True)
    table.add_column("taken as", justify="right", no_wrap=True)
    alike = len({item.throws for item in design.best.values()}) == 1
    shown = dict(list(design.best.items())[:1]) if alike else design.best
    for name in shown:
        by = "" if alike else f" by {name}"
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


def _value(found: Expected, expression: str) -> float:
    return next(item.value for item in found.combinations if item.expression == expression)


def _error(stderr: float | None) -> str:
    return "-" if stderr is None else f"{stderr:.2g}"


def _sentences(design: Design) -> list[str]:
    lines = []
    best = {name: made(design, item.throws) for name, item in design.best.items()}
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
            "coefficients, and the best are judged on these. Not identifiable: "
            f"{join_words(hidden)}. "
            f"The paths stay the same when {changes}."
        )
    return lines


def _alone(design: Design) -> RenderableType:
    table = plain_table(keys=2)
    rates = len({one.rate for one in design.candidates}) > 1
    heads = ["v0\n(m/s)", "omega0\n(rad/s)", *(["rate\n(Hz)"] if rates else []), "rows"]
    for head in (*heads, "at rest\n(s)", "after\n(m)"):
        table.add_column(head, justify="right", no_wrap=True)
    for name in design.quantities:
        table.add_column(f"error of\n{name}", justify="right", no_wrap=True)
    for one in design.candidates[:_MOST_LISTED]:
        table.add_row(
            f"{one.v0:g}", f"{one.omega0:g}", *([f"{one.rate:g}"] if rates else []),
            str(one.rows), f"{one.rest:.1f}", f"{one.distance:.1f}",
            *(_error(one.stderr[name]) for name in design.quantities),
        )  # fmt: skip
    more = len(design.candidates) - _MOST_LISTED
    parts: list[RenderableType] = [table]
    if more > 0:
        parts.append(Text(f"and {more} more (in design.json)", style="dim"))
    return Padding(Group(*parts), (1, 0))


def wanted(parted: Separation) -> str:
    """What is asked for, as in "20 % of their mean 0.009"."""
    of = "their mean" if parted.of == "mean" else "their difference"
    return f"{100 * parted.wanted:g} % of {of}, {parted.size:g}"


def _separation(design: Design, parted: Separation) -> list[RenderableType]:
    a, b = parted.pair
    parts: list[RenderableType] = [
        Text(f"Telling {a} from {b}", style="bold"),
        _paragraph(
            f"Asked for: a standard error of {a} - {b} of {parted.wanted * parted.size:.2g}, "
            f"{wanted(parted)}."
        ),
    ]
    if parted.proof.hidden:
        parts.append(_paragraph("Uniform load: no throw can tell them apart.", "bold red"))
        if parted.proof.because:
            parts.append(_paragraph(f"{parted.proof.because}."))
        parts.append(_paragraph(_proof(parted.proof)))
    for way in parted.ways:
        if way.load == "uniform" and parted.proof.hidden:
            continue
        parts += _way(design, parted, way)
    if parted.changes:
        parts += _changes(design, parted)
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
        "throws of many speeds and spins together have the singular values "
        f"{', '.join(f'{value:.2g}' for value in proof.singular_values)}: the last is rounding."
    )


def _way(design: Design, parted: Separation, way: Way) -> list[RenderableType]:
    name = f"{way.load.capitalize()} load" + (" (eq. 8-9)" if way.load == "consistent" else "")
    if way.throws is None or way.stderr is None:
        return [_paragraph(f"{name}: none of these throws can tell them apart.", "bold red")]
    weak = way.stderr > _WEAK * parted.size
    table = plain_table(keys=2)
    for head in (
        "omega0\n(rad/s)", "v0\n(m/s)", "error from\none throw", "relative",
        "noise for what\nis asked", "or throws at\nthis noise",
    ):  # fmt: skip
        side: JustifyMethod = "left" if head.startswith("noise") else "right"
        table.add_column(head, justify=side, no_wrap=True)
    for place in _by_spin(design, way):
        one, stderr = design.candidates[place], way.each[place]
        assert stderr is not None
        table.add_row(
            f"{one.omega0:g}", f"{one.v0:g}", f"{stderr:.2g}", percent(stderr / parted.size),
            noise(design.sigma, parted.noise_factor(stderr)),
            _many(parted.throws_needed(stderr, 1)),
        )  # fmt: skip
    factor = parted.noise_factor(way.stderr)
    text = (
        f"The {_throws(design.throws)} that tell it best: {made(design, way.throws)}. Error "
        f"{way.stderr:.2g}, that is {percent(way.stderr / parted.size)}: "
    )
    if factor < 1:
        needed = _many(parted.throws_needed(way.stderr, design.throws))
        text += (
            f"needs noise of {noise(design.sigma, factor)}, or {needed} throws at the present "
            f"noise, or {rough(1 / factor**2)} times as many rows a second."
        )
    else:
        text += f"enough, up to a noise of {noise(design.sigma, factor)}."
    if way.steady is not None:
        text += (
            f" The sum of both must then be the same in all of them to {percent(way.steady)}: such "
            "a change of the ice from throw to throw would be taken for the error asked for. What "
            "single throws tell, above, does not rely on it."
        )
    return [
        Text(f"{name}: the difference shows{', but weakly' if weak else ''}.", style="bold yellow"),
        Padding(table, (1, 0)),
        _paragraph(text),
    ]


def _by_spin(design: Design, way: Way) -> list[int]:
    """For each spin the candidate that tells most by itself."""
    found: dict[float, int] = {}
    for place, stderr in enumerate(way.each):
        spin = design.candidates[place].omega0
        if stderr is None:
            continue
        best = way.each[found[spin]] if spin in found else None
        if best is None or stderr < best:
            found[spin] = place
    return list(found.values())


def _many(number: float) -> str:
    """A number of throws: whole, and rough where it is large."""
    whole = math.ceil(number - 1e-9)
    return str(whole) if whole < 1000 else rough(number)


def _changes(design: Design, parted: Separation) -> list[RenderableType]:
    way, draw = parted.way("consistent"), design.candidates[parted.ordinary]
    assert way.stderr is not None
    count = _throws(design.throws)
    table = plain_table()
    for head in (
        "stone", f"error, {count}\nas above", "relative",
        f"error, {count} of\n{draw.v0:g} m/s, {draw.omega0:g} rad/s,\nhalf with each stone",
        "relative", "ice steady\nto", f"throws, ice\nscattering {percent(_SCATTER)}",
    ):  # fmt: skip
        table.add_column(head, justify="left" if head == "stone" else "right", no_wrap=True)

    def shown(stderr: float | None) -> tuple[str, str]:
        return _error(stderr), "-" if stderr is None else percent(stderr / parted.size)

    alone = way.each[parted.ordinary]
    table.add_row(
        "as it is", *shown(way.stderr),
        *shown(None if alone is None else alone / math.sqrt(design.throws)), "", "",
    )  # fmt: skip
    for item in parted.changes:
        steady = item.steady
        table.add_row(
            f"{item.name} = {1000 * item.value:.3g} mm", *shown(item.all), *shown(item.half),
            *("--" if steady is None else (
                percent(steady), _many(parted.throws_against(_SCATTER, steady))
            )),
        )  # fmt: skip
    return [_paragraph(_about_changes(parted)), Padding(table, (0, 0, 1, 0))]


def _about_changes(parted: Separation) -> str:
    a, b = parted.pair
    return (
        "Changes to the stone, under consistent load. Within one throw the sum makes up for nearly "
        "all that the difference does. How much of it differs from stone to stone (it goes with "
        "h/R), so two stones on the same ice, with the same coefficients, tell more than any one. "
        f"The last columns are how far {a} + {b} may differ between the halves, relatively, before "
        "that is taken for the error asked for, and how many throws, with one stone and the other "
        f"in turn, average out ice that scatters by {percent(_SCATTER)} from throw to throw."
    )
