"""Report of a profile likelihood as text."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rich.console import Console, Group, RenderableType
from rich.padding import Padding
from rich.text import Text

from curlfit.output.console import terminal
from curlfit.output.display import Overview
from curlfit.output.text import (
    STYLE,
    compact,
    format_estimate,
    from_to,
    join_words,
    plain_table,
)
from curlfit.profile_likelihood.result import Interval, PairProfile, Profile

if TYPE_CHECKING:
    from curlfit.inference.fit.result import Estimate
    from curlfit.profile_likelihood.result import Level

_AGREE = 0.1  # largest difference of agreeing limits, standard errors
_AGREE_PAIR = 0.5  # largest difference of chi squared within an agreeing ellipse
_STYLE = {"limited": "", "hardly": STYLE["weak"], "flat": STYLE["not identifiable"]}


def print_profile(profile: Profile | PairProfile, console: Console | None = None) -> None:
    """Print the report of a profile.

    Examples
    --------
    >>> curlfit.print_profile(profile)
    Profile of mu1_xi: front-back law, uniform load, fitted to ...
    """
    console = console or terminal()
    console.print(report(profile))


def report(profile: Profile | PairProfile) -> RenderableType:
    """The report of a profile, for a rich console."""
    each = [profile] if isinstance(profile, Profile) else list(profile.each)
    parts: list[RenderableType] = [_heading(profile)]
    if isinstance(profile, PairProfile):
        parts.append(_region(profile))
        parts.append(Padding(Text(describe_pair(profile)), (0, 0, 1, 0)))
    else:
        parts.append(_intervals(profile))
    for one in each:
        remarks = _limits(one) if isinstance(profile, Profile) else []
        remarks = remarks if one.verdict == "limited" else [describe_undetermined(one)]
        style = _STYLE.get(one.verdict, STYLE["weak"])
        parts += [Padding(Text(line, style=style), (0, 0, 1, 0)) for line in remarks]
    warnings = dict.fromkeys(line for one in each for line in one.warnings)
    parts += [
        Padding(Text(f"Warning: {warning}.", style="yellow"), (0, 0, 1, 0)) for warning in warnings
    ]
    parts += [Text(f"Note: {note}.", style="dim") for note in _notes(each)]
    return Group(*parts)


def overview(profile: Profile | PairProfile) -> Overview:
    """A profile at a glance: its intervals, or why there are none."""
    title, about, points = _heading(profile).plain.splitlines()
    if isinstance(profile, PairProfile):
        each, table = list(profile.each), _region(profile)
        remarks = [describe_pair(profile)]
    else:
        each, table, remarks = [profile], _intervals(profile), []
    finding = ", ".join(f"{one.name} {_FINDINGS[one.verdict]}" for one in each)
    lines = list(remarks)
    for one in each:
        if one.verdict == "limited":
            ends = zip(one.intervals, one.levels, strict=True)
            digits = _scale(one)
            said = ", ".join(f"{_ends(item, digits)} ({level.name})" for item, level in ends)
            lines.append(f"{one.name}: {said}")
            remarks += _limits(one) if isinstance(profile, Profile) else []
        else:
            lines.append(describe_undetermined(one))
            remarks.append(lines[-1])
    warnings = list(dict.fromkeys(line for one in each for line in one.warnings))
    notes = [f"Note: {note}." for note in _notes(each)]
    return Overview(
        finding, title.partition(": ")[2], lines, [about, points, table, *remarks, *notes], warnings
    )


_FINDINGS = {
    "limited": "limited by the data", "hardly": "weakly determined", "flat": "not identifiable",
    "narrow": "unclear, for the range is too narrow",
}  # fmt: skip


def describe_undetermined(profile: Profile) -> str:
    """Why a parameter is not identifiable, in words, and what would determine it."""
    span = _span(profile, *profile.free)
    name = profile.name
    if profile.verdict == "narrow":
        return (
            f"The range is too narrow: within {span} chi squared rises by no more than "
            f"{profile.rise:.2g}."
        )
    if profile.verdict == "flat":
        same = f"the same to {profile.rise:.0e}" if profile.rise > 0 else "exactly the same"
        text = (
            f"{name} is not identifiable, its profile is flat: chi squared is {same} over the "
            f"whole range {span}."
        )
    else:
        times, all_of_it = profile.quieter(1.0), profile.quieter(profile.levels[-1].delta_chi2)
        text = (
            f"{name} is weakly determined: chi squared changes by no more than {profile.rise:.2g} "
            f"over {span}. For a limit at 68 % the noise would have to be "
            f"{_times(times)} smaller, or the rows {_times(times**2)} as many; at 95 %, "
            f"{_times(all_of_it)} and {_times(all_of_it**2)}."
        )
    if profile.combinations:
        known = [
            f"{item.expression} = {compact(item.value, item.stderr)}"
            for item in profile.combinations
        ]
        text += f" Only {join_words(known)} {'are' if len(known) > 1 else 'is'} determined."
    for end, names in zip(profile.free, profile.stops, strict=True):
        if names:
            come = "reaches its bound" if len(names) == 1 else "reach their bounds"
            text += f" The profile ends at {_short(end)}, where {join_words(list(names))} {come}."
    return text + _open_ends(profile)


def describe_pair(profile: PairProfile) -> str:
    """Comparison of the region of two parameters with the ellipse, in words."""
    one, other = profile.names
    if profile.ellipse is None:
        text = "The covariance gives no ellipse to compare with."
    elif profile.ellipse <= _AGREE_PAIR:
        text = (
            "The 95 % confidence ellipse from the covariance is accurate: within it, chi squared "
            f"differs from its quadratic approximation by at most {profile.ellipse:.1g}."
        )
    else:
        size = f"up to {profile.ellipse:.2g}" if profile.ellipse < 100 else "more than 100"
        text = (
            "The 95 % confidence ellipse from the covariance is not accurate: within it, chi "
            f"squared differs from its quadratic approximation by {size}. Use the contours."
        )
    if profile.across is None:
        text += f" {other} is not identifiable even with {one} fixed."
    elif profile.each[0].verdict in ("flat", "hardly"):
        text += (
            f" Both lie in a valley, drawn as a line: with {one} fixed, the standard error of "
            f"{other} is {profile.across:.2g}."
        )
    return text


def _heading(profile: Profile | PairProfile) -> Text:
    one = profile if isinstance(profile, Profile) else profile.each[0]
    text = Text()
    text.append(f"Profile of {' and '.join(profile.names)}", style="bold")
    loss = "" if one.loss == "linear" else f", {one.loss} loss"
    text.append(f": {one.law} law, {one.load} load{loss}, fitted to {one.data['file']}\n")
    rows = f"{one.data['rows']} rows, t = {one.data['from']:g} .. {one.data['to']:g} s; "
    text.append(rows if one.data["rows"] else "")
    text.append(
        f"chi squared of the best fit {one.chi_squared:.4g}, of {one.n_observations} values\n"
    )
    points = one.at.size if isinstance(profile, Profile) else int(profile.delta.size)
    text.append(f"All other parameters fitted again at {points} values")
    if isinstance(profile, Profile):
        text.append(f", {_span(one, one.at[0], one.at[-1])}")
    return text


def _intervals(profile: Profile) -> RenderableType:
    item = profile.estimate
    if profile.verdict != "limited":
        return Text("")
    unit = "" if item.unit in ("", "1") else f" ({item.unit})"
    table = plain_table()
    table.add_column(f"{profile.name}{unit}", no_wrap=True)
    for level in profile.levels:
        table.add_column(level.name, no_wrap=True)
    digits = _scale(profile)
    table.add_row("profile", *(_ends(interval, digits) for interval in profile.intervals))
    table.add_row("covariance", *(_gaussian(item, level, digits) for level in profile.levels))
    if profile.quantiles:
        found = profile.quantiles
        rows = [
            (found[low], found[high]) for low, high in (item.quantiles for item in profile.levels)
        ]
        table.add_row("posterior", *(from_to(low, high, digits) for low, high in rows))
    return Padding(table, (1, 0, 1, 0))


def _limits(profile: Profile) -> list[str]:
    """Remarks on the intervals of a parameter that the data limit."""
    remarks = []
    apart = profile.departure
    if apart:
        far = max(apart.values())
        if profile.loss != "linear":
            remarks.append(
                f"Profile and covariance differ by up to {far:.2g} standard errors: the covariance "
                "uses the scatter of the residuals, the profile the noise implied by the loss."
            )
        elif far <= _AGREE:
            remarks.append(
                "Profile and covariance agree: no limit differs by more than "
                f"{max(far, 0.01):.1g} standard errors."
            )
        else:
            remarks.append(
                f"Profile and covariance differ, by up to {far:.2g} standard errors: chi "
                "squared is not quadratic, as the covariance assumes. Use the profile."
            )
    else:
        remarks.append(
            f"The covariance has no standard error for it ({profile.estimate.verdict}); the "
            "profile needs none."
        )
    widest = profile.intervals[-1]
    for side, end, by in (
        ("lower", widest.low, widest.low_by), ("upper", widest.high, widest.high_by),
    ):  # fmt: skip
        if by == "bound":
            remarks.append(
                f"No {side} limit from these data: its {side} bound, {_short(end)}, is within 95 %."
            )
        elif by == "range":
            remarks.append(_no_limit(side, end))
    for names, end, side in zip(profile.stops, profile.free, ("Below", "Above"), strict=True):
        if names and profile.free[0] < profile.free[1] and widest.low <= end <= widest.high:
            bound = "is at its bound" if len(names) == 1 else "are at their bounds"
            remarks.append(
                f"{side} {_short(end)} {join_words(list(names))} {bound}, which makes the profile "
                "steeper there."
            )
    return remarks


def _open_ends(profile: Profile) -> str:
    """Ends of the range of an undetermined parameter without any limit."""
    low, high = profile.estimate.lower, profile.estimate.upper
    ends = [
        (side, end)
        for side, end, bound, names in zip(
            ("lower", "upper"), profile.free, (low, high), profile.stops, strict=True
        )
        if not names and end != bound and end in (profile.at[0], profile.at[-1])
    ]
    return "".join(f" {_no_limit(side, end)}" for side, end in ends)


def _no_limit(side: str, end: float) -> str:
    """That no limit was found up to an end of the range examined."""
    way = "down" if side == "lower" else "up"
    return f"No {side} limit within the range examined, {way} to {_short(end)}."


def _region(profile: PairProfile) -> RenderableType:
    table = plain_table()
    table.add_column("region spans", no_wrap=True)
    for level in profile.levels:
        table.add_column(level.name, no_wrap=True)
    for index, one in enumerate(profile.each):
        unit = "" if one.estimate.unit in ("", "1") else f" ({one.estimate.unit})"
        cells = ["-", "-"]
        if one.verdict == "limited":
            digits = _scale(one)
            cells = [_ends(profile.extent[level.name][index], digits) for level in profile.levels]
        table.add_row(f"{one.name}{unit}", *cells)
    return Padding(table, (1, 0, 1, 0))


def _notes(each: list[Profile]) -> list[str]:
    found = []
    if any(one.estimate.verdict == "at bound" for one in each):
        found.append(
            "at a bound the thresholds of chi squared are too high, and the limits have more than "
            "the stated confidence"
        )
    if each[0].loss != "linear":
        found.append(f"chi squared means minus twice the log-likelihood of the {each[0].loss} loss")
    return found


def _scale(profile: Profile) -> float:
    """Scale of the rounding of limits: about a standard error."""
    first = profile.intervals[0]
    return (first.high - first.low) / 2 or abs(first.high) / 100


def _ends(interval: Interval, scale: float) -> str:
    low, high = format_estimate(interval.low, scale)[0], format_estimate(interval.high, scale)[0]
    if interval.low_by in ("bound", "range") and interval.high_by in ("bound", "range"):
        return "no limit"
    if interval.low_by in ("bound", "range"):
        return f"below {high}"
    if interval.high_by in ("bound", "range"):
        return f"above {low}"
    return f"{low} .. {high}"


def _gaussian(item: Estimate, level: Level, scale: float) -> str:
    if item.stderr is None:
        return "-"
    reach = level.sigmas * item.stderr
    return from_to(item.value - reach, item.value + reach, scale)


def _span(profile: Profile, low: float, high: float) -> str:
    """Part of the range, rounded to some thousandths of it."""
    scale = (profile.at[-1] - profile.at[0]) / 50
    ends = (float(low), float(high))
    return " .. ".join(format_estimate(end, scale)[0] if end else "0" for end in ends)


def _short(value: float) -> str:
    return f"{value:.4g}"


def _times(factor: float) -> str:
    """A factor in words, to two digits."""
    if not math.isfinite(factor):
        return "infinitely"
    size = f"{factor:.2g}" if factor < 100 else f"{factor:.0f}" if factor < 1e6 else f"{factor:.1e}"
    return f"{size} times"
