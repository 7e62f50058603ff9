"""What a path determines and what it does not, in sentences."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from curlfit.foreign import counted
from curlfit.inference.verdict import Verdict
from curlfit.wording import join_words

if TYPE_CHECKING:
    from curlfit.inference.fit.result import FitResult

_WORDS = {
    "x": "x",
    "y": "y",
    "phi": "the angle",
    "speed": "the speed",
    "omega": "the spin",
}
_NUMBERS = (
    "No",
    "One",
    "Two",
    "Three",
    "Four",
    "Five",
    "Six",
    "Seven",
    "Eight",
    "Nine",
)


def identifiability(fit: FitResult) -> str:
    """What the path determines and what it does not, in sentences."""
    free = [name for name, item in fit.parameters.items() if item.verdict.is_free]
    held = [name for name in free if name not in fit.covariance["names"]]
    what, number = "The path", len(fit.events)
    if not fit.rms:
        values = "value" if number == 1 else "values"
        what = f"{_NUMBERS[number]} measured {values}"
    if any(item.prior for item in fit.parameters.values()):
        what += " and the priors determine"
    else:
        what += " determines" if fit.rms or number == 1 else " determine"
    if not fit.rms and fit.rank == len(free) and len(fit.coefficients) == 1:
        return (
            f"{what} one coefficient of friction and the initial state "
            f"({', '.join(free[1:])}): a mean friction, as in the {fit.law} law. "
            "Use `--law` to fit another law."
        )
    but = f" ({', '.join(held)} at a bound not counted)" if held else ""
    said = [f"{what} {fit.rank} of {counted(len(free) - len(held), 'parameter')}{but}."]
    unseen, by_prior, weak = (
        [name for name in free if fit.parameters[name].verdict == verdict]
        for verdict in (Verdict.NOT_IDENTIFIABLE, Verdict.PRIOR, Verdict.WEAK)
    )
    if unseen:
        changes = "; or when ".join(map(_change, fit.null_directions))
        curved = [name for name in unseen if fit.parameters[name].reason]
        near = "near these values, " if curved else ""
        said.append(
            f"{_with_verb(unseen, 'is', 'are')} not identifiable: "
            f"{near}the path stays the same when {changes}."
        )
        said += [f"Of {name}, {fit.parameters[name].reason}." for name in curved]
        said += _instead(fit, unseen)
    if by_prior:
        it = "them" if len(by_prior) > 1 else "it"
        said.append(
            f"{_with_verb(by_prior, 'rests', 'rest')} on the priors: "
            f"the path alone does not determine {it}."
        )
    for reason in dict.fromkeys(fit.parameters[name].reason for name in weak):
        alike = [name for name in weak if fit.parameters[name].reason == reason]
        each = "for each, " if len(alike) > 1 else ""
        why = f": {each}{reason}" if reason else ""
        said.append(f"{_with_verb(alike, 'is', 'are')} weakly determined{why}.")
    if not unseen:
        said += _instead(fit, weak)
    said += [
        f"Of {item.expression}, {item.reason}." for item in fit.derived if item.reason
    ]
    return " ".join(said + [_remedy(fit, one) for one in fit.remedies])


def _with_verb(names: list[str], one: str, several: str) -> str:
    return f"{join_words(names)} {several if len(names) > 1 else one}"


def _instead(fit: FitResult, names: list[str]) -> list[str]:
    """The combinations of some parameters that are determined, and all products, as a
    sentence."""
    what = [
        item.expression for item in fit.combinations if set(item.weights) & set(names)
    ]
    what += [item.expression for item in fit.products]
    if not what:
        return []
    changes = "; ".join(item.meaning for item in fit.products)
    why = f": {changes}" if changes else ""
    return [f"Only {_with_verb(what, 'is', 'are')} determined{why}."]


def _remedy(fit: FitResult, remedy: dict[str, Any]) -> str:
    """Measurements that would determine some parameters, as a sentence."""
    names, channels = remedy["parameters"], [_WORDS[name] for name in remedy["measure"]]
    if channels:
        also = join_words(channels, "and" if remedy["all"] else "or")
        return f"Measuring {also} as well would determine {join_words(names)}."
    text = f"No further measurement along this path would determine {join_words(names)}"
    own = [name for name in names if name in fit.coefficients]
    if fit.data["law_file"] or len(own) != 2:
        return text + "."
    return (
        text + f"; `curlfit design --separate {own[0]},{own[1]}` searches for "
        "throws that would."
    )


def _change(direction: dict[str, float]) -> str:
    """A null direction as a change that leaves the path the same."""
    largest, parts = max(map(abs, direction.values())), []
    for name, weight in direction.items():
        by = "" if abs(weight) == largest else f" {abs(weight):.3g} times as much"
        parts.append(f"{name} {'grows' if weight > 0 else 'falls'}{by}")
    if len(parts) == 2 and " times " not in "".join(parts):
        return f"{parts[0]} and {parts[1]} by the same amount"
    return join_words(parts)
