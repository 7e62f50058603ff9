"""What a comparison of laws on several data sets says. Nothing is computed here."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from rich.text import Text

from curlfit.comparison.candidate_columns import (
    DELTA_BIC,
    FOLLOWS,
    LABEL,
    LAW,
    LOAD,
    PARAMETERS,
    RANK,
    difference,
)
from curlfit.comparison.result import Candidate, Comparison, OnSet, SetOfData
from curlfit.comparison.tables import coefficients_table, finding, order_by_bic
from curlfit.findings import Finding
from curlfit.foreign import counted
from curlfit.inference.information.verdict import Verdict
from curlfit.output.document import Document, Said, Section, command_line
from curlfit.output.table import Cell, Column, Table
from curlfit.output.text import STYLE, stone_text
from curlfit.throws.odd_row import odd_rows_in_words
from curlfit.wording import join_words, p_text

_FAR = 3.0  # sigmas, from which a value speaks against a law


def document_of_sets(comparison: Comparison) -> Document:
    """Ranks, each data set, coefficients, and what speaks against which law."""
    sets = comparison.sets
    candidates = comparison.candidates
    first_conclusion, *other_conclusions = _conclusions(comparison)
    several = len(sets) > 1
    files = ", ".join(data_set.name for data_set in sets)
    laws = f"{counted(len(candidates), 'law')}, {counted(len(sets), 'data set')}"
    odd_rows = odd_rows_in_words(comparison.odd_rows)
    return Document(
        finding=finding(comparison),
        lines=[*odd_rows, order_by_bic(comparison, " ..."), first_conclusion],
        subject=f"{laws}: {files}",
        headline=Text(f"{laws}: {files}", style="bold"),
        about=[*map(_about, sets), *map(Said, odd_rows)],
        sections=(
            Section(
                "laws",
                "The laws",
                (_ranks(comparison), _alone(comparison) if several else None),
            ),
            Section("against", "What speaks against each law", (_against(comparison),)),
            Section(
                "coefficients",
                "Coefficients",
                (
                    coefficients_table(comparison),
                    _determined(comparison) if several else None,
                ),
                brief=False,
            ),
            Section(
                "conclusions",
                "What follows",
                (Said(first_conclusion), *other_conclusions),
            ),
        ),
        notes=[_noise(data_set) for data_set in sets if data_set.noise_of],
        title=f"{', '.join(map(short, sets))}: which law?",
        settings={"Data": files, "Stone": stone_text(comparison.stone)},
        command=command_line(
            "compare",
            *(data_set.name for data_set in sets),
            *comparison.data.flags,
        ),
    )


def short(data_set: SetOfData) -> str:
    """The name of a data set in a heading."""
    return Path(data_set.name).stem


def _about(data_set: SetOfData) -> str:
    """What a data set is, and how many values it has."""
    kind = {"track": "track", "friction": "friction"}.get(
        data_set.kind, counted(data_set.throws, "throw")
    )
    fewer = ""
    if data_set.effective < data_set.values - 0.5:
        fewer = f", worth {data_set.effective:.0f} independent ones"
    return f"{data_set.name}: {kind}, {counted(data_set.values, 'value')}{fewer}"


def _noise(data_set: SetOfData) -> Finding:
    """A note on the sigma of a data set that gives none."""
    is_track = data_set.kind == "track"
    code = "sigma-of-best-law-or-tracker" if is_track else "sigma-of-best-law"
    sigma = [{"name": name, "value": value} for name, value in data_set.sigma.items()]
    note = Finding.note(code, law=data_set.noise_of, sigma=sigma)
    return note.of(short(data_set))


def _per_value(chi_squared: float, dof: float) -> str:
    return f"{chi_squared / dof:.3g}"


def _ranks(comparison: Comparison) -> Table[Candidate]:
    """Laws with how well they describe each data set, best first."""
    several = len(comparison.sets) > 1
    note = (
        "Under the data set: chi squared per degree of freedom. A law follows if "
        "it is within what chance or 1.5 times the noise makes it."
    )
    if several:
        note = (
            "Under each data set: chi squared per degree of freedom with the "
            "coefficients that all have in common, and in parentheses with those of "
            "the set alone. one ice: the probability that common coefficients raise "
            "chi squared as much by chance. A law follows if each is within what "
            "chance or 1.5 times the noise makes it, and p is above 0.001."
        )
    together: Column[Candidate] = Column(
        "one ice", format=p_text, missing="", key="p_together"
    )
    columns = (
        RANK,
        LAW,
        LOAD,
        PARAMETERS,
        DELTA_BIC,
        *_columns_of_sets(comparison, partial(_misfit, several=several), right=True),
        together,
        FOLLOWS.but(words=_follows),
    )
    return Table(
        comparison.candidates,
        columns,
        "The laws, best first",
        keys=3,
        note=Text(note, style="dim"),
    )


def _columns_of_sets(
    comparison: Comparison, words: Callable[[OnSet], Cell], **style: Any
) -> Iterator[Column[Candidate]]:
    """A column for each data set, with words on each law's fit to it."""
    for index, data_set in enumerate(comparison.sets):
        yield Column(
            short(data_set), partial(_fit_to_set, index), words, missing="", **style
        )


def _fit_to_set(index: int, candidate: Candidate) -> OnSet | None:
    """A law on one of the data sets; None where it has no fit."""
    return candidate.sets[index] if candidate.sets else None


def _misfit(on_set: OnSet, *, several: bool) -> Text:
    """Chi squared per degree of freedom and, of several data sets, that with the
    coefficients of this one alone."""
    misfit = _per_value(on_set.chi_squared, on_set.dof)
    if several:
        misfit += f" ({_per_value(on_set.own_chi_squared, on_set.own_dof)})"
    return Text(misfit, style="green" if on_set.follows else "yellow")


def _follows(candidate: Candidate) -> Text:
    """Whether a law follows all data sets, or each of them alone."""
    if not candidate.sets:
        return Text(candidate.status, style="red")
    if candidate.follows:
        return Text("yes", style="green")
    apart = all(on_set.own_follows for on_set in candidate.sets)
    several = len(candidate.sets) > 1
    return Text("each alone" if apart and several else "no", style="yellow")


def _alone(comparison: Comparison) -> Table[Candidate]:
    """Which law each data set alone prefers."""
    fitted = [candidate for candidate in comparison.candidates if candidate.sets]
    columns = _columns_of_sets(
        comparison, lambda on_set: difference(on_set.own_delta_bic), right=True
    )
    return Table(
        fitted,
        (LABEL, *columns),
        "dBIC of each data set alone, with coefficients of its own",
    )


def _against(comparison: Comparison) -> Table[Candidate]:
    """The residuals that speak against each law."""

    def far_off(candidate: Candidate) -> tuple[Text, ...]:
        residuals = []
        for data_set, on_set in zip(comparison.sets, candidate.sets, strict=False):
            far = [
                f"{what} by {abs(off):.2g}"
                for what, off in on_set.largest
                if abs(off) > _FAR
            ]
            if far and not on_set.follows:
                residuals.append(Text(f"{short(data_set)}: {join_words(far)} sigma"))
        return tuple(residuals)

    refuted = [candidate for candidate in comparison.candidates if far_off(candidate)]
    farthest: Column[Candidate] = Column(
        "farthest off", far_off, words=far_off, wraps=True
    )
    return Table(
        refuted, (LABEL, farthest), "Largest residuals, with common coefficients"
    )


def _determined(comparison: Comparison) -> Table[Candidate]:
    """The coefficients that each data set determines."""

    def in_words(on_set: OnSet) -> Cell:
        return ", ".join(on_set.determined) or Text("-", style=STYLE["weak"])

    fitted = [candidate for candidate in comparison.candidates if candidate.sets]
    columns = _columns_of_sets(comparison, in_words, wraps=True)
    return Table(fitted, (LABEL, *columns), "What each data set determines")


def _conclusions(comparison: Comparison) -> list[str]:
    fitted = [candidate for candidate in comparison.candidates if candidate.sets]
    several = len(comparison.sets) > 1
    what = "all data sets with the same coefficients" if several else "the throws"
    following = [candidate.label for candidate in fitted if candidate.follows]
    apart = [
        candidate.label
        for candidate in fitted
        if several
        and not candidate.follows
        and all(on_set.own_follows for on_set in candidate.sets)
    ]
    lines = [f"No law follows {what}."]
    if following:
        lines = [f"Laws that follow {what}: {'; '.join(following)}."]
    if apart:
        lines.append(
            "Laws that follow each data set alone, but not all with the same "
            f"coefficients: {'; '.join(apart)}."
        )
    if not several:
        return lines
    for number, data_set in enumerate(comparison.sets):
        if not any(candidate.sets[number].own_follows for candidate in fitted):
            lines.append(
                f"No law follows {short(data_set)}, even with coefficients of its own."
            )
    if fitted:
        lines += _gained(fitted[0], comparison.sets)
    return lines


def _gained(candidate: Candidate, data_sets: Sequence[SetOfData]) -> list[str]:
    """What all data sets determine of a law together but none of them alone, and what
    each of them determines."""
    determined = {combination["expression"] for combination in candidate.combinations}
    for name, coefficient in (candidate.coefficients or {}).items():
        if coefficient["verdict"] in (Verdict.DETERMINED, Verdict.WEAK):
            determined.add(name)
    alone = {name for on_set in candidate.sets for name in on_set.determined}
    lines = []
    if gained := sorted(determined - alone):
        lines.append(
            f"{candidate.label}: {join_words(gained)} by all data sets "
            "together, by none alone."
        )
    for data_set, on_set in zip(data_sets, candidate.sets, strict=True):
        names = join_words(on_set.determined) if on_set.determined else "nothing"
        lines.append(f"{candidate.label}: {short(data_set)} determines {names}.")
    return lines
