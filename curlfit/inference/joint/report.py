"""Report of a joint fit as text. Nothing is computed here."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Console, Group, RenderableType
from rich.padding import Padding
from rich.text import Text

from curlfit.inference.derived_report import derived_table
from curlfit.inference.report import systematics
from curlfit.output.console import terminal
from curlfit.output.text import STYLE, compact, format_estimate, plain_table
from curlfit.throws.throw import UNITS

if TYPE_CHECKING:
    from curlfit.inference.joint.result import Difference, JointResult


def print_joint(result: JointResult, console: Console | None = None) -> None:
    """Print the report of a joint fit.

    Examples
    --------
    >>> curlfit.print_joint(joint)
    front-back law, uniform load, 2 throws together; shared: mu1_xi, ...
    """
    console = console or terminal()
    console.print(report(result))


def report(result: JointResult) -> RenderableType:
    """Shared coefficients, how the throws differ in them, and each throw's own parameters."""
    heading = Text()
    heading.append(f"{result.law} law", style="bold")
    heading.append(f", {result.load} load, {len(result.throws)} throws together; shared: ")
    heading.append(f"{', '.join(result.share)}\n")
    heading.append(
        result.status[:1].upper() + result.status[1:],
        style="green" if result.converged else "bold red",
    )
    parts: list[RenderableType] = [heading, _shared(result)]
    parts += [*derived_table(result.derived), _throws(result)]
    parts.append(
        Padding(
            Text(f"The throws determine {result.rank} of {result.parameters} parameters."),
            (0, 0, 1, 0),
        )
    )
    known = {name: (item.value, item.stderr) for name, item in result.coefficients.items()}
    known |= {item.expression: (item.value, item.stderr) for item in result.combinations}
    if said := systematics(result.systematics, known):
        parts.append(Padding(Text(said), (0, 0, 1, 0)))
    parts += [
        Padding(Text(f"Warning: {warning}.", style="yellow"), (0, 0, 1, 0))
        for warning in result.warnings
    ]
    return Group(*parts)


def _shared(result: JointResult) -> RenderableType:
    table = plain_table()
    heads = [("shared", "left"), ("estimate", "right"), ("std. error", "right")]
    errors = result.systematics.errors
    for head, justify in heads + [("systematic", "right")] * bool(errors):
        table.add_column(head, justify=justify, no_wrap=True, min_width=10)  # type: ignore[arg-type]
    table.add_column("verdict", no_wrap=True, min_width=16)
    table.add_column("differs between throws")
    differences = {item.expression: item for item in result.differences}
    for name, item in result.coefficients.items():
        hidden = item.verdict == "not identifiable"
        shown = ("-", "-") if hidden else format_estimate(item.value, item.stderr)
        verdict = Text(item.verdict, style=STYLE[item.verdict])
        table.add_row(name, *shown, *_error(errors, name), verdict, _said(differences.get(name)))
    for one in result.combinations:
        verdict = Text("determined", style=STYLE["determined"])
        said = _said(differences.get(one.expression))
        shown = format_estimate(one.value, one.stderr)
        table.add_row(one.expression, *shown, *_error(errors, one.expression), verdict, said)
    return Padding(table, (1, 0))


def _error(errors: dict[str, float], name: str) -> list[str]:
    return [f"{errors[name]:.2g}" if name in errors else "-"] if errors else []


def _said(item: Difference | None) -> Text:
    if item is None:
        return Text("")
    if not item.significant:
        return Text(f"no ({item.p_text})", style="green")
    return Text(
        f"yes ({item.p_text}): spread {item.spread:.2g}, mean {compact(item.mean, item.stderr)}",
        style="yellow",
    )


def _throws(result: JointResult) -> RenderableType:
    own = [
        name
        for name in result.throws[0].parameters
        if name not in result.share and result.throws[0].parameters[name].verdict != "fixed"
    ]
    shown = [name for name in own if name not in ("x0", "y0", "phi0", "heading")]
    expressions = [item.expression for item in result.differences]
    table = plain_table()
    table.add_column("throw", no_wrap=True)
    for name in (*shown, *(f"{text} alone" for text in expressions)):
        table.add_column(name, justify="right", min_width=13 if " alone" in name else 8)
    channels = list(result.throws[0].rms)
    for name in channels:
        table.add_column(f"{name}\n(m{UNITS[name]})", justify="right", min_width=6)
    for place, one in enumerate(result.throws):
        estimates = [one.parameters[name] for name in shown]
        row = [format_estimate(item.value, item.stderr)[0] for item in estimates]
        for item in result.differences:
            alone = item.each[place]
            row.append("" if alone is None else compact(*alone))
        row += [f"{1000 * one.rms[name]:.3g}" if name in one.rms else "" for name in channels]
        table.add_row(one.data["file"].rpartition("/")[2], *row)
    return Padding(table, (0, 0, 1, 0))
