"""Objects within the record of a fit."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Annotated, Self

import numpy as np

from curlfit.findings import Finding
from curlfit.foreign import counted
from curlfit.inference.information.named_matrix import NamedMatrix, read_only
from curlfit.losses import LOSSES
from curlfit.noises import NOISES, Noise
from curlfit.numerics.arrays import Floats
from curlfit.records import ADDED, Entry, Kinds, OneOf, written_as
from curlfit.throws.channels import CHANNELS
from curlfit.throws.events import QUANTITIES, Event
from curlfit.throws.reference import StoneValues

ChannelName = Annotated[str, OneOf(CHANNELS)]
LossName = Annotated[str, OneOf(LOSSES)]
NoiseName = Annotated[str, OneOf(NOISES)]
AnyNoise = Annotated[Noise, Kinds(type(noise) for noise in NOISES.values())]
Span = tuple[float, float]
"""Two times on the clock of the data, s."""


@dataclass(frozen=True, kw_only=True)
class Extent(Entry):
    """How much of a file was fitted.

    Attributes
    ----------
    file : its name.
    rows : number of rows of a path that were used.
    begin, end : first and last time, s on the clock of the data; "from" and "to" in
        files.
    """

    file: str
    rows: int
    begin: float = field(metadata=written_as("from"))
    end: float = field(metadata=written_as("to"))

    @property
    def in_words(self) -> str:
        """Number of the rows used, and the times that they span; empty without rows."""
        if not self.rows:
            return ""
        return f"{counted(self.rows, 'row')}, t = {self.begin:g} .. {self.end:g} s"


@dataclass(frozen=True, kw_only=True)
class DataOfFit(Extent):
    """How much of a file was fitted, and how it was chosen.

    Attributes
    ----------
    law_file : the file of a user's law with its class, as FILE.py:CLASS.
    since, until, exclude : limits of the rows that were used, and spans left out, s.
    swept : times between which the ice was swept, s.
    sigma : "estimated" or "given", by measured channel.
    notes : remarks on what was read.
    labels : of the throw, such as its sheet.
    flags : those that make this fit of the file.
    """

    law_file: str | None = None
    since: float | None = None
    until: float | None = None
    exclude: tuple[Span, ...] = ()
    swept: Span | None = None
    sigma: dict[ChannelName, str] = field(default_factory=dict)
    notes: tuple[Finding, ...] = ()
    labels: dict[str, str] = field(default_factory=dict, metadata=ADDED)
    flags: tuple[str, ...] = field(default=(), metadata=ADDED)

    @property
    def in_words(self) -> str:
        """Number of the rows used, the times that they span, and spans left out."""
        left_out = [f"without {begin:g} .. {end:g} s" for begin, end in self.exclude]
        return ", ".join(filter(None, [super().in_words, *left_out]))

    @property
    def extent(self) -> Extent:
        """How much of the file was fitted, alone."""
        return Extent(file=self.file, rows=self.rows, begin=self.begin, end=self.end)


@dataclass(frozen=True)
class Determined(Entry):
    """What a fit determines, in short; `curlfit.inference.information` computes it.

    Attributes
    ----------
    rank : number of directions in the space of the free parameters that the data
        determine.
    singular_values : of the Jacobian in typical sizes, those of the `rank` determined
        directions first.
    null_directions : directions along which the residuals stay the same, as weights by
        name of the parameter.
    """

    rank: int
    singular_values: tuple[float, ...]
    null_directions: tuple[dict[str, float], ...]


@dataclass(frozen=True, eq=False)
class GaussNewtonInformation(NamedMatrix):
    """What the data say of the free parameters to first order.

    Attributes
    ----------
    names : of the free parameters.
    matrix : J^T J of the residuals over sigma.
    gradient : of the log-likelihood, zero except for parameters at a bound.
    """

    gradient: Floats

    def __post_init__(self) -> None:
        """Protect the numbers of a record from a computation in place."""
        super().__post_init__()
        object.__setattr__(self, "gradient", read_only(self.gradient))

    @classmethod
    def none(cls) -> Self:
        """That of no parameters."""
        return cls((), np.zeros((0, 0)), np.zeros(0))


@dataclass(frozen=True)
class FittedEvent(Entry):
    """A measured time or place at a line or at rest, beside its value in the fit.

    Attributes
    ----------
    name, quantity, value, sigma, at, since : see `curlfit.throws.events.Event`.
    fitted : the value in the fit.
    """

    name: str
    quantity: Annotated[str, OneOf(QUANTITIES)]
    value: float
    sigma: float
    at: float | None
    since: float | None
    fitted: float

    @classmethod
    def of(cls, event: Event, fitted: float) -> Self:
        """An event with its value in the fit."""
        return cls(**asdict(event), fitted=fitted)

    @property
    def residual(self) -> float:
        """Measured - fitted, over sigma."""
        return (self.value - self.fitted) / self.sigma

    @property
    def event(self) -> Event:
        """What was measured."""
        return Event(
            self.name, self.quantity, self.value, self.sigma, self.at, self.since
        )


@dataclass(frozen=True)
class Outlier(Entry):
    """A value far from the fit.

    Attributes
    ----------
    channel, t : where it is, s on the clock of the data.
    line : in the file; None where it is unknown.
    off : measured - fitted, SI.
    sigmas : its size over a robust sigma.
    """

    channel: ChannelName
    t: float
    line: int | None
    off: float
    sigmas: float


@dataclass(frozen=True)
class FurtherMeasurement(Entry):
    """What would determine some parameters.

    Attributes
    ----------
    parameters : their names.
    measure : channels of which any one suffices; empty where none would help.
    all : whether all of these are needed.
    """

    parameters: tuple[str, ...]
    measure: tuple[ChannelName, ...]
    all: bool


@dataclass(frozen=True)
class RefitWithStone(Entry):
    """The estimates of a fit with other constants of the stone.

    Attributes
    ----------
    stone : the constants that were changed.
    values : by name of a coefficient, or expression of a combination.
    """

    stone: StoneValues
    values: dict[str, float]
