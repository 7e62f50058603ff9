"""The record of a design, and its one versioned form in JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from os import PathLike
from pathlib import Path
from typing import Any

from curlfit.errors import DataError
from curlfit.inference.identifiability import Combination
from curlfit.output.files import Migration, known_fields, read_json, write_json
from curlfit.stone import Stone

SCHEMA = 1
MIGRATIONS: dict[int, Migration] = {}


@dataclass(frozen=True)
class Candidate:
    """A throw that could be made, and what it alone would tell.

    Attributes
    ----------
    v0, omega0 : initial speed (m/s) and spin (rad/s).
    rate : rows a second.
    rows, last, rest : length of the record, time of its last row and of coming to rest (s).
    distance : from the start to where it comes to rest (m).
    stderr : standard error by quantity, None where this throw alone does not determine it.
    """

    v0: float
    omega0: float
    rate: float
    rows: int
    last: float
    rest: float
    distance: float
    stderr: dict[str, float | None]


@dataclass(frozen=True)
class Expected:
    """What some throws together would tell.

    Attributes
    ----------
    throws : places among the candidates, a throw made twice being there twice.
    stderr : standard error by coefficient (None where it is not determined) and combination.
    verdicts : by coefficient, as in `FitResult`; "fixed" for one that is held at its value.
    combinations : what is determined where single coefficients are not.
    rank, singular_values, null_directions : see `curlfit.inference.identifiability`.
    """

    throws: tuple[int, ...]
    stderr: dict[str, float | None]
    verdicts: dict[str, str]
    combinations: tuple[Combination, ...]
    rank: int
    singular_values: tuple[float, ...]
    null_directions: tuple[dict[str, float], ...]

    @classmethod
    def from_json(cls, found: Mapping[str, Any]) -> Expected:
        """The record from JSON."""
        given = known_fields(cls, found)
        lists = ("throws", "singular_values", "null_directions")
        tuples = {key: tuple(given[key]) for key in lists}
        combinations = tuple(
            Combination(**known_fields(Combination, item)) for item in given["combinations"]
        )
        return cls(**given | tuples | {"combinations": combinations})


@dataclass(frozen=True)
class Design:
    """What planned throws would tell.

    Attributes
    ----------
    law, load, stone, coefficients : what is taken to be true; coefficients by name.
    symbols, units, typical : of the coefficients, by name.
    sigma : noise by channel that is measured (SI).
    until : end of the records in s; when the stone has come to rest if None.
    throws : how many are made.
    candidates : the throws to choose from.
    quantities : what all candidates together determine, as weights by coefficient.
    rank, free : directions that all candidates together determine, and free coefficients.
    best : by criterion "D" and "A" the best choice of `throws` candidates.
    curves : of the D-best throws, for figures: by "place", "angle" (factor on that noise alone),
        "rate" (Hz) and "throws" (number, the best for each), each "at" and by quantity.
    separation : what it takes to tell two coefficients apart, if that was asked for or is open.
    notes : what to mind.
    """

    law: str
    load: str
    stone: Stone
    coefficients: dict[str, float]
    symbols: dict[str, str]
    units: dict[str, str]
    typical: dict[str, float]
    sigma: dict[str, float]
    until: float | None
    throws: int
    candidates: tuple[Candidate, ...]
    quantities: dict[str, dict[str, float]]
    rank: int
    free: int
    best: dict[str, Expected]
    curves: dict[str, dict[str, list[float | None]]]
    separation: Separation | None
    notes: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """The record as written to `design.json`."""
        return {"schema": SCHEMA} | asdict(self)

    @classmethod
    def from_json(cls, found: Mapping[str, Any]) -> Design:
        """The record from what `to_json` gave. Raises KeyError or TypeError if it is not one."""
        parted = found["separation"]
        return cls(
            **known_fields(cls, found)
            | {
                "stone": Stone(**known_fields(Stone, found["stone"])),
                "candidates": tuple(
                    Candidate(**known_fields(Candidate, item)) for item in found["candidates"]
                ),
                "best": {name: Expected.from_json(item) for name, item in found["best"].items()},
                "separation": None if parted is None else Separation.from_json(parted),
                "notes": tuple(found["notes"]),
            }
        )

    def save(self, file: str | PathLike[str]) -> None:
        """Write the record as JSON, whole or not at all."""
        write_json(self.to_json(), Path(file))


def load_design(file: str | PathLike[str]) -> Design:
    """Read a saved `design.json`, or the one in a folder.

    Raises
    ------
    DataError : it is not there, is none of curlfit's, or has a schema this version cannot read.
    """
    path = Path(file)
    if path.is_dir():
        path = path / "design.json"
    found = read_json(path, SCHEMA, MIGRATIONS)
    try:
        return Design.from_json(found)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise DataError(
            f"not a complete design.json of curlfit ({type(error).__name__}: {error})", file=path
        ) from None


@dataclass(frozen=True)
class Proof:
    """What the difference of two coefficients does to force and moment under uniform load.

    Attributes
    ----------
    states : number of random speeds and spins that were looked at.
    by_difference, by_sum : largest derivative, over these, of T_xi/(m g), T_eta/(m g) and
        M/(m g R) when one coefficient grows and the other falls, and when both grow.
    throws : number of throws, of many speeds and spins, taken together.
    singular_values : of the root of their information on the coefficients, largest first, by
        typical sizes, noise as planned.
    hidden : whether neither shows anything but rounding.
    because : why, in words, where that is known.
    """

    states: int
    by_difference: tuple[float, ...]
    by_sum: tuple[float, ...]
    throws: int
    singular_values: tuple[float, ...]
    hidden: bool
    because: str


@dataclass(frozen=True)
class Way:
    """How well throws tell the two apart under one load.

    Attributes
    ----------
    load : "uniform" or "consistent".
    each : standard error of the difference from each candidate alone, None where it cannot tell.
    throws : places of the candidates that tell it best, as many as planned; None if none can.
    stderr : standard error of the difference from these.
    steady : relative change of the sum of both coefficients between these throws that would be
        taken for the wanted error; None where they are all alike, and none does.
    """

    load: str
    each: tuple[float | None, ...]
    throws: tuple[int, ...] | None
    stderr: float | None
    steady: float | None


@dataclass(frozen=True)
class Change:
    """A change to the stone, and the standard error of the difference with it.

    Attributes
    ----------
    name, value : what is changed, and to what (m).
    all : from the throws that tell it best, all with the changed stone; None where it cannot tell.
    half : from as many ordinary throws, half of them with the stone as it is, half with the changed
        one.
    steady : relative change of the sum of both coefficients, from the one half to the other, that
        would be taken for the wanted error of the difference.
    """

    name: str
    value: float
    all: float | None
    half: float | None
    steady: float | None


@dataclass(frozen=True)
class Separation:
    """What it takes to tell two coefficients apart.

    Attributes
    ----------
    pair : the coefficients.
    size, of : what errors are relative to: the "difference" as set, or the "mean" of both where
        they are set equal.
    wanted : relative error that is asked for.
    proof : for the uniform load.
    ways : by load.
    ordinary : place of the candidate that is most like an ordinary throw.
    changes : to the stone, under the consistent load.
    """

    pair: tuple[str, str]
    size: float
    of: str
    wanted: float
    proof: Proof
    ways: tuple[Way, ...]
    ordinary: int
    changes: tuple[Change, ...]

    def way(self, load: str) -> Way:
        """What there is under one load."""
        return next(way for way in self.ways if way.load == load)

    def noise_factor(self, stderr: float) -> float:
        """What to multiply all noise with for the wanted error; errors go with the noise."""
        return self.wanted * self.size / stderr

    def throws_needed(self, stderr: float, throws: int) -> float:
        """How many such throws give the wanted error, if so many give this one."""
        return throws / self.noise_factor(stderr) ** 2

    def throws_against(self, scatter: float, steady: float) -> float:
        """How many throws, half with each stone, average out a relative scatter of the sum."""
        return (2 * scatter / steady) ** 2

    def to_json(self) -> dict[str, Any]:
        """As plain values."""
        return asdict(self)

    @classmethod
    def from_json(cls, found: Mapping[str, Any]) -> Separation:
        """The record from what `to_json` gave."""

        def tuples(record: type, item: Mapping[str, Any]) -> dict[str, Any]:
            return {
                key: tuple(value) if isinstance(value, list) else value
                for key, value in known_fields(record, item).items()
            }

        return cls(
            pair=(found["pair"][0], found["pair"][1]),
            size=found["size"],
            of=found["of"],
            wanted=found["wanted"],
            proof=Proof(**tuples(Proof, found["proof"])),
            ways=tuple(Way(**tuples(Way, item)) for item in found["ways"]),
            ordinary=found["ordinary"],
            changes=tuple(Change(**known_fields(Change, item)) for item in found["changes"]),
        )
