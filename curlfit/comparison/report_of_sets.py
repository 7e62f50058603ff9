"""What a comparison of laws on several data sets says. Nothing is computed here."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.text import Text

from curlfit.comparison.result import Candidate, Comparison, SetOfData
from curlfit.comparison.tables import (
    coefficients_table,
    difference,
    ranked_row,
    summary,
)
from curlfit.findings import Finding
from curlfit.foreign import counted
from curlfit.inference.verdict import Verdict
from curlfit.output.console import Items, PlainTable
from curlfit.output.document import Document, Said, Section, command_line
from curlfit.output.text import STYLE, stone_text
from curlfit.wording import join_words, p_text

_FAR = 3.0  # sigmas, from which a value speaks against a law


def document_of_sets(comparison: Comparison) -> Document:
    """Ranks, each data set, coefficients, and what speaks against which law."""
    sets, candidates = comparison.sets, comparison.candidates
    first, *others = _conclusions(comparison)
    many = len(sets) > 1
    files = ", ".join(one.name for one in sets)
    laws = f"{counted(len(candidates), 'law')}, {counted(len(sets), 'data set')}"
    return Document(
        **summary(comparison, first, " ..."),
        subject=f"{laws}: {files}",
        headline=Text(f"{laws}: {files}", style="bold"),
        about=[_about(one) for one in sets],
        sections=(
            Section(
                "laws", "The laws", (_ranks(comparison), *[_alone(comparison)] * many)
            ),
            Section("against", "What speaks against each law", (_against(comparison),)),
            Section(
                "coefficients",
                "Coefficients",
                (coefficients_table(comparison), *[_determined(comparison)] * many),
                brief=False,
            ),
            Section("conclusions", "What follows", (Said(first), *others)),
        ),
        notes=[_noise(data_set) for data_set in sets if data_set.noise_of],
        title=f"{', '.join(map(short, sets))}: which law?",
        settings={"Data": files, "Stone": stone_text(comparison.stone)},
        command=command_line(
            "compare", *(one.name for one in sets), *comparison.data.get("flags", ())
        ),
    )


def short(one: SetOfData) -> str:
    """The name of a data set in a heading."""
    return Path(one.name).stem


def _about(one: SetOfData) -> str:
    count = {"track": "track", "friction": "friction"}.get(
        one.kind, counted(one.throws, "throw")
    )
    fewer = ""
    if one.effective < one.values - 0.5:
        fewer = f", worth {one.effective:.0f} independent ones"
    return f"{one.name}: {count}, {counted(one.values, 'value')}{fewer}"


def _noise(data_set: SetOfData) -> Finding:
    """A note on the sigma of a data set that gives none."""
    is_track = data_set.kind == "track"
    code = "sigma-of-best-law-or-tracker" if is_track else "sigma-of-best-law"
    sigma = [{"name": name, "value": value} for name, value in data_set.sigma.items()]
    finding = Finding.note(code, law=data_set.noise_of, sigma=sigma)
    return finding.of(short(data_set))


def _per_value(chi_squared: float, dof: float) -> str:
    return f"{chi_squared / dof:.3g}"


def _ranks(comparison: Comparison) -> PlainTable:
    rows: list[dict[str, Any]] = []
    for item in comparison.candidates:
        row = ranked_row(item)
        for one, on in zip(comparison.sets, item.sets, strict=False):
            said = _per_value(on.chi_squared, on.dof)
            if len(comparison.sets) > 1:
                said += f" ({_per_value(on.own_chi_squared, on.own_dof)})"
            row[f">{short(one)}"] = Text(
                said, style="green" if on.follows else "yellow"
            )
        if item.p_together is not None:
            row["one ice"] = p_text(item.p_together)
        row["follows"] = (
            Text(item.status, style="red") if not item.sets else _follows(item)
        )
        rows.append(row)
    note = (
        "Under each data set: chi squared per degree of freedom with the coefficients "
        "that all have in common, and in parentheses with those of the set alone. "
        "one ice: the probability that common coefficients raise chi squared as much "
        "by chance. A law follows if each is within what chance or 1.5 times the "
        "noise makes it, and p is above 0.001."
        if len(comparison.sets) > 1
        else "Under the data set: chi squared per degree of freedom. A law follows if "
        "it is within what chance or 1.5 times the noise makes it."
    )
    return PlainTable(
        rows, "The laws, best first", keys=3, note=Text(note, style="dim")
    )


def _follows(item: Candidate) -> Text:
    if item.follows:
        return Text("yes", style="green")
    apart = all(on.own_follows for on in item.sets)
    return Text("each alone" if apart and len(item.sets) > 1 else "no", style="yellow")


def _alone(comparison: Comparison) -> PlainTable:
    rows = [
        {"law, load": item.label}
        | {
            f">{short(one)}": difference(on.own_delta_bic)
            for one, on in zip(comparison.sets, item.sets, strict=True)
        }
        for item in comparison.candidates
        if item.sets
    ]
    return PlainTable(rows, "dBIC of each data set alone, with coefficients of its own")


def _against(comparison: Comparison) -> PlainTable:
    rows = []
    for item in comparison.candidates:
        said = []
        for one, on in zip(comparison.sets, item.sets, strict=False):
            far = [
                f"{what} by {abs(off):.2g}"
                for what, off in on.largest
                if abs(off) > _FAR
            ]
            if far and not on.follows:
                said.append(Text(f"{short(one)}: {join_words(far)} sigma"))
        if said:
            rows.append({"law, load": item.label, "~farthest off": Items(said)})
    return PlainTable(rows, "Largest residuals, with common coefficients")


def _determined(comparison: Comparison) -> PlainTable:
    rows: list[dict[str, Any]] = [
        {"law, load": item.label}
        | {
            f"~{short(one)}": ", ".join(on.determined) or Text("-", style=STYLE["weak"])
            for one, on in zip(comparison.sets, item.sets, strict=True)
        }
        for item in comparison.candidates
        if item.sets
    ]
    return PlainTable(rows, "What each data set determines")


def _conclusions(comparison: Comparison) -> list[str]:
    items = [item for item in comparison.candidates if item.sets]
    several = len(comparison.sets) > 1
    what = "all data sets with the same coefficients" if several else "the throws"
    found = [item.label for item in items if item.follows]
    apart = [
        item.label
        for item in items
        if several and not item.follows and all(on.own_follows for on in item.sets)
    ]
    lines = [
        f"Laws that follow {what}: {'; '.join(found)}."
        if found
        else f"No law follows {what}."
    ]
    if apart:
        lines.append(
            "Laws that follow each data set alone, but not all with the same "
            f"coefficients: {'; '.join(apart)}."
        )
    for number, one in enumerate(comparison.sets):
        if several and not any(item.sets[number].own_follows for item in items):
            lines.append(
                f"No law follows {short(one)}, even with coefficients of its own."
            )
    lines += _gained(items[:1], comparison.sets) if several else []
    return lines


def _gained(items: Sequence[Candidate], sets: Sequence[SetOfData]) -> list[str]:
    """What is determined by all data sets, but by none of them."""
    lines = []
    for item in items:
        known = {
            name
            for name, one in (item.coefficients or {}).items()
            if one["verdict"] in (Verdict.DETERMINED, Verdict.WEAK)
        } | {one["expression"] for one in item.combinations}
        alone = {name for on in item.sets for name in on.determined}
        if new := sorted(known - alone):
            lines.append(
                f"{item.label}: {join_words(new)} by all data sets "
                "together, by none alone."
            )
        for one, on in zip(sets, item.sets, strict=True):
            lines.append(
                f"{item.label}: {short(one)} determines {join_words(on.determined)}."
                if on.determined
                else f"{item.label}: {short(one)} determines nothing."
            )
    return lines
