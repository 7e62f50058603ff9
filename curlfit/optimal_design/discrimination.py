"""The record of throws that decide between laws, and what it says."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from os import PathLike
from typing import Any, ClassVar, NamedTuple

from rich.console import Console
from rich.text import Text

from curlfit.findings import Finding
from curlfit.foreign import counted
from curlfit.loads import Load
from curlfit.optimal_design.report import measured, noise_text, throws_text
from curlfit.optimal_design.throw_columns import (
    DISTANCE,
    OMEGA0,
    REST,
    V0,
    log_odds_column,
)
from curlfit.output.document import Document, Said, Section, show
from curlfit.output.frames import frame_of
from curlfit.output.table import Column, Table
from curlfit.output.text import stone_text
from curlfit.records import Record, require
from curlfit.stone import Stone
from curlfit.wording import join_words, lower

ODDS = 100
"""Odds to 1 at which a law is decided."""
DECISIVE = math.log(ODDS)
PROBABILITY = 0.9
"""Probability that is required that throws decide a law at these odds."""
MARGIN = 1.2815515655446004
"""Quantile of the normal distribution at `PROBABILITY`."""


class Ranks(NamedTuple):
    """Numbers of directions of the coefficients that throws determine."""

    truth: int
    rival: int


@dataclass(frozen=True)
class Pair:
    """What the chosen throws, fitted together, promise where one law is true.

    Attributes
    ----------
    truth, rival : names.
    chi_squared : left by the rival, without noise. relative : what it leaves as
        root mean square over the noise.
    log_odds, sd : expected log odds for the true law by BIC, and their
        standard deviation.
    wins, decides : probability that the true law has the better BIC, and that it
        leads by `ODDS`.
    """

    truth: str
    rival: str
    chi_squared: float
    relative: float
    log_odds: float
    sd: float
    written: ClassVar[tuple[str, ...]] = ("wins", "decides")

    @classmethod
    def of(cls, truth: str, rival: str, left: float, ranks: Ranks, values: int) -> Pair:
        """What the chi squared `left` by the rival and the number of measured values
        promise.

        BIC adds the logarithm of the number of values for each direction.
        """
        more = ranks.rival - ranks.truth
        mean = (left + more * (math.log(values) - 1)) / 2
        sd = math.sqrt(left + (ranks.truth + ranks.rival) / 2)
        return cls(truth, rival, left, math.sqrt(left / values), mean, sd)

    def margin(self, least: float = DECISIVE) -> float:
        """How far the log odds are above `least`, in standard deviations."""
        return (self.log_odds - least) / self.sd

    @property
    def wins(self) -> float:
        """Probability that the true law has the better BIC."""
        return math.erfc(-self.margin(0.0) / math.sqrt(2)) / 2

    @property
    def decides(self) -> float:
        """Probability that the true law leads by `ODDS`."""
        return math.erfc(-self.margin() / math.sqrt(2)) / 2


@dataclass(frozen=True)
class PossibleThrow:
    """A throw, and what it tells alone.

    Attributes
    ----------
    v0, omega0 : initial speed (m/s) and spin (rad/s).
    rest, distance : time of rest (s) and distance (m) under the first law.
    log_odds : expected log odds for the true law from this throw alone, in the order
        of the pairs.
    """

    v0: float
    omega0: float
    rest: float
    distance: float
    log_odds: tuple[float, ...]

    @property
    def least(self) -> float:
        """The log odds of the hardest pair."""
        return min(self.log_odds)


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Discrimination(Record):
    """Throws that decide between laws.

    Attributes
    ----------
    laws : assumed coefficients by the name of the law.
    load, stone : of all throws. sigma : noise by measured channel (SI).
    rate, until : rows per second, Hz, and end of the records in s; the time of
        rest if None.
    candidates : from which the throws are chosen.
    throws : indices of the chosen candidates, repeated for repeated throws.
    pairs : of a true law and its rival.
    asked : number of throws that was asked for; None if it is the least that decides.
    left_out : speeds and spins of throws that leave the sheet or that a law
        cannot follow.
    command : that made it; empty if it was made in Python.

    Examples
    --------
    >>> between.decided
    True
    >>> len(between.throws), len(between.pairs)
    (1, 2)
    """

    kind: ClassVar[str] = "discrimination"

    laws: dict[str, dict[str, float]]
    load: Load
    stone: Stone
    sigma: dict[str, float]
    rate: float
    until: float | None
    candidates: tuple[PossibleThrow, ...]
    throws: tuple[int, ...]
    pairs: tuple[Pair, ...]
    asked: int | None = None
    left_out: tuple[tuple[float, float], ...] = ()
    command: str = ""

    @property
    def by_size(self) -> dict[tuple[float, float], float]:
        """The log odds of the hardest pair by speed and size of the spin, of the
        worse sense."""
        least: dict[tuple[float, float], float] = {}
        for throw in self.candidates:
            key = throw.v0, abs(throw.omega0)
            least[key] = min(throw.least, least.get(key, math.inf))
        return least

    @property
    def worst(self) -> Pair:
        """The pair that is hardest to decide."""
        return min(self.pairs, key=lambda pair: (pair.decides, pair.log_odds))

    @property
    def decided(self) -> bool:
        """Whether the throws decide with the required probability, whichever
        law is true."""
        return self.worst.decides >= PROBABILITY

    def require_consistent(self) -> None:
        """Raise `ValueError` where what was read contradicts itself."""
        count = len(self.candidates)
        exist = all(0 <= index < count for index in self.throws)
        require("throws", exist, "indices of candidates")
        complete = all(
            len(throw.log_odds) == len(self.pairs) for throw in self.candidates
        )
        require("candidates", complete, "log odds of every pair")
        named = all({pair.truth, pair.rival} <= self.laws.keys() for pair in self.pairs)
        require("pairs", bool(self.pairs) and named, "pairs of the laws")

    def to_frame(self) -> Any:
        """The candidates as a pandas DataFrame, one per row: the throw, and the log
        odds of each pair from it alone.

        Raises
        ------
        InputError : pandas is not installed.
        """
        log_odds = [
            log_odds_column(index, pair.truth, pair.rival)
            for index, pair in enumerate(self.pairs)
        ]
        columns = (V0, OMEGA0, REST, DISTANCE, *log_odds)
        return frame_of(Table(self.candidates, columns))


def load_discrimination(file: str | PathLike[str]) -> Discrimination:
    """Read a saved `discrimination.json`, or the one in a folder.

    Raises
    ------
    DataError : missing, not a file of curlfit, or of a schema that this version
        cannot read.

    Examples
    --------
    >>> between.save("discrimination.json")
    >>> curlfit.load_discrimination("discrimination.json").decided
    True
    """
    return Discrimination.read(file)


def print_discrimination(
    discrimination: Discrimination, console: Console | None = None
) -> None:
    """Print the report of throws that decide between laws.

    Examples
    --------
    >>> curlfit.print_discrimination(between)
    front-back and power+pivot, uniform load: throws that decide between laws
    ...
    """
    show(document(discrimination), console)


def document(discrimination: Discrimination) -> Document:
    """How many throws decide, and which."""
    laws = join_words([*discrimination.laws])
    sentences = _summary(discrimination)
    record = measured(
        discrimination.rate,
        discrimination.until,
        discrimination.sigma,
        discrimination.stone,
    )
    return Document(
        finding=lower(sentences[0]).rstrip("."),
        subject=Text.assemble(
            (laws, "bold"),
            f", {discrimination.load} load: throws that decide between laws",
        ),
        about=(record,),
        lines=[record, *sentences[1:]],
        sections=(
            Section(
                "pairs",
                "Expected log odds",
                (*map(Said, sentences), _pairs(discrimination)),
            ),
            Section(
                "laws", "The laws", (_laws(discrimination),), titled=True, brief=False
            ),
            Section(
                "single",
                "A single throw",
                (_single(discrimination),),
                titled=True,
                brief=False,
            ),
        ),
        notes=_notes(discrimination),
        title=f"Throws that decide between {laws}",
        settings={
            "Laws, load": f"{laws}, {discrimination.load}",
            "Stone": stone_text(discrimination.stone),
            "Noise": noise_text(discrimination.sigma),
        },
        command=discrimination.command,
        names=discrimination.laws,
    )


def _percent(probability: float) -> str:
    """A probability, rounded so that it does not promise too much."""
    return f"{math.floor(1000 * min(probability, 0.9999)) / 10:g} %"


def _summary(discrimination: Discrimination) -> list[str]:
    """Sentences on how many throws decide, and which."""
    worst = discrimination.worst
    count = len(discrimination.throws)
    throws = throws_text(discrimination.candidates, discrimination.throws)
    odds = f"leads by odds of {ODDS} to 1 with a probability of"
    if discrimination.decided:
        odds_alone = discrimination.by_size.values()
        alone = sum(value > DECISIVE for value in odds_alone)
        decide = "decides" if count == 1 else "decide"
        lines = [
            f"{counted(count, 'throw')} {decide}: {throws}. "
            f"Whichever law is true, it {odds} at least {_percent(worst.decides)}."
        ]
        if count == 1 and alone > 1:
            lines.append(
                f"In expectation, {alone} of the {len(odds_alone)} speeds and "
                "spins do so alone."
            )
        return lines
    if discrimination.asked is None:
        start = "Cannot be decided by tracks of this precision"
    else:
        verb = "does" if count == 1 else "do"
        start = f"{counted(count, 'throw')} of this precision {verb} not decide"
    lines = [
        f"{start}: if {worst.truth} is true, it {odds} only {_percent(worst.decides)} "
        f"over {worst.rival}, after {counted(count, 'throw')}, {throws}."
    ]
    if worst.chi_squared < count:
        lines.append(
            f"{worst.rival} follows these throws of {worst.truth} to within "
            "the noise: with these coefficients it contains that law, "
            "or their paths agree."
        )
    return lines


_PAIR_COLUMNS: tuple[Column[Pair], ...] = (
    Column("true law", key="truth"),
    Column("rival"),
    Column("left by rival,\nover the noise", format=".2g", right=True, key="relative"),
    Column(
        "log odds",
        words=lambda pair: f"{pair.log_odds:.1f} +- {pair.sd:.1f}",
        right=True,
        key="log_odds",
    ),
    Column("true law\nleads", format=_percent, right=True, key="wins"),
    Column(f"by {ODDS}\nto 1", format=_percent, right=True, key="decides"),
)


def _pairs(discrimination: Discrimination) -> Table[Pair]:
    """What the throws promise for each pair of laws."""
    return Table(
        discrimination.pairs,
        _PAIR_COLUMNS,
        "Expected log odds of these throws, and probabilities",
        keys=2,
    )


def _laws(discrimination: Discrimination) -> Table[tuple[str, dict[str, float]]]:
    """The laws with their coefficients."""
    columns: tuple[Column[tuple[str, dict[str, float]]], ...] = (
        Column("law", lambda law: law[0]),
        Column("coefficients", lambda law: law[1], _coefficients_in_words),
    )
    return Table(
        list(discrimination.laws.items()),
        columns,
        "The laws: the same ordinary draw, 2 m/s and 1 rad/s",
    )


def _coefficients_in_words(coefficients: dict[str, float]) -> str:
    """Coefficients of a law in one line."""
    return ", ".join(f"{name} = {value:.4g}" for name, value in coefficients.items())


def _single(discrimination: Discrimination) -> Table[PossibleThrow]:
    """The odds from a single throw, of the worse sense of spin."""
    throw_by_size = {
        (throw.v0, abs(throw.omega0)): throw for throw in discrimination.candidates
    }
    odds_by_size = discrimination.by_size
    rows = [
        replace(throw, omega0=spin, log_odds=(odds_by_size[v0, spin],))
        for (v0, spin), throw in throw_by_size.items()
    ]
    hardest: Column[PossibleThrow] = Column(
        "log odds,\nhardest pair", format=".1f", right=True, key="least"
    )
    return Table(
        rows,
        (V0, OMEGA0, REST, DISTANCE, hardest),
        "A single throw of either sense of spin",
        keys=2,
    )


def _notes(discrimination: Discrimination) -> list[Finding]:
    """How the odds are computed, and which throws are not compared."""
    notes = [Finding.note("odds-by-bic", odds=ODDS, decisive=DECISIVE)]
    if discrimination.left_out:
        throws = [
            {"v0": v0, "omega0": omega0} for v0, omega0 in discrimination.left_out
        ]
        notes.append(Finding.note("throws-left-out", throws=throws))
    return notes
