"""What a profile likelihood says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console
from rich.text import Text

from curlfit.findings import Finding
from curlfit.inference.fit.estimates import Estimate
from curlfit.inference.information.verdict import Verdict
from curlfit.losses import LOSSES
from curlfit.output.document import Document, Said, Section, show
from curlfit.output.table import Column, Table
from curlfit.output.text import STYLE, labelled
from curlfit.profile_likelihood.result import (
    Interval,
    Level,
    LevelName,
    PairProfile,
    Profile,
    ProfileVerdict,
)
from curlfit.wording import compact, format_estimate, from_to, join_words, two_digits

_AGREE = 0.1  # largest difference of agreeing limits, standard errors
_EXACT = 1e-9  # of chi squared: rounding errors
_AGREE_PAIR = 0.5  # largest difference of chi squared within an agreeing ellipse
_VERDICT_WORDS = {
    ProfileVerdict.LIMITED: "limited by the data",
    ProfileVerdict.HARDLY: "weakly determined",
    ProfileVerdict.FLAT: "not identifiable",
    ProfileVerdict.NARROW: "unclear, for the range is too narrow",
}
_VERDICT_STYLES = {
    ProfileVerdict.HARDLY: STYLE["weak"],
    ProfileVerdict.FLAT: STYLE["not identifiable"],
    ProfileVerdict.NARROW: STYLE["weak"],
}


def print_profile(
    profile: Profile | PairProfile, console: Console | None = None
) -> None:
    """Print the report of a profile.

    Examples
    --------
    >>> curlfit.print_profile(profile)
    Profile of mu1_xi: front-back law, uniform load, fitted to ...
    """
    show(document(profile), console)


def document(profile: Profile | PairProfile) -> Document:
    """The intervals of a profile, or why there are none."""
    first = profile.each[0]
    names = profile.names
    lines: list[str] = []
    remarks: list[str | Text] = []
    if isinstance(profile, PairProfile):
        comparison = describe_pair(profile)
        lines.append(comparison)
        remarks.append(Said(comparison))
    for single in profile.each:
        if single.verdict == ProfileVerdict.LIMITED:
            lines.append(_limited(single))
            if single is profile:
                remarks += _limits(single)
        else:
            reason = describe_undetermined(single)
            lines.append(reason)
            remarks.append(Said(reason, style=_VERDICT_STYLES[single.verdict]))
    file = first.data.file
    loss = LOSSES[first.loss].suffix
    fitted = f"{first.law} law, {first.load} load{loss}, fitted to {file}"
    warnings = [warning for single in profile.each for warning in single.warnings]
    return Document(
        finding=", ".join(
            f"{single.name} {_VERDICT_WORDS[single.verdict]}" for single in profile.each
        ),
        subject=fitted,
        headline=Text.assemble(
            (f"Profile of {' and '.join(names)}", "bold"), f": {fitted}"
        ),
        about=_about(profile),
        lines=lines,
        sections=(Section("intervals", "Intervals", (_table(profile), *remarks)),),
        warnings=list(dict.fromkeys(warnings)),
        notes=_notes(profile.each),
        title=f"{Path(file).name}: profile of {join_words(names)}",
        settings={
            "Law, load": f"{first.law}, {first.load}",
            "Data": f"{file}, {first.data.in_words or 'timed events alone'}",
            "Loss": first.loss,
        },
        command=profile.command,
        names=names,
    )


def describe_undetermined(profile: Profile) -> str:
    """Why a parameter is not identifiable, in words, and what would determine it."""
    name = profile.name
    rise = profile.rise
    span = _span(profile, *profile.free)
    if profile.verdict == ProfileVerdict.NARROW:
        return (
            f"The range is too narrow: within {span} chi squared rises by no more "
            f"than {rise:.2g}."
        )
    if profile.verdict == ProfileVerdict.FLAT:
        text = (
            f"{name} is not identifiable, its profile is flat: chi squared is the "
            f"same to {max(rise, _EXACT):.0e} over the whole range {span}."
        )
    else:
        at_68 = profile.quieter(1.0)
        at_95 = profile.quieter(profile.levels[-1].delta_chi2)
        text = (
            f"{name} is weakly determined: chi squared changes by no "
            f"more than {rise:.2g} over {span}. For a limit at 68 % the "
            f"noise would have to be {two_digits(at_68)} times smaller, "
            f"or the rows {two_digits(at_68**2)} times as many; at 95 %, "
            f"{two_digits(at_95)} times and {two_digits(at_95**2)} times."
        )
    determined = [
        f"{combination.expression} = {compact(combination.value, combination.stderr)}"
        for combination in profile.combinations
    ]
    if determined:
        verb = "are" if len(determined) > 1 else "is"
        text += f" Only {join_words(determined)} {verb} determined."
    for end, names in zip(profile.free, profile.stops, strict=True):
        if names:
            come = "reaches its bound" if len(names) == 1 else "reach their bounds"
            text += f" The profile ends at {end:.4g}, where {join_words(names)} {come}."
    return text


def describe_pair(profile: PairProfile) -> str:
    """Comparison of the region of two parameters with the ellipse, in words."""
    first, second = profile.names
    if profile.ellipse is None:
        text = "The covariance gives no ellipse to compare with."
    else:
        agrees = profile.ellipse <= _AGREE_PAIR
        text = (
            "The 95 % confidence ellipse from the covariance "
            f"is {'' if agrees else 'not '}accurate: within it, "
            "chi squared differs from its quadratic approximation by up to "
            f"{profile.ellipse:.2g}.{'' if agrees else ' Use the contours.'}"
        )
    if profile.across is None:
        text += f" {second} is not identifiable even with {first} fixed."
    elif profile.each[0].verdict.is_valley:
        text += (
            f" Both lie in a valley, drawn as a line: with {first} fixed, "
            f"the standard error of {second} is {profile.across:.2g}."
        )
    return text


def _about(profile: Profile | PairProfile) -> tuple[str, str]:
    """The data, and the values at which the others were fitted again."""
    first = profile.each[0]
    fitted = (
        f"chi squared of the best fit {first.chi_squared:.4g}, "
        f"of {first.n_observations} values"
    )
    rows = first.data.in_words
    values = f"{profile.delta.size} values"
    if first is profile:
        values += f", {_span(first, first.at[0], first.at[-1])}"
    return (
        f"{rows}; {fitted}" if rows else fitted,
        f"All other parameters fitted again at {values}",
    )


def _limited(profile: Profile) -> str:
    """The intervals of a parameter that the data limit."""
    scale = _scale(profile)
    intervals = [
        f"{_ends(interval, scale)} ({interval.level})" for interval in profile.intervals
    ]
    return f"{profile.name}: {', '.join(intervals)}"


def _table(profile: Profile | PairProfile) -> Table[Any] | None:
    """The intervals of a parameter, or the extents of the region of two."""
    if isinstance(profile, PairProfile):
        return _extents(profile)
    if profile.verdict != ProfileVerdict.LIMITED:
        return None
    return _intervals(profile)


class _Method(NamedTuple):
    """A way to find the intervals of a parameter, and what it finds, by level."""

    name: str
    interval_by_level: Mapping[LevelName, str]


def _intervals(profile: Profile) -> Table[_Method]:
    """The intervals of a parameter by profile, covariance and posterior."""
    estimate = profile.estimate
    quantiles = profile.quantiles
    scale = _scale(profile)
    by_profile = {}
    by_covariance = {}
    by_posterior = {}
    for interval, level in zip(profile.intervals, profile.levels, strict=True):
        by_profile[level.name] = _ends(interval, scale)
        by_covariance[level.name] = _gaussian(estimate, level, scale)
        if quantiles:
            low, high = level.quantiles
            by_posterior[level.name] = from_to(quantiles[low], quantiles[high], scale)
    rows = [_Method("profile", by_profile), _Method("covariance", by_covariance)]
    if quantiles:
        rows.append(_Method("posterior", by_posterior))
    columns: list[Column[_Method]] = [
        Column(labelled(profile.name, estimate.unit), key="name")
    ]
    for level in profile.levels:
        columns.append(_level_column(level.name))
    return Table(
        rows, columns, "Intervals of the profile, the covariance and the posterior"
    )


def _level_column(level: str) -> Column[_Method]:
    """The column of the intervals at a level."""
    return Column(level, lambda method: method.interval_by_level[level])


def _extents(profile: PairProfile) -> Table[int]:
    """What the regions of two parameters span of each."""

    def name(index: int) -> str:
        single = profile.each[index]
        return labelled(single.name, single.estimate.unit)

    columns = [Column("region spans", name)]
    for level, extent in profile.extent.items():
        columns.append(_extent_column(profile, level, extent))
    return Table([0, 1], columns, "Extent of the regions of both parameters")


def _extent_column(
    profile: PairProfile, level: str, extent: Sequence[Interval]
) -> Column[int]:
    """The column of what a region spans of each parameter that the data limit."""

    def in_words(index: int) -> str:
        single = profile.each[index]
        if single.verdict != ProfileVerdict.LIMITED:
            return "-"
        return _ends(extent[index], _scale(single))

    return Column(level, in_words)


def _limits(profile: Profile) -> list[str]:
    """Remarks on the intervals of a parameter that the data limit."""
    difference = max(profile.departure.values(), default=None)
    if difference is None:
        remark = (
            "The covariance has no standard error for it "
            f"({profile.estimate.verdict}); the profile needs none."
        )
    elif LOSSES[profile.loss].is_robust:
        remark = (
            f"Profile and covariance differ by up to {difference:.2g} standard errors: "
            "the covariance uses the scatter of the residuals, the profile the noise "
            "implied by the loss."
        )
    elif difference <= _AGREE:
        remark = (
            "Profile and covariance agree: no limit differs by more than "
            f"{max(difference, 0.01):.1g} standard errors."
        )
    else:
        remark = (
            f"Profile and covariance differ, by up to {difference:.2g} standard "
            "errors: chi squared is not quadratic, as the covariance assumes. "
            "Use the profile."
        )
    remarks = [remark]
    widest = profile.intervals[-1]
    for side, end, by in (
        ("lower", widest.low, widest.low_by),
        ("upper", widest.high, widest.high_by),
    ):
        if by == "bound":
            remarks.append(
                f"No {side} limit from these data: its {side} bound, "
                f"{end:.4g}, is within 95 %."
            )
        elif by == "range":
            way = "down" if side == "lower" else "up"
            remarks.append(
                f"No {side} limit within the range examined, {way} to {end:.4g}."
            )
    return remarks


def _notes(profiles: Sequence[Profile]) -> list[Finding]:
    """What thresholds and chi squared mean, where they are not the usual ones."""
    notes = []
    if any(profile.estimate.verdict == Verdict.AT_BOUND for profile in profiles):
        notes.append(Finding.note("limits-near-bound"))
    loss = profiles[0].loss
    if LOSSES[loss].is_robust:
        notes.append(Finding.note("chi-squared-of-loss", loss=loss))
    return notes


def _scale(profile: Profile) -> float:
    """Scale of the rounding of limits: about a standard error."""
    first = profile.intervals[0]
    return (first.high - first.low) / 2 or abs(first.high) / 100


def _ends(interval: Interval, scale: float) -> str:
    """An interval in words, rounded to a scale; what does not limit it is left out."""
    low, high = interval.limits
    lowest = "" if low is None else format_estimate(low, scale)[0]
    highest = "" if high is None else format_estimate(high, scale)[0]
    if lowest and highest:
        return f"{lowest} .. {highest}"
    if highest:
        return f"below {highest}"
    return f"above {lowest}" if lowest else "no limit"


def _gaussian(estimate: Estimate, level: Level, scale: float) -> str:
    """Interval of the covariance."""
    if estimate.stderr is None:
        return "-"
    reach = level.sigmas * estimate.stderr
    return from_to(estimate.value - reach, estimate.value + reach, scale)


def _span(profile: Profile, low: float, high: float) -> str:
    """Part of the range, rounded to some thousandths of it."""
    scale = (profile.at[-1] - profile.at[0]) / 50
    ends = (float(low), float(high))
    return " .. ".join(format_estimate(end, scale)[0] if end else "0" for end in ends)
