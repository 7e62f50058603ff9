"""A throw: the measurements of one stone, in SI units and radians."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from curlfit.errors import DataError, InputError, require_kind
from curlfit.findings import Finding
from curlfit.foreign import counted, quoted
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.output.display import Displayed
from curlfit.output.document import Document, Section
from curlfit.output.frames import frame
from curlfit.output.table import Column, Table
from curlfit.settings.choices import Reading, takes
from curlfit.throws.channels import CHANNELS, UNITS, condensed
from curlfit.throws.events import Event, lines_of, sketch
from curlfit.throws.odd_row import OddRow
from curlfit.throws.readers.sequences import Fault, numbers, one_or_many, times
from curlfit.throws.reference import Conventions, Reference

MOST_ROWS = 6000
"""Number of rows above which a fit condenses its data."""


def counts_from_hack(notes: Iterable[Finding]) -> bool:
    """Whether y is measured from the hack, according to the notes of a reader."""
    return any(_says_that_y_is_from_hack(note) for note in notes)


def _says_that_y_is_from_hack(note: Finding) -> bool:
    """Whether a note says that y is measured from the hack."""
    if note.code == "axes":
        return bool(note.numbers["states_zero"])
    if note.code == "text":  # of a fit that an earlier version saved
        return _older_sentence_is_of_hack(note.numbers["text"])
    return note.code == "y-from-the-hack"


def _older_sentence_is_of_hack(sentence: str) -> bool:
    """Whether a note of curlfit 0.2, which wrote no codes, says that y is measured from
    the hack."""
    of_axes = sentence.startswith("axes:") and "from-" in sentence
    return of_axes or sentence.startswith("y from the hack")


@dataclass(frozen=True, eq=False, repr=False)
class Throw(Displayed):
    """Measured path of one stone.

    Axes and signs: y along the sheet, x to the right, phi counter-clockwise. Two throws
    are equal if their values, sigmas, reference and defaults are equal, whatever their
    origin (`name`, `notes`, `lines`, `labels`).

    Attributes
    ----------
    t : times in s, shape (n,), strictly increasing; the origin does not matter.
    x, y : position of the stone's centre in m, shape (n,); NaN where not measured.
    phi : angle of the stone in rad, unwrapped, shape (n,); NaN where not measured.
    speed, omega : speed of the centre in m/s (>= 0) and spin in rad/s where measured
        directly (by radar, gyroscope), shape (n,); NaN where not. All NaN if not given.
    sigma : standard deviation of the noise by channel, each of shape (n,); that of
        other channels is unknown and is estimated by a fit.
    relative_sigma : of channels without a sigma, its course over the rows where this is
        known, up to a factor that a fit estimates; each of shape (n,).
    calibration : independent errors of the map from pixels to metres, one standard
        deviation each, as of `curlfit.throws.readers.homography.Homography`, shape
        (errors, 3, 3); None without.
    name : name of the throw, for instance a file name.
    reference : values to show beside a fit.
    defaults : settings in the data file (`since`, `until`, `exclude`,
        `stone`, `law`, `load`; `as_given`: implausible data only give
        warnings, see `curlfit.throws.plausibility`).
    conventions : units and axes of the file; None for arrays, which are in SI units.
    notes : remarks of the reader (ignored columns and the like).
    lines : line of each row in the file, for messages.
    events : measured times and positions at lines and at rest
        (`curlfit.throws.events`).
    assumed : values, by name, at which a fit fixes unmeasured components of the
        initial state.
    labels : what a table says of the throw besides measurements, as text by name:
        `sheet`, `stone`, `thrower`, `start` ...
    odd_rows : rows of its stopwatch table that contradict the others, left out of a
        joint fit unless they are many (`curlfit.throws.odd_row.OddRow`).

    Raises
    ------
    DataError : shapes differ, a value is infinite, a time is missing, or times do
        not increase.

    Examples
    --------
    >>> short = curlfit.Throw.from_arrays(
    ...     [0.0, 0.1, 0.2], x=[0, 0, 0], y=[0.0, 0.21, 0.41]
    ... )
    >>> short.name, short.n_observations
    ('throw', 6)
    >>> short == curlfit.Throw.from_frame(short.to_frame())
    True
    """

    t: Floats
    x: Floats
    y: Floats
    phi: Floats
    speed: Floats = field(default_factory=lambda: np.zeros(0))
    omega: Floats = field(default_factory=lambda: np.zeros(0))
    sigma: dict[str, Floats] = field(default_factory=dict)
    name: str = "throw"
    reference: Reference | None = None
    defaults: dict[str, Any] = field(default_factory=dict)
    notes: tuple[Finding, ...] = ()
    lines: NDArray[np.int64] | None = None
    events: tuple[Event, ...] = ()
    assumed: dict[str, float] = field(default_factory=dict)
    labels: dict[str, str] = field(default_factory=dict)
    conventions: Conventions | None = field(default=None, repr=False)
    relative_sigma: dict[str, Floats] = field(default_factory=dict)
    calibration: Floats | None = None
    read_with: tuple[str, ...] = ()
    """the flags with which its file was read"""
    odd_rows: tuple[OddRow, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "t", times(self.t, _fault_of("t")))
        n = len(self.t)
        self._require(np.isfinite(self.t), "t", "expected a finite number")
        for name in CHANNELS:
            values = numbers(getattr(self, name), _fault_of(name))
            if name in ("speed", "omega") and not len(values):
                values = np.full(n, np.nan)
            object.__setattr__(self, name, values)
            self._require_rows(name, values)
            sound = ~np.isinf(values)
            self._require(sound, name, "expected a finite number, or NaN")
        for name, values in self.sigma.items():
            if name not in CHANNELS:
                raise InputError(
                    f"sigma: {quoted(name)} found, expected channels, which are "
                    f"{', '.join(CHANNELS)}"
                )
            self._require_rows(f"sigma_{name}", values)
            sound = (np.isfinite(values) & (values > 0)) | np.isnan(getattr(self, name))
            self._require(
                sound, f"sigma_{name}", "expected a positive standard deviation"
            )
        order = "times must increase from row to row (`Throw.from_frame` sorts rows)"
        self._require(np.append(True, np.diff(self.t) > 0), "t", order)
        if not self.finite.any() and not self.events:
            raise self._error(
                f"no value is given; expected some of {', '.join(CHANNELS)}"
            )

    def _require_rows(self, name: str, values: Floats) -> None:
        """Raise `DataError` for an array that has not one value of each row."""
        n = len(self.t)
        if np.shape(values) != (n,):
            raise self._error(f"{name} has shape {np.shape(values)}, t has {(n,)}")

    def _require(self, sound: Booleans, column: str, expected: str) -> None:
        """Raise `DataError` for the first value of a column that is not sound."""
        if not sound.all():
            row = int(np.argmin(sound))
            if column.startswith("sigma_"):
                values = self.sigma[column.removeprefix("sigma_")]
            else:
                values = getattr(self, column)
            raise self._error(f"{values[row]:g} found; {expected}", row, column)

    def _error(
        self, message: str, row: int | None = None, column: str | None = None
    ) -> DataError:
        line = None if row is None or self.lines is None else int(self.lines[row])
        if row is not None and line is None:
            message = f"row {row}: {message}"
        return DataError(message, file=self.name, line=line, column=column)

    @classmethod
    def from_arrays(
        cls,
        t: ArrayLike,
        x: ArrayLike | None = None,
        y: ArrayLike | None = None,
        phi: ArrayLike | None = None,
        *,
        speed: ArrayLike | None = None,
        omega: ArrayLike | None = None,
        sigma: dict[str, ArrayLike] | None = None,
        units: str | None = None,
        axes: str | None = None,
        **more: Any,
    ) -> Throw:
        """A throw from arrays or lists; channels that were not measured are omitted.

        Times are numbers in s, durations, dates or clock times; of the latter two, the
        first is 0. Masked entries, None and the NA and NaT of pandas are gaps, as NaN
        is. `sigma` values may be single numbers, in the units of their channels.
        `units` and `axes` are as for `load_throw`; without them, values are in SI units
        and in curlfit's axes, with angles unwrapped. `more` are other attributes, for
        instance `name`.

        Raises
        ------
        InputError : something else than numbers in one dimension, or arrays of unlike
            lengths.
        """
        require_kind(
            sigma or {}, Mapping, "sigma", "a mapping by channel, such as {'x': 0.005}"
        )
        if isinstance(t, Mapping) or hasattr(t, "columns"):
            raise InputError(
                f"t: {type(t).__name__} found, expected times; `Throw.from_frame` "
                "reads a table"
            )
        seconds = times(t, _fault_of("t"))
        channels = {"x": x, "y": y, "phi": phi, "speed": speed, "omega": omega}
        arrays = {
            name: numbers(values, _fault_of(name))
            for name, values in channels.items()
            if values is not None
        }
        sigmas = {
            name: one_or_many(values, len(seconds), _fault_of(f"sigma of {name}"))
            for name, values in (sigma or {}).items()
        }
        if units or axes:
            columns = {"t": t, **arrays}
            for name, values in sigmas.items():
                columns[f"sigma_{name}"] = values
            name = more.get("name", "table")
            throw = cls.from_frame(columns, name, units=units, axes=axes)
            return replace(throw, **more)
        blank: Any = {name: np.full_like(seconds, np.nan) for name in CHANNELS}
        return cls(t=seconds, **blank | arrays, sigma=sigmas, **more)

    @classmethod
    def from_events(
        cls,
        events: Sequence[Event],
        *,
        assumed: Mapping[str, float] | None = None,
        **more: Any,
    ) -> Throw:
        """A throw of which only events were measured, such as stopwatch times.

        Its clock starts at the first line; `t` contains the times at which a
        fit is shown.

        Parameters
        ----------
        assumed : as the attribute; the stone starts at the first line with x = 0
            and phi = 0.
        more : other attributes.

        Raises
        ------
        InputError : no line is crossed.
        """
        lines = lines_of(events)
        if not lines:
            raise InputError(
                "no event is timed at a line; expected one such as hog_to_hog"
            )
        assumed = {"y0": lines[0], **(assumed or {})}
        t, _ = sketch(events, assumed)
        return cls.from_arrays(t, events=tuple(events), assumed=assumed, **more)

    @classmethod
    @takes(Reading, "format", "worksheet", "shot", "handle", "keep", "throws")
    def from_frame(cls, table: Any, name: str = "table", **choices: Any) -> Throw:
        """A throw from a pandas or polars DataFrame, a PyArrow Table, an xarray
        Dataset, a NumPy array with named fields or a mapping of arrays.

        Columns are named as in files (`t`, `y_ft`, `angle_deg` ...), with units in the
        names; the `attrs["units"]` of a variable take precedence. An index that is
        named `time` or has dates, or the coordinate of a dataset, is taken as `t` where
        no column is. Times and gaps may be as of `from_arrays`.

        Parameters
        ----------
        name : name of the throw.
        {choices}

        Raises
        ------
        DataError, InputError : not a table, a column that is missing or not numeric.
        """
        from curlfit.throws.readers.frames import values_of

        return cls.from_arrays(**values_of(table, Reading.of(**choices), name))

    def to_frame(self) -> Any:
        """The rows as a pandas DataFrame that `from_frame` reads: `t`, the measured
        channels and, where given, `sigma_x`, `sigma_y` ... (SI, rad).

        Raises
        ------
        InputError : pandas is not installed.
        """
        columns = {name: getattr(self, name) for name in ("t", *self.seen)}
        for name, values in self.sigma.items():
            columns[f"sigma_{name}"] = values
        return frame(columns)

    def __len__(self) -> int:
        return len(self.t)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Throw):
            return NotImplemented
        return all(
            _same(getattr(self, name), getattr(other, name)) for name in _CONTENT
        )

    __hash__ = None  # type: ignore[assignment]  # arrays are mutable

    def _document(self) -> Document:
        def of_values(summary: Callable[[Floats], float]) -> Callable[[str], float]:
            return lambda channel: summary(getattr(self, channel))

        columns: tuple[Column[str], ...] = (
            Column("channel", lambda channel: channel),
            Column("unit", lambda channel: UNITS[channel]),
            Column(
                "values",
                of_values(lambda values: np.isfinite(values).sum()),
                right=True,
            ),
            Column("from", of_values(np.nanmin), ".5g", right=True),
            Column("to", of_values(np.nanmax), ".5g", right=True),
            Column("sigma", self._usual_sigma, ".3g", missing="", right=True),
        )
        table = Table(("t", *self.seen), columns)
        with_sigma = ", ".join(name for name in CHANNELS if name in self.sigma)
        sigma = f"sigma given for {with_sigma}" if with_sigma else "no sigma given"
        return Document(
            finding=counted(len(self), "row"),
            subject=f"{self.name}, t = {self.t[0]:.6g} .. {self.t[-1]:.6g} s",
            lines=[f"channels {', '.join(self.seen)}; {sigma}"],
            sections=[Section("channels", "Channels", [table])],
            notes=self.notes,
        )

    def _usual_sigma(self, channel: str) -> float | None:
        """The median of the given sigma of a channel; None where none was given."""
        sigma = self.sigma.get(channel)
        return None if sigma is None else float(np.nanmedian(sigma))

    @cached_property
    def observed(self) -> Floats:
        """All channels, shape (5, n), in the order of `CHANNELS`."""
        return np.stack([getattr(self, name) for name in CHANNELS])

    @cached_property
    def finite(self) -> Booleans:
        """Whether each value was measured, shape (5, n)."""
        return np.isfinite(self.observed)

    @cached_property
    def seen(self) -> tuple[str, ...]:
        """Channels with at least one value."""
        return tuple(
            name for name in CHANNELS if np.isfinite(getattr(self, name)).any()
        )

    @cached_property
    def n_observations(self) -> int:
        """Number of finite values in all channels plus number of events."""
        return int(np.count_nonzero(self.finite)) + len(self.events)

    def sigma_over_smallest(self, name: str) -> Floats:
        """The course of a channel's sigma over its rows where only this is known, with
        a smallest value of 1 among the measured ones; 1 for all others. Shape (n,)."""
        sigma = self.relative_sigma.get(name)
        measured = np.isfinite(getattr(self, name))
        if sigma is None or not measured.any():
            return np.ones(len(self))
        return np.where(measured, sigma / sigma[measured].min(), 1.0)

    @property
    def has_path(self) -> bool:
        """Whether any channel was measured, apart from events."""
        return bool(self.seen)

    def sketched(self) -> Throw:
        """The throw without events; if there is nothing else, a rough path
        replaces them."""
        if not self.events:
            return self
        channels: Any = {} if self.has_path else sketch(self.events, self.assumed)[1]
        return replace(self, events=(), **channels)

    def condensed(self, most: int = MOST_ROWS) -> Throw:
        """The throw condensed to at most about `most` rows, means over blocks,
        with a note."""
        return self if len(self) <= most else replace(self, **condensed(self, most))

    def select_rows(
        self,
        since: float | None = None,
        until: float | None = None,
        exclude: Sequence[Sequence[float]] = (),
    ) -> Throw:
        """The rows with since <= t <= until outside the intervals to exclude (s).

        Raises
        ------
        InputError : an interval is empty, or no row is left.
        """
        if since is None and until is None and not len(exclude):
            return self
        if not self.has_path:
            raise InputError(
                f"{self.name}: timed events only; there are no rows to choose"
            )
        low = -math.inf if since is None else since
        high = math.inf if until is None else until
        keep = (self.t >= low - 1e-9) & (self.t <= high + 1e-9)
        if not keep.any():
            limits = {"since": since, "until": until}
            chosen = " and ".join(
                f"{name} = {limit:g} s"
                for name, limit in limits.items()
                if limit is not None
            )
            raise InputError(
                f"no row of {self.name} remains with {chosen}; its times are "
                f"{self.t[0]:g} .. {self.t[-1]:g} s"
            )
        for begin, end in exclude:
            if not begin < end:
                raise InputError(
                    f"exclude {begin:g}:{end:g}: expected A:B with A before B"
                )
            keep &= (self.t < begin - 1e-9) | (self.t > end + 1e-9)
        if not keep.any():
            raise InputError(f"the excluded intervals leave no row of {self.name}")
        rows: dict[str, Any] = {
            name: getattr(self, name)[keep] for name in ("t", *CHANNELS)
        }
        for name in ("sigma", "relative_sigma"):
            rows[name] = {
                channel: values[keep] for channel, values in getattr(self, name).items()
            }
        rows["lines"] = None if self.lines is None else self.lines[keep]
        return replace(self, **rows)

    def with_defaults(self, **defaults: Any) -> Throw:
        """The throw with some defaults replaced."""
        return replace(self, defaults=self.defaults | defaults)

    @property
    def settings(self) -> dict[str, Any]:
        """The defaults; sigma only of channels without one for each row."""
        sigma = {
            name: value
            for name, value in self.defaults.get("sigma", {}).items()
            if name not in self.sigma
        }
        return {**self.defaults, "sigma": sigma}

    def with_sigma(self, sigma: dict[str, float]) -> Throw:
        """The throw with one standard deviation for all rows of a channel, or for all
        times of events ("time"); SI units."""
        check_sigma(sigma)
        if not sigma:
            return self
        sigma_of_rows = dict(self.sigma)
        for name in CHANNELS:
            if name in sigma:
                sigma_of_rows[name] = np.full_like(self.t, sigma[name])
        events = self.events
        if "time" in sigma:
            events = tuple(
                replace(event, sigma=sigma["time"])
                if event.quantity == "time"
                else event
                for event in events
            )
        return replace(self, sigma=sigma_of_rows, events=events)


def _fault_of(name: str) -> Fault:
    """What makes the error of an argument, from what is wrong with it."""
    return lambda fault: InputError(f"{name}: {fault}")


_CONTENT = ("t", *CHANNELS, "sigma", "reference", "defaults")  # compared for equality


def _same(value: Any, other: Any) -> bool:
    """Equality; arrays are compared by value, with NaN equal to NaN."""
    if isinstance(value, dict) and isinstance(other, dict):
        return value.keys() == other.keys() and all(
            _same(value[key], other[key]) for key in value
        )
    if isinstance(value, np.ndarray) or isinstance(other, np.ndarray):
        return np.array_equal(
            np.asarray(value, float), np.asarray(other, float), equal_nan=True
        )
    return bool(value == other)


def require_throw(throw: object) -> None:
    """Raise `InputError` for anything but a throw, such as a file name."""
    expected = (
        "a Throw, as from curlfit.load_throw(file) or "
        "curlfit.Throw.from_arrays(t, x, y)"
    )
    require_kind(throw, Throw, "throw", expected)


def require_path(throw: Throw) -> None:
    """Raise `InputError` for a throw of timed events alone."""
    if not throw.has_path:
        raise InputError(
            f"{throw.name}: laws cannot be ranked by {len(throw.events)} timed "
            "events; expected a path. `curlfit fit --law NAME` fits one law to them"
        )


def check_sigma(sigma: Mapping[str, float]) -> None:
    """Raise `InputError` if a standard deviation is not positive or its
    channel is unknown."""
    for name, value in sigma.items():
        if name not in (*CHANNELS, "time"):
            raise InputError(
                f"no channel {quoted(name)}; the channels are {', '.join(CHANNELS)}, "
                "and `time` of events"
            )
        if not (math.isfinite(value) and value > 0):
            raise InputError(f"sigma of {name} = {value:g}: expected a positive number")
