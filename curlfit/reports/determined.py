"""What a path determines and what it does not, in sentences."""

from __future__ import annotations

from typing import TYPE_CHECKING

from curlfit.foreign import counted
from curlfit.inference.information.verdict import Verdict
from curlfit.wording import join_words

if TYPE_CHECKING:
    from curlfit.inference.fit.entries import FurtherMeasurement
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


def sentences_on(fit: FitResult) -> str:
    """Sentences on what the path determines, what it does not, and what would help."""
    free = [
        name for name, parameter in fit.parameters.items() if parameter.verdict.is_free
    ]
    at_bound = [name for name in free if name not in fit.covariance.names]
    subject = _determining(fit)
    if (
        not fit.rms
        and fit.identifiability.rank == len(free)
        and len(fit.coefficients) == 1
    ):
        return (
            f"{subject} one coefficient of friction and the initial state "
            f"({', '.join(free[1:])}): a mean friction, as in the {fit.law} law. "
            "Use `--law` to fit another law."
        )
    number = counted(len(free) - len(at_bound), "parameter")
    apart = f" ({', '.join(at_bound)} at a bound not counted)" if at_bound else ""
    sentences = [f"{subject} {fit.identifiability.rank} of {number}{apart}."]

    names_by_verdict: dict[Verdict, list[str]] = {}
    for name in free:
        names_by_verdict.setdefault(fit.parameters[name].verdict, []).append(name)
    hidden = names_by_verdict.get(Verdict.NOT_IDENTIFIABLE, [])
    from_prior = names_by_verdict.get(Verdict.PRIOR, [])
    weak = names_by_verdict.get(Verdict.WEAK, [])

    if hidden:
        sentences += _hidden(fit, hidden)
    if from_prior:
        pronoun = "them" if len(from_prior) > 1 else "it"
        sentences.append(
            f"{_with_verb(from_prior, 'rests', 'rest')} on the priors: "
            f"the path alone does not determine {pronoun}."
        )
    weak_by_reason: dict[str, list[str]] = {}
    for name in weak:
        weak_by_reason.setdefault(fit.parameters[name].reason, []).append(name)
    for reason, names in weak_by_reason.items():
        why = ""
        if reason:
            why = f": for each, {reason}" if len(names) > 1 else f": {reason}"
        sentences.append(f"{_with_verb(names, 'is', 'are')} weakly determined{why}.")
    if not hidden:
        sentences += _instead(fit, weak)
    for quantity in fit.derived:
        if quantity.reason:
            sentences.append(f"Of {quantity.expression}, {quantity.reason}.")
    sentences += [_remedy(fit, remedy) for remedy in fit.remedies]
    return " ".join(sentences)


def _determining(fit: FitResult) -> str:
    """Subject and verb: "The path determines", "Two measured values and the priors
    determine"."""
    subject = "The path"
    several = False
    if not fit.rms:
        several = len(fit.events) != 1
        values = "values" if several else "value"
        subject = f"{_NUMBERS[len(fit.events)]} measured {values}"
    if any(parameter.prior for parameter in fit.parameters.values()):
        return f"{subject} and the priors determine"
    return f"{subject} {'determine' if several else 'determines'}"


def _hidden(fit: FitResult, names: list[str]) -> list[str]:
    """Sentences on parameters that are not identifiable: along which changes the path
    stays the same, and what is determined instead."""
    changes = "; or when ".join(map(_change, fit.identifiability.null_directions))
    on_curves = [name for name in names if fit.parameters[name].reason]
    near = "near these values, " if on_curves else ""
    return [
        f"{_with_verb(names, 'is', 'are')} not identifiable: "
        f"{near}the path stays the same when {changes}.",
        *(f"Of {name}, {fit.parameters[name].reason}." for name in on_curves),
        *_instead(fit, names),
    ]


def _with_verb(names: list[str], singular: str, plural: str) -> str:
    """Names as the subject of a sentence, with its verb."""
    return f"{join_words(names)} {plural if len(names) > 1 else singular}"


def _instead(fit: FitResult, names: list[str]) -> list[str]:
    """A sentence on the determined combinations of some parameters and on all
    determined products, if there are any."""
    expressions = [
        combination.expression
        for combination in fit.combinations
        if not set(names).isdisjoint(combination.weights)
    ]
    expressions += [product.expression for product in fit.products]
    if not expressions:
        return []
    meanings = "; ".join(product.meaning for product in fit.products)
    why = f": {meanings}" if meanings else ""
    return [f"Only {_with_verb(expressions, 'is', 'are')} determined{why}."]


def _remedy(fit: FitResult, remedy: FurtherMeasurement) -> str:
    """A sentence on the measurements that would determine some parameters."""
    names = join_words(remedy.parameters)
    channels = [_WORDS[channel] for channel in remedy.measure]
    if channels:
        also = join_words(channels, "and" if remedy.all else "or")
        return f"Measuring {also} as well would determine {names}."
    text = f"No further measurement along this path would determine {names}"
    coefficients = [name for name in remedy.parameters if name in fit.coefficients]
    if fit.data.law_file or len(coefficients) != 2:
        return f"{text}."
    return (
        f"{text}; `curlfit design --separate {','.join(coefficients)}` searches for "
        "throws that would."
    )


def _change(direction: dict[str, float]) -> str:
    """A null direction as a change that leaves the path the same: "a grows and b
    falls by the same amount"."""
    largest = max(map(abs, direction.values()))
    changes = []
    for name, weight in direction.items():
        change = f"{name} {'grows' if weight > 0 else 'falls'}"
        if abs(weight) != largest:
            change += f" {abs(weight):.3g} times as much"
        changes.append(change)
    equal = all(abs(weight) == largest for weight in direction.values())
    if len(changes) == 2 and equal:
        return f"{changes[0]} and {changes[1]} by the same amount"
    return join_words(changes)
