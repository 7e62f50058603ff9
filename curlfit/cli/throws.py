"""`curlfit check` and `curlfit simulate`: inspect a data file, make a synthetic one."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from cyclopts import Group, Parameter

from curlfit.errors import CurlfitError, InputError
from curlfit.foreign import say
from curlfit.options import settings as s
from curlfit.settings.choices import SEED, Choices, Modelling, Reading, Rows
from curlfit.settings.forms import (
    NUMBER,
    PATH,
    PERIOD,
    SWITCH,
    TIME,
    Form,
    OneOf,
    option,
)
from curlfit.sheet import LINES

if TYPE_CHECKING:
    from collections.abc import Sequence

    from curlfit.environment import Environment
    from curlfit.friction import Law
    from curlfit.stone import Stone
    from curlfit.throws.load import Part
    from curlfit.throws.throw import Throw


def check(
    data: Path,
    /,
    *,
    reading: Reading = Reading(),
    rows: Rows = Rows(),
    config: s.Config = None,
    out: Annotated[Path | None, option(PATH, "CHECK.png")] = None,
) -> None:
    """Show how a data file is read: columns, units, scatter, rest, what is implausible.

    Exit status 0 if the file can be read and is plausible, 2 otherwise. Of a table of
    stopwatch times each row is read, or the one that `--shot` selects; a table of
    friction against speed is shown too.

    Example: `curlfit check data/jensen_shegelski_2004.csv`

    Parameters
    ----------
    data
        Data as for `curlfit fit`.
    out
        Draw the data to this file.
    """
    from curlfit.errors import DataError
    from curlfit.inference.model.parameters import FEWEST_ROWS
    from curlfit.output.console import terminal
    from curlfit.throws.friction_table import is_friction_table
    from curlfit.throws.load import read, rows_of_table, throw_of
    from curlfit.throws.plausibility import examine, require_motion
    from curlfit.throws.report import print_findings, print_inspection

    if out is not None:
        _require_picture(out)
    configured = s.read_config(config)
    reading = Reading.of(configured, vars(reading))
    if is_friction_table(data, reading.worksheet, reading.columns):
        _check_friction(data, reading)
        return
    parts = rows_of_table(data, reading)
    if parts:
        _check_rows(parts, data, out)
        return
    parsed = read(data, reading)
    job = s.apply_settings(
        throw_of(parsed, reading), configured, Modelling(**vars(rows))
    )
    require_motion(job.rows)
    if out is not None and not job.throw.has_path:
        raise InputError(f"--out: {data} has timed events only, and no path to draw")
    console = terminal(highlight=False)
    settings = {**job.throw.defaults, **configured, **rows.given()}
    print_inspection(parsed, job.throw, settings, console)
    print_findings(examine(job.rows), console)
    if out is not None:
        from curlfit.output.figures import save_figure
        from curlfit.throws.figures import throw_figure

        save_figure(throw_figure(job.throw), out)
        console.print(f"Written: {out}", soft_wrap=True)
    try:
        _ = job.request
    except DataError as refusal:
        if len(job.rows) < FEWEST_ROWS:
            raise
        # the file can be read, though no fit is possible with these settings
        console.print(f"\nNo fit as set: {refusal}", style="yellow")


def _check_friction(data: Path, reading: Reading) -> None:
    """Show a table of friction against speed. Raises `DataError` where it cannot be
    read."""
    from curlfit.output.console import terminal
    from curlfit.throws.friction_table import load_friction_table
    from curlfit.throws.report import print_friction

    table = load_friction_table(data, reading.worksheet, reading.columns, reading.units)
    print_friction(table, terminal(highlight=False))


def _check_rows(parts: Sequence[Part], data: Path, out: Path | None) -> None:
    """Show the throws in the rows of a stopwatch table.

    Raises
    ------
    DataError : of the first row that cannot be read.
    """
    from curlfit.output.console import terminal
    from curlfit.throws.report import print_rows

    if out is not None:
        raise InputError(f"--out: {data} has timed events only, and no path to draw")
    faults = [
        part.throw
        for part in parts
        if isinstance(part.throw, CurlfitError) and not part.left_out
    ]
    readable = [part for part in parts if not isinstance(part.throw, CurlfitError)]
    if readable:
        print_rows(readable, data, terminal(highlight=False))
    if faults:
        raise faults[0]
    # every throw needs others, which the table does not have
    if all(part.alone for part in parts) and parts[0].alone is not None:
        raise parts[0].alone


def _require_picture(file: Path) -> None:
    """Raise `InputError` for a file that cannot become a picture."""
    if file.suffix.lower() not in (".png", ".pdf", ".svg"):
        raise InputError(
            f"--out {file}: expected a name that ends in .png, .pdf or .svg"
        )
    if not file.absolute().parent.is_dir():
        raise InputError(f"--out {file}: the folder {file.parent} does not exist")


class Sweep(NamedTuple):
    """Sweeping from one time to another (s), and the ratio of the friction then to that
    otherwise."""

    begin: float
    end: float
    ratio: float


def _read_sweep(word: str) -> Sweep:
    """Sweeping as it is typed, such as "8:14=0.9"."""
    times, _, number = word.partition("=")
    begin, end = PERIOD.read_word("--sweep ", times)
    ratio = float(number)
    if ratio < 0:
        raise ValueError
    return Sweep(begin, end, ratio)


_LINE = OneOf("line", {name: name for name in list(LINES)[:-1]})
_SWEPT = Form(
    "",
    lambda value: value,
    _read_sweep,
    "A:B=V, times in s and the ratio of friction, of 0 or more",
)


@Parameter(name="*", group=Group("Conditions", sort_key=1))
@dataclass(frozen=True, kw_only=True)
class Conditions(Choices):
    """The ice and the air of a simulated throw.

    Attributes
    ----------
    slope_x : Downward slope of the ice to the right, m/m.
    slope_y : Downward slope of the ice along the throw, m/m.
    drag : Drag coefficient in still air, about 0.8.
    sweep : The stone is swept from A to B (s); V is the ratio of the friction then to
        that otherwise.
    """

    slope_x: Annotated[float | None, option(NUMBER, "V")] = None
    slope_y: Annotated[float | None, option(NUMBER, "V")] = None
    drag: Annotated[float | None, option(NUMBER, "V")] = None
    sweep: Annotated[Any, option(_SWEPT, "A:B=V")] = None

    def environment(self, otherwise: Environment) -> Environment:
        """The conditions that are given; `otherwise` has those that are not."""
        conditions = self.given()
        if self.sweep is not None:
            conditions |= {
                "sweep": self.sweep.ratio,
                "swept_from": self.sweep.begin,
                "swept_to": self.sweep.end,
            }
        return replace(otherwise, **conditions)


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Simulated(s.LawValues):
    """The model of a simulated throw.

    Attributes
    ----------
    unbounded : Allow negative coefficients.
    """

    unbounded: Annotated[bool, option(SWITCH)] = False


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Measured(Choices):
    """How a simulated throw is measured.

    Attributes
    ----------
    until : Last time, s. [default: 20; of a fit, as long as its record]
    dt : Time between rows, s. [default: 0.1]
    noise_xy : Standard deviation on x and y, m. [default: 0]
    noise_phi : Standard deviation on phi, rad. [default: 0]
    seed : Seed of the noise. [default: 0]
    """

    until: Annotated[float | None, option(TIME, "S")] = None
    dt: Annotated[float | None, option(NUMBER, "S")] = None
    noise_xy: Annotated[float | None, option(NUMBER, "V")] = None
    noise_phi: Annotated[float | None, option(NUMBER, "V")] = None
    seed: Annotated[int | None, option(SEED, "N")] = None


def simulate(
    *,
    fit: Annotated[Path | None, option(PATH, "FIT")] = None,
    given: Simulated = Simulated(),
    start: s.Start = s.Start(),
    line: Annotated[str | None, option(_LINE, "NAME", group="Start")] = None,
    conditions: Conditions = Conditions(),
    measured: Measured = Measured(),
    out: Annotated[Path | None, option(PATH, "FILE.csv")] = None,
) -> None:
    """Simulate a throw under a friction law, in the format that `curlfit fit` reads.

    Examples:

    `curlfit simulate --set mu2_xi=0.06 --noise-xy 0.005 --noise-phi 0.01 --out a.csv`

    `curlfit simulate --line hog --v0 2.3 --slope-x 2e-4 --drag 0.8 --sweep 8:14=0.9
    --out b.csv`

    `curlfit simulate --fit a-fit --omega0 -1.2 --until 30 --out c.csv`: another
    throw of a fit

    Parameters
    ----------
    fit
        Saved fit that supplies law, load, stone, conditions and initial state
        unless given here.
    line
        Start on a line of the sheet: `hack`, `back`, `tee`, `hog` (the near ones),
        `centre` or `far-hog`; y is then measured from the hack.
    out
        File to write. [default: print]
    """
    from curlfit.environment import Environment
    from curlfit.throws.synthetic import synthetic_throw

    given_start = start.given()
    if line is not None:
        if start.y0 is not None:
            raise InputError("--line and --y0: expected one of them")
        given_start["y0"] = LINES[line]
    model = _given_model(given) if fit is None else _fitted_model(fit, given)
    environment = conditions.environment(model.environment)
    throw = synthetic_throw(
        model.law,
        model.stone,
        load=model.load,
        environment=None if environment == Environment() else environment,
        **{**model.start, **given_start},
        **{"until": model.until, **measured.given()},
    )
    if line is not None:
        throw = throw.with_defaults(axes="from-hack")
    _write(throw, out)


def _write(throw: Throw, out: Path | None) -> None:
    """Write a simulated throw, or print it."""
    from curlfit.output.files import atomic_write, require_replaceable
    from curlfit.throws.synthetic import SIMULATED, write_table

    text = write_table(throw)
    if out is None:
        print(text, end="")
        return
    if not out.parent.is_dir():
        raise InputError(f"{out}: the folder {out.parent} does not exist")
    require_replaceable(out, "a simulated throw", SIMULATED)
    atomic_write(out, text)
    say(f"Written: {out}")


@dataclass(frozen=True, kw_only=True)
class _Model:
    """What moves a simulated throw, before flags say more.

    Attributes
    ----------
    start : values of the initial state by name (SI, rad).
    until : last time, s since the start.
    """

    law: Law
    stone: Stone
    load: str
    environment: Environment
    start: dict[str, float]
    until: float


def _given_model(given: Simulated) -> _Model:
    """The model that flags give, with defaults for what they leave out."""
    from curlfit.environment import Environment
    from curlfit.stone import Stone
    from curlfit.throws.synthetic import law_with

    law = law_with(
        given.law or "front-back", given.coefficients, unbounded=given.unbounded
    )
    return _Model(
        law=law,
        stone=Stone().with_values(dict(given.stone)),
        load=given.load or "uniform",
        environment=Environment(),
        start={"v0": 2.0, "omega0": 1.0},
        until=20.0,
    )


def _fitted_model(folder: Path, given: Simulated) -> _Model:
    """The model of a saved fit, except for what flags give."""
    from curlfit.environment import Environment
    from curlfit.errors import UnusableFitError
    from curlfit.friction import find_law
    from curlfit.inference.model.system import System
    from curlfit.throws.synthetic import law_with

    fit, _ = s.load_fit_and_chain(folder)
    law_class = None if given.law is None else find_law(given.law)
    if not fit.converged:
        raise UnusableFitError(
            f"{folder}: nothing can be simulated from this fit: {fit.status}"
        )
    system = System.of(
        fit.model, [float(value) for value in fit.values], fit.stone, Environment()
    )
    # times of the simulated throw begin at the first row
    begin = fit.data.begin
    environment = system.environment
    if fit.data.swept is not None:
        swept_from, swept_to = fit.data.swept
        environment = replace(
            environment, swept_from=swept_from - begin, swept_to=swept_to - begin
        )
    # without coefficients of its own, another law has its default ones
    fitted: dict[str, float] = {}
    if law_class is None or law_class.name == fit.law:
        law_class = fit.law_class
        fitted = {
            name: coefficient.value for name, coefficient in fit.coefficients.items()
        }
    law: Law  # a subclass in either case
    if fitted and not given.coefficients:
        law = fit.fitted_law
    else:
        law = law_with(
            law_class, given.coefficients, unbounded=given.unbounded, others=fitted
        )
    return _Model(
        law=law,
        stone=system.stone.with_values(dict(given.stone)),
        load=given.load or fit.load,
        environment=environment,
        start=fit.start,
        until=fit.data.end - begin,
    )
