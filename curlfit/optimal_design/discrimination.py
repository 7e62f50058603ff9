"""The record of throws that decide between laws, and what it says."""

from __future__ import annotations

import math
from dataclasses import dataclass
from os import PathLike
from typing import Any, ClassVar, NamedTuple

from rich.console import Console
from rich.text import Text

from curlfit.findings import Finding
from curlfit.foreign import counted
from curlfit.loads import Load
from curlfit.optimal_design.report import measured, noise_text, throws_text
from curlfit.output.console import PlainTable
from curlfit.output.document import Document, Said, Section, show
from curlfit.output.frames import frame
from curlfit.output.text import stone_text
from curlfit.records import Record, require
from curlfit.stone import Stone
from curlfit.wording import join_words, lower

ODDS = 100
"""Odds to 1 at which a law is decided, and ..."""
DECISIVE = math.log(ODDS)
PROBABILITY = 0.9
"""... the probability of these odds that is required, and ..."""
MARGIN = 1.2815515655446004
"""... its quantile of the normal distribution."""


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
        names = ("v0", "omega0", "rest", "distance")
        columns = {
            name: [getattr(throw, name) for throw in self.candidates] for name in names
        }
        for index, pair in enumerate(self.pairs):
            name = f"{pair.truth} over {pair.rival}"
            columns[name] = [throw.log_odds[index] for throw in self.candidates]
        return frame(columns)


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


def print_discrimination(found: Discrimination, console: Console | None = None) -> None:
    """Print the report of throws that decide between laws.

    Examples
    --------
    >>> curlfit.print_discrimination(between)
    front-back and power+pivot, uniform load: throws that decide between laws
    ...
    """
    show(document(found), console)


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


def _pairs(discrimination: Discrimination) -> PlainTable:
    rows = [
        {
            "true law": pair.truth,
            "rival": pair.rival,
            ">left by rival,\nover the noise": f"{pair.relative:.2g}",
            ">log odds": f"{pair.log_odds:.1f} +- {pair.sd:.1f}",
            ">true law\nleads": _percent(pair.wins),
            f">by {ODDS}\nto 1": _percent(pair.decides),
        }
        for pair in discrimination.pairs
    ]
    return PlainTable(
        rows, "Expected log odds of these throws, and probabilities", keys=2
    )


def _laws(discrimination: Discrimination) -> PlainTable:
    rows = [
        {
            "law": law,
            "coefficients": ", ".join(
                f"{name} = {value:.4g}" for name, value in values.items()
            ),
        }
        for law, values in discrimination.laws.items()
    ]
    return PlainTable(rows, "The laws: the same ordinary draw, 2 m/s and 1 rad/s")


def _single(discrimination: Discrimination) -> PlainTable:
    by_start = {
        (throw.v0, abs(throw.omega0)): throw for throw in discrimination.candidates
    }
    rows = [
        {
            ">v0\n(m/s)": f"{v0:g}",
            ">omega0\n(rad/s)": f"{spin:g}",
            ">at rest\n(s)": f"{by_start[v0, spin].rest:.1f}",
            ">after\n(m)": f"{by_start[v0, spin].distance:.1f}",
            ">log odds,\nhardest pair": f"{least:.1f}",
        }
        for (v0, spin), least in discrimination.by_size.items()
    ]
    return PlainTable(rows, "A single throw of either sense of spin", keys=2)


def _notes(discrimination: Discrimination) -> list[Finding]:
    """How the odds are computed, and which throws are not compared."""
    notes = [Finding.note("odds-by-bic", odds=ODDS, decisive=DECISIVE)]
    if discrimination.left_out:
        throws = [
            {"v0": v0, "omega0": omega0} for v0, omega0 in discrimination.left_out
        ]
        notes.append(Finding.note("throws-left-out", throws=throws))
    return notes
