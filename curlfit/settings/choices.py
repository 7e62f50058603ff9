"""The choices that verbs share.

A field is one choice: its form, its help and, by its name, its flag, its key in a
file of settings and its keyword in Python. None, or nothing in a table or list, means
that it is not given; the default is then that of the data file, or the one that its
help states.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cache
from inspect import Parameter as Sign, cleandoc, signature
from os import fspath
from textwrap import fill
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    ClassVar,
    Self,
    TypeVar,
    get_type_hints,
)

from cyclopts import Group, Parameter

from curlfit.errors import InputError
from curlfit.loads import Load
from curlfit.losses import LOSSES, Loss
from curlfit.noises import NOISES, Noise
from curlfit.settings.forms import (
    HEADINGS,
    LIMITS,
    NAMES,
    PERIOD,
    PERIODS,
    PRIORS,
    SWITCH,
    TEXT,
    TEXTS,
    TIME,
    VALUES,
    Form,
    OneOf,
    Several,
    file_named,
    in_home,
    option,
    whole,
)
from curlfit.stone import Stone

READING = Group("How to read DATA", sort_key=1)
FLAGS = {
    "swept": "--sweep",
    "bounds": "--bound",
    "priors": "--prior",
    "systematics": "--systematic",
    "coefficients": "--set",
}
"""Flags of other names than their choices."""


def flag_of(name: str) -> str:
    """The flag of a choice."""
    return FLAGS.get(name, f"--{name.replace('_', '-')}")


UNSET: Any = None
if TYPE_CHECKING:
    Named = Mapping[str, Any]
else:
    # values by name; cyclopts passes several words only to what is declared
    # a collection
    Named = Collection[str]
COUNT = whole(1)
LINES = Several(COUNT, "a list of line numbers", "line numbers with commas between")
FILE = Form(
    "a name of a file",
    lambda file: in_home(TEXT.checked("", fspath(file))),
    file_named,
    "a word",
)
LOAD = OneOf("load", {load.value: load for load in Load})
LOADS = OneOf("load", {load.value: (load,) for load in Load} | {"both": tuple(Load)})
LOSS = OneOf("loss", LOSSES)
NOISE = OneOf(
    "noise",
    NOISES,
    **{
        further: noise.kind
        for noise in NOISES.values()
        for further in noise.further_names
    },
)
SEVERAL_NOISES = Several(
    NOISE, "noise models", "noise models with commas between", text=True
)
LAW = Form(
    "the name or the class of a law",
    lambda law: in_home(law) if isinstance(law, str) else law,
    written="a name, or FILE.py:CLASS",
    words=lambda law: getattr(law, "name", law),
)
LAWS = Several(LAW, "names or classes of laws", "names with commas between", text=True)
SEED = whole(0, 2**32 - 1)


Function = TypeVar("Function", bound=Callable[..., Any])


def takes(kind: type[Choices], *without: str) -> Callable[[Function], Function]:
    """Let `**choices` of a function be documented as the choices of a kind.

    They enter its signature, and its docstring in place of the line `{choices}`.
    """

    def documented(function: Function) -> Function:
        names = [name for name in kind.forms() if name not in without]
        written = signature(function)
        keywords = [
            Sign(name, Sign.KEYWORD_ONLY, default=kind.usual.get(name))
            for name in names
        ]
        parameters = [
            parameter
            for parameter in written.parameters.values()
            if parameter.kind is not Sign.VAR_KEYWORD
        ]
        function.__signature__ = written.replace(  # type: ignore[attr-defined]
            parameters=[*parameters, *keywords]
        )
        text = "\n".join(
            fill(f"{name} : {kind.help(name)}", 96, subsequent_indent="    ")
            for name in names
        )
        function.__doc__ = cleandoc(function.__doc__ or "").replace("{choices}", text)
        return function

    return documented


def _losses_in_words() -> str:
    """The names of losses, and what is said about some of them."""
    words = [
        f"`{name}` ({loss.about})" if loss.about else f"`{name}`"
        for name, loss in LOSSES.items()
    ]
    return ", ".join(words)


def _noises_in_words() -> str:
    """The names of noises, and what is said about them."""
    return "; ".join(f"`{name}` {noise.about}" for name, noise in NOISES.items())


def given(value: Any) -> bool:
    """Whether a value gives a choice."""
    return not (
        value is None
        or value is False
        or (hasattr(value, "__len__") and not len(value))
    )


@dataclass(frozen=True, kw_only=True)
class Choices:
    """Base of the choices of a verb; the help of a choice is its entry in the
    class's docstring."""

    def __init_subclass__(cls) -> None:
        """Give each choice of the class its help, from the entry in its docstring, and
        the name of its flag."""
        hints = get_type_hints(cls, include_extras=True)
        _, _, entries = cleandoc(cls.__doc__ or "").partition(
            "Attributes\n----------\n"
        )
        for name, text in re.findall(r"^(\w+) : (.+(?:\n +.+)*)", entries, re.M):
            if name not in cls.__annotations__:  # inherited
                continue
            if not hasattr(hints[name], "__metadata__"):  # no choice
                continue
            text = text.replace("{losses}", _losses_in_words())
            text = text.replace("{noises}", _noises_in_words())
            flag: Parameter = hints[name].__metadata__[0]
            flag_name = FLAGS.get(name) or flag.name or None
            with_help = Parameter(help=" ".join(text.split()), name=flag_name)
            kind = hints[name].__origin__
            # cyclopts checks the type of a default if Pydantic is loaded
            if getattr(cls, name) is UNSET:
                kind = kind | None
            cls.__annotations__[name] = Annotated[
                kind, Parameter.combine(flag, with_help)
            ]

    @classmethod
    @cache
    def options(cls) -> dict[str, Parameter]:
        """The flag of each choice by its name."""
        return {
            name: hint.__metadata__[0]
            for name, hint in get_type_hints(cls, include_extras=True).items()
            if hasattr(hint, "__metadata__")
        }

    @classmethod
    @cache
    def forms(cls) -> dict[str, Form]:
        """The form of each choice by its name."""
        return {
            name: flag.converter if isinstance(flag.converter, Form) else SWITCH
            for name, flag in cls.options().items()
        }

    @classmethod
    def help(cls, name: str) -> str:
        """What a choice is."""
        return str(cls.options()[name].help)

    usual: ClassVar[Mapping[str, Any]] = {}
    """Defaults, by name."""

    @classmethod
    def of(cls, *layers: Mapping[str, Any], **keywords: Any) -> Self:
        """Choices from layers, of which the later override the earlier, tables
        entry by entry.

        Layers may have more than these choices, `keywords` only these; they are
        the last layer.

        Raises
        ------
        InputError : a value is of another kind than its choice.
        """
        forms = cls.forms()
        for name in keywords.keys() - forms.keys():
            raise TypeError(
                f"unexpected keyword argument {name!r}; there are {', '.join(forms)}"
            )
        value_by_name: dict[str, Any] = {}
        for layer in (cls.usual, *layers, keywords):
            for name in forms.keys() & layer.keys():
                if not given(layer[name]):
                    continue
                value = forms[name].checked(name, layer[name])
                earlier = value_by_name.get(name)
                if isinstance(value, dict) and isinstance(earlier, dict):
                    value = {**earlier, **value}
                value_by_name[name] = value
        chosen = cls(**value_by_name)
        chosen.check()
        return chosen

    def check(self) -> None:
        """Raise `InputError` where choices exclude one another."""

    def given(self) -> dict[str, Any]:
        """The choices that are given, by name."""
        return {name: value for name, value in self if given(value)}

    def words(self, kind: type[Choices] | None = None) -> list[str]:
        """The flags that give these choices, or those of them that are of a kind."""
        forms = (kind or type(self)).forms()
        words = []
        for name, form in forms.items():
            value = getattr(self, name)
            if not given(value):
                continue
            flag = flag_of(name)
            if value is True:
                words.append(flag)
            else:
                words += [f"{flag}={word}" for word in form.words(value)]
        return words

    def __iter__(self) -> Iterator[tuple[str, Any]]:
        """Names and values of the choices."""
        for choice in fields(self):
            yield choice.name, getattr(self, choice.name)


@Parameter(name="*", group=READING)
@dataclass(frozen=True, kw_only=True)
class Reading(Choices):
    """How a file of data is read.

    Attributes
    ----------
    format : `table`, `timings` (stopwatch), `digitalcurling` (log of DigitalCurling 3),
        `curling-stone-tracker` (stones of a video), or an export of another program:
        `tracker`, `trackmate`, `deeplabcut`, `vernier`, `optitrack`, `vicon`,
        `qualisys`. [default: detected from the file]
    axes : The file's axes, words separated by commas: `x-along`, `x-back`, `x-right`,
        `x-left` and the same for y say where an axis points, seen along the throw;
        `from-hack`, `from-back`, `from-tee`, `from-hog`, `from-centre`, `from-far-hog`,
        `from-far-tee` where its zero lies; `clockwise` or `counter-clockwise` how
        angles count, seen from above (else from +x to +y). [default: x-right,y-along]
    units : Units in place of those of the header: t, x, y, length, angle, speed, spin.
    columns : Headings of the columns t, x, y, angle, speed, spin ... that are not
        understood by their names.
    reference : Positions are in pixels: table of four or more known points u,v
        (pixels), x,y (m).
    worksheet : Worksheet of a workbook (.xlsx, .ods), by its name. [default: the
        first with data]
    stone_index : Object that a tracking program exports, stone of a shot or of a video,
        or throw of a table, from 1. [default: the first object; the stone thrown; with
        `batch`, each]
    shot : Shot of a log with several, from 1. [with `batch`: each]
    handle : Object that a tracking program exports, from 1, that marks the handle or
        any other point of the same stone: its direction from the stone is the angle.
    keep : Rows of a table of stopwatch times, by their lines in the file, that a joint
        fit uses although their values are odd beside those of the others.
    throws : Table with a column `file` (or `track`) and labels of these throws, such as
        `sheet`, `stone`, `thrower`, `start`.
    as_given : Accept data that are implausible for a curling stone, with a warning.
    """

    format: Annotated[str | None, option(TEXT, metavar="NAME")] = None
    axes: Annotated[str | None, option(TEXT, metavar="WORDS")] = None
    units: Annotated[str | None, option(TEXT, metavar="t=ms,x=cm,angle=deg")] = None
    columns: Annotated[Named, option(HEADINGS, metavar="t=Zeit,x=Quer")] = field(
        default_factory=dict
    )
    reference: Annotated[str | None, option(FILE, metavar="POINTS.csv")] = None
    worksheet: Annotated[str | None, option(TEXT, metavar="NAME")] = None
    stone_index: Annotated[int | None, option(COUNT, metavar="N")] = None
    shot: Annotated[int | None, option(COUNT, metavar="N")] = None
    handle: Annotated[int | None, option(COUNT, metavar="N")] = None
    keep: Annotated[Sequence[int], option(LINES, metavar="LINE,...")] = ()
    throws: Annotated[str | None, option(FILE, metavar="NOTES.csv")] = None
    as_given: Annotated[bool, option(SWITCH)] = False


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Rows(Choices):
    """Which rows of a throw are used.

    Attributes
    ----------
    since : Use only rows from this time on, in s.
    until : Use only rows up to this time, in s.
    exclude : Leave out the rows between the times A and B, in s. The motion continues
        through them under the same friction.
    """

    since: Annotated[float | None, option(TIME, metavar="S")] = None
    until: Annotated[float | None, option(TIME, metavar="S")] = None
    exclude: Annotated[Sequence[Sequence[float]], option(PERIODS, metavar="A:B")] = ()

    @property
    def rows(self) -> dict[str, Any]:
        """The choices of rows, as `Throw.select_rows` takes them."""
        return {"since": self.since, "until": self.until, "exclude": self.exclude}


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Estimation(Rows):
    """What of a throw is estimated, what is held, and how residuals count.

    Attributes
    ----------
    swept : The stone was swept between the times A and B, in s; the parameter `sweep`
        is the ratio of the friction during sweeping to that otherwise.
    fix : Hold a parameter at a value.
    bounds : Bounds of a parameter, in place of the default ones.
    unbounded : Allow negative coefficients.
    free : Estimate what is otherwise held: `slope_x`, `slope_y` (downward slope of the
        ice, m/m), `drag` (of the air), `R`, `rho`, `h` (of the stone), `length_scale`,
        `time_scale` (ratio of measured to true), or an optional coefficient of the law.
    priors : Prior of a parameter, which is then estimated: `rho=0.1+-0.0025`,
        `mu2_xi=lognormal:0.05,0.3` (median, sigma of the logarithm),
        `drag=half-normal:0.8`, `h=uniform:0.05,0.065`.
    start : Initial value; derived from the data if not given.
    sigma : Noise of a channel: x=0.005,y=0.005,phi=0.01 (m, m, rad); estimated
        if not given.
    loss : How much large residuals count: {losses}; all but the first are robust to
        outliers. [default: linear]
    stone : The stone: ring radius R, radius of gyration rho, height h of the centre of
        mass (m), mass m (kg).
    """

    swept: Annotated[tuple[float, float] | None, option(PERIOD, metavar="A:B")] = None
    fix: Annotated[Named, option(VALUES, metavar="NAME=V")] = field(
        default_factory=dict
    )
    bounds: Annotated[Named, option(LIMITS, metavar="NAME=LO:HI")] = field(
        default_factory=dict
    )
    unbounded: Annotated[bool, option(SWITCH)] = False
    free: Annotated[Sequence[str], option(NAMES, metavar="NAME,...")] = ()
    priors: Annotated[Named, option(PRIORS, metavar="NAME=PRIOR")] = field(
        default_factory=dict
    )
    start: Annotated[Named, option(VALUES, metavar="NAME=V")] = field(
        default_factory=dict
    )
    sigma: Annotated[Named, option(VALUES, metavar="NAME=V")] = field(
        default_factory=dict
    )
    loss: Annotated[Loss, option(LOSS, metavar="NAME")] = UNSET
    stone: Annotated[Named, option(VALUES, metavar="R=V,rho=V")] = field(
        default_factory=dict
    )

    usual: ClassVar = {"loss": "linear"}

    @property
    def of_parameters(self) -> dict[str, Any]:
        """The choices of parameters, as `ParameterSet.build` takes them."""
        return {**self.by_parameter, "unbounded": self.unbounded}

    @property
    def by_parameter(self) -> dict[str, Any]:
        """The choices that name parameters, except their initial values."""
        return {
            name: getattr(self, name) for name in ("fix", "bounds", "free", "priors")
        }

    def check(self) -> None:
        """Raise `InputError` for no stone, and for a robust loss with
        correlated noise."""
        Stone().with_values(dict(self.stone))
        chosen = getattr(self, "noise", ())
        for noise in [chosen] if isinstance(chosen, Noise) else chosen:
            if not noise.is_white and self.loss.is_robust:
                raise InputError(
                    f"noise {noise.kind} and loss {self.loss.name} cannot be combined: "
                    "a robust loss takes each value by itself"
                )


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Comparing(Estimation):
    """The same, under many laws.

    Attributes
    ----------
    laws : Laws to compare; FILE.py:CLASS for your own. [default: all]
    load : `uniform`, `consistent` (eq. 8-9) or `both`. [default: uniform]
    noise : Noise models, as in `curlfit fit`; with several, every law is fitted under
        each of them, and all fits are ranked together. [default: white]
    """

    laws: Annotated[Sequence[Any], option(LAWS, metavar="A,B,...")] = ()
    load: Annotated[Sequence[Load], option(LOADS, metavar="NAME")] = UNSET
    noise: Annotated[Sequence[Noise], option(SEVERAL_NOISES, metavar="A,B,...")] = ()

    usual: ClassVar = {**Estimation.usual, "load": "uniform", "noise": ("white",)}


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Modelling(Estimation):
    """The same, under one law.

    Attributes
    ----------
    law : Friction law; `curlfit laws` lists them; FILE.py:CLASS for one of your own.
        [default: front-back; for stopwatch times what they determine]
    load : Distribution of the load on the ring: `uniform`, or `consistent` with the
        friction (eq. 8-9). [default: uniform]
    noise : Correlation of the noise from row to row: {noises}. Estimated from the
        residuals. [default: white]
    """

    law: Annotated[Any, option(LAW, metavar="NAME")] = None
    load: Annotated[Load, option(LOAD, metavar="NAME")] = UNSET
    noise: Annotated[Noise, option(NOISE, metavar="|".join(NOISES))] = UNSET

    usual: ClassVar = {
        **Estimation.usual,
        "law": "front-back",
        "load": "uniform",
        "noise": "white",
    }


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Fitting(Modelling):
    """The same, with systematic errors and derived quantities.

    Attributes
    ----------
    systematics : Standard uncertainty of a condition that is held fixed, for the
        systematic errors: `slope_x=2e-4`; 0 if it is known exactly, `all=0` for no
        systematic errors, `calibration=0` for none of the map from pixels to metres.
        `curlfit laws --conditions` lists the defaults.
    derive : A quantity derived from the parameters, with its errors: `mu2_xi - mu1_xi`,
        `R*omega0/v0`, `sqrt(mu1_eta + mu2_eta)`; arithmetic of parameters, of R, rho,
        h, m, g, pi, and sqrt, exp, log, sin, cos, tan, atan, abs, hypot, min, max.
    """

    systematics: Annotated[Named, option(VALUES, metavar="NAME=V")] = field(
        default_factory=dict
    )
    derive: Annotated[Sequence[str], option(TEXTS, metavar="EXPRESSION")] = ()
