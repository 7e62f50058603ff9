"""What a path determines and what it does not, in sentences."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from curlfit.output.text import join_words

if TYPE_CHECKING:
    from curlfit.inference.fit.result import FitResult

_PLURAL = {
    "its standard error is": "their standard errors are", "its standard error": "their standard "
    "errors", "its typical size": "their typical size",
}  # fmt: skip
_WORDS = {
    "x": "x", "y": "y", "phi": "the angle", "speed": "the speed", "omega": "the spin",
}  # fmt: skip


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
