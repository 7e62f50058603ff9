"""What a profile likelihood says."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.text import Text

from curlfit.findings import Finding
from curlfit.inference.fit.estimates import Estimate
from curlfit.inference.verdict import Verdict
from curlfit.losses import LOSSES
from curlfit.output.console import PlainTable
from curlfit.output.document import Document, Said, Section, show
from curlfit.output.text import STYLE, labelled, rows_text
from curlfit.profile_likelihood.result import (
    Interval,
    Level,
    PairProfile,
    Profile,
    ProfileVerdict,
)
from curlfit.wording import compact, format_estimate, from_to, join_words, two_digits

_AGREE = 0.1  # largest difference of agreeing limits, standard errors
_EXACT = 1e-9  # of chi squared: rounding errors
_AGREE_PAIR = 0.5  # largest difference of chi squared within an agreeing ellipse
_VERDICTS = {
    ProfileVerdict.LIMITED: ("limited by the data", ""),
    ProfileVerdict.HARDLY: ("weakly determined", STYLE["weak"]),
    ProfileVerdict.FLAT: ("not identifiable", STYLE["not identifiable"]),
    ProfileVerdict.NARROW: ("unclear, for the range is too narrow", STYLE["weak"]),
}
"""What each verdict says, and its style."""


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
    one, names = profile.each[0], profile.names
    lines, remarks = [], list[str | Text]()
    if isinstance(profile, PairProfile):
        lines.append(describe_pair(profile))
        remarks.append(Said(lines[0]))
    for item in profile.each:
        if item.verdict == ProfileVerdict.LIMITED:
            lines.append(_limited(item))
            remarks += _limits(item) if item is profile else []
        else:
            lines.append(describe_undetermined(item))
            remarks.append(Said(lines[-1], style=_VERDICTS[item.verdict][1]))
    loss = LOSSES[one.loss].suffix
    fitted = f"{one.law} law, {one.load} load{loss}, fitted to {one.data['file']}"
    return Document(
        finding=", ".join(
            f"{item.name} {_VERDICTS[item.verdict][0]}" for item in profile.each
        ),
        subject=fitted,
        headline=Text.assemble(
            (f"Profile of {' and '.join(names)}", "bold"), f": {fitted}"
        ),
        about=_about(profile),
        lines=lines,
        sections=(Section("intervals", "Intervals", (_table(profile), *remarks)),),
        warnings=list(
            dict.fromkeys(warning for item in profile.each for warning in item.warnings)
        ),
        notes=_notes(profile.each),
        title=f"{Path(one.data['file']).name}: profile of {join_words(names)}",
        settings={
            "Law, load": f"{one.law}, {one.load}",
            "Data": (
                f"{one.data['file']}, {rows_text(one.data) or 'timed events alone'}"
            ),
            "Loss": one.loss,
        },
        command=profile.command,
        names=names,
    )


def describe_undetermined(profile: Profile) -> str:
    """Why a parameter is not identifiable, in words, and what would determine it."""
    span, name, rise = _span(profile, *profile.free), profile.name, profile.rise
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
        less, least = map(profile.quieter, (1.0, profile.levels[-1].delta_chi2))
        text = (
            f"{name} is weakly determined: chi squared changes by no "
            f"more than {rise:.2g} over {span}. For a limit at 68 % the "
            f"noise would have to be {two_digits(less)} times smaller, "
            f"or the rows {two_digits(less**2)} times as many; at 95 %, "
            f"{two_digits(least)} times and {two_digits(least**2)} times."
        )
    if known := [
        f"{item.expression} = {compact(item.value, item.stderr)}"
        for item in profile.combinations
    ]:
        text += (
            f" Only {join_words(known)} {'are' if len(known) > 1 else 'is'} determined."
        )
    for end, names in zip(profile.free, profile.stops, strict=True):
        if names:
            come = "reaches its bound" if len(names) == 1 else "reach their bounds"
            text += f" The profile ends at {end:.4g}, where {join_words(names)} {come}."
    return text


def describe_pair(profile: PairProfile) -> str:
    """Comparison of the region of two parameters with the ellipse, in words."""
    one, other = profile.names
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
        text += f" {other} is not identifiable even with {one} fixed."
    elif profile.each[0].verdict.is_valley:
        text += (
            f" Both lie in a valley, drawn as a line: with {one} fixed, "
            f"the standard error of {other} is {profile.across:.2g}."
        )
    return text


def _about(profile: Profile | PairProfile) -> tuple[str, str]:
    """The data, and the values at which the others were fitted again."""
    one, values = profile.each[0], f"{profile.delta.size} values"
    if one is profile:
        values += f", {_span(one, one.at[0], one.at[-1])}"
    fitted = (
        f"chi squared of the best fit {one.chi_squared:.4g}, "
        f"of {one.n_observations} values"
    )
    return (
        "; ".join(filter(None, (rows_text(one.data), fitted))),
        f"All other parameters fitted again at {values}",
    )


def _limited(profile: Profile) -> str:
    """The intervals of a parameter that the data limit."""
    ends = zip(profile.intervals, profile.levels, strict=True)
    scale = _scale(profile)
    said = ", ".join(f"{_ends(item, scale)} ({level.name})" for item, level in ends)
    return f"{profile.name}: {said}"


def _table(profile: Profile | PairProfile) -> PlainTable | None:
    """The intervals of a parameter, or the extents of the region of two."""
    levels = profile.levels
    if isinstance(profile, PairProfile):
        rows = [
            {"region spans": labelled(one.name, one.estimate.unit)}
            | {
                name: _ends(extent[index], _scale(one))
                if one.verdict == ProfileVerdict.LIMITED
                else "-"
                for name, extent in profile.extent.items()
            }
            for index, one in enumerate(profile.each)
        ]
        return PlainTable(rows, "Extent of the regions of both parameters")
    if profile.verdict != ProfileVerdict.LIMITED:
        return None
    scale, found, item = _scale(profile), profile.quantiles, profile.estimate
    sources = {
        "profile": [_ends(interval, scale) for interval in profile.intervals],
        "covariance": [_gaussian(item, level, scale) for level in levels],
    }
    if found:
        ends = (level.quantiles for level in levels)
        sources["posterior"] = [
            from_to(found[low], found[high], scale) for low, high in ends
        ]
    heads = labelled(profile.name, item.unit), *(level.name for level in levels)
    return PlainTable(
        (
            dict(zip(heads, (source, *cells), strict=True))
            for source, cells in sources.items()
        ),
        "Intervals of the profile, the covariance and the posterior",
    )


def _limits(profile: Profile) -> list[str]:
    """Remarks on the intervals of a parameter that the data limit."""
    far, widest = max(profile.departure.values(), default=None), profile.intervals[-1]
    if far is None:
        remark = (
            "The covariance has no standard error for it "
            f"({profile.estimate.verdict}); the profile needs none."
        )
    elif LOSSES[profile.loss].is_robust:
        remark = (
            f"Profile and covariance differ by up to {far:.2g} standard errors: "
            "the covariance uses the scatter of the residuals, the profile the noise "
            "implied by the loss."
        )
    elif far <= _AGREE:
        remark = (
            "Profile and covariance agree: no limit differs by more than "
            f"{max(far, 0.01):.1g} standard errors."
        )
    else:
        remark = (
            f"Profile and covariance differ, by up to {far:.2g} standard errors: chi "
            "squared is not quadratic, as the covariance assumes. Use the profile."
        )
    remarks = [remark]
    ends = ("lower", widest.low, widest.low_by), ("upper", widest.high, widest.high_by)
    for side, end, by in ends:
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
    low, high = (
        "" if end is None else format_estimate(end, scale)[0] for end in interval.limits
    )
    if low and high:
        return f"{low} .. {high}"
    return f"below {high}" if high else f"above {low}" if low else "no limit"


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
