"""`curlfit check` and `curlfit simulate`: inspect a data file, make a synthetic one."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from curlfit.options import flags as o
from curlfit.options import settings as s

if TYPE_CHECKING:
    from curlfit.environment import Environment
    from curlfit.errors import DataError
    from curlfit.friction import Law
    from curlfit.stone import Stone
    from curlfit.throws.throw import Throw

_START = "Start"
_CONDITIONS = "Conditions"


def check(
    data: Annotated[
        Path,
        typer.Argument(help="Data as for `curlfit fit`.", metavar="DATA", show_default=False),
    ],
    format: o.Format = None,
    axes: o.Axes = None,
    units: o.Units = None,
    reference: o.Reference = None,
    stone_index: o.StoneIndex = None,
    shot: o.Shot = None,
    handle: o.Handle = None,
    as_given: o.AsGiven = False,
    since: o.Since = None,
    until: o.Until = None,
    exclude: o.Exclude = None,
    config: o.Config = None,
    out: Annotated[
        Path | None, typer.Option(help="Draw the data to this file.", metavar="CHECK.png")
    ] = None,
) -> None:
    """Show how a data file is read: columns, units, scatter, rest, what is implausible.

    Exit status 0 if the file can be read and is plausible, 2 otherwise.

    Example: `curlfit check data/jensen_shegelski_2004.csv`
    """
    from curlfit.errors import InputError
    from curlfit.inference.parameters import FEWEST_ROWS
    from curlfit.throws.inspection import inspect_throw
    from curlfit.throws.plausibility import examine, require_plausible
    from curlfit.throws.readers import read
    from curlfit.throws.readers.assemble import assemble

    if out is not None:
        if out.suffix.lower() not in (".png", ".pdf", ".svg"):
            raise InputError(f"--out {out}: expected a name that ends in .png, .pdf or .svg")
        if not out.absolute().parent.is_dir():
            raise InputError(f"--out {out}: the folder {out.parent} does not exist")
    flags = o.reader_options(format, axes, units, reference, stone_index, shot, handle, as_given)
    configured = s.check_settings(s.read_config(config), str(config))
    options = s.reader_arguments(configured, flags)
    axes, points = options.pop("axes", None), options.pop("reference", None)
    as_given = options.pop("as_given", False)
    parsed = read(data, **options, pixels=points is not None)
    throw = assemble(parsed, axes=axes, reference=points and Path(points), as_given=as_given)
    flags |= {"since": since, "until": until}
    flags["exclude"] = s.periods("--exclude", exclude or ()) or None
    throw, settings, _ = s.apply_settings(throw, configured, flags)
    cut = throw.select_rows(**s.row_choices(settings))
    cut.require_motion()
    if out is not None and not throw.has_path:
        raise InputError(f"--out: {data} has timed events only, and no path to draw")
    shown = {key: value for key, value in settings.items() if key not in s.READER_OPTIONS}

    from curlfit.output.console import terminal
    from curlfit.throws.report import print_findings, print_inspection

    console = terminal(highlight=False)
    print_inspection(parsed, throw, inspect_throw(throw), shown, console)
    print_findings(examine(cut), console)
    refused = _refusal(cut, settings)
    if refused is not None:
        if len(cut) < FEWEST_ROWS:
            raise refused
        console.print(f"\nNo fit as set: {refused}", style="yellow", markup=False)
    if out is not None:
        from curlfit.output.figures import save_figure
        from curlfit.throws.figures import throw_figure

        save_figure(throw_figure(throw), out)
        console.print(f"Written: {out}", soft_wrap=True)
    require_plausible(cut)


def _refusal(throw: Throw, settings: dict[str, Any]) -> DataError | None:
    """Why a fit with these settings would refuse the throw for its number of rows."""
    from curlfit.errors import DataError
    from curlfit.friction import find_law
    from curlfit.inference.parameters import ParameterSet

    law = find_law(settings.get("law", "front-back"))
    try:
        ParameterSet.for_throw(law, throw, **s.for_parameter_set(s.parameter_choices(settings)))
    except DataError as error:
        return error
    return None


def simulate(
    fit: Annotated[
        Path | None,
        typer.Option(
            help="Saved fit that supplies law, load, stone, conditions and initial state unless "
            "given here.",
            metavar="DIR",
        ),
    ] = None,
    law: Annotated[
        str | None,
        typer.Option(help="Friction law; `curlfit laws` lists them. [default: front-back]"),
    ] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", help="A coefficient; the law's default if not set.", metavar="N=V"),
    ] = None,
    unbounded: o.Unbounded = False,
    load: Annotated[
        str | None, typer.Option(help="`uniform` or `consistent`. [default: uniform]")
    ] = None,
    stone: o.StoneValues = None,
    v0: Annotated[
        float | None, typer.Option(help="Speed, m/s. [default: 2]", rich_help_panel=_START)
    ] = None,
    omega0: Annotated[
        float | None,
        typer.Option(help="Spin, rad/s, counter-clockwise. [default: 1]", rich_help_panel=_START),
    ] = None,
    heading: Annotated[
        float | None,
        typer.Option(
            help="Direction, rad, from +y toward +x. [default: 0]", rich_help_panel=_START
        ),
    ] = None,
    x0: Annotated[
        float | None,
        typer.Option(help="Position to the right, m. [default: 0]", rich_help_panel=_START),
    ] = None,
    y0: Annotated[
        float | None,
        typer.Option(help="Position along, m. [default: 0]", rich_help_panel=_START),
    ] = None,
    phi0: Annotated[
        float | None, typer.Option(help="Angle, rad. [default: 0]", rich_help_panel=_START)
    ] = None,
    line: Annotated[
        str | None,
        typer.Option(
            "--line",
            help="Start on a line of the sheet: `hack`, `back`, `tee`, `hog` (the near ones), "
            "`centre` or `far-hog`; y is then measured from the hack.",
            metavar="NAME",
            rich_help_panel=_START,
        ),
    ] = None,
    slope_x: Annotated[
        float | None,
        typer.Option(
            help="Downward slope of the ice to the right, m/m.", rich_help_panel=_CONDITIONS
        ),
    ] = None,
    slope_y: Annotated[
        float | None,
        typer.Option(
            help="Downward slope of the ice along the throw, m/m.", rich_help_panel=_CONDITIONS
        ),
    ] = None,
    drag: Annotated[
        float | None,
        typer.Option(help="Drag coefficient in still air, about 0.8.", rich_help_panel=_CONDITIONS),
    ] = None,
    sweep: Annotated[
        str | None,
        typer.Option(
            help="The stone is swept from A to B (s); V is the ratio of the friction then to that "
            "otherwise.",
            metavar="A:B=V",
            rich_help_panel=_CONDITIONS,
        ),
    ] = None,
    until: Annotated[
        float | None,
        typer.Option(help="Last time, s. [default: 20; of a fit, as long as its record]"),
    ] = None,
    dt: Annotated[float, typer.Option(help="Time between rows, s.")] = 0.1,
    noise_xy: Annotated[float, typer.Option(help="Standard deviation on x and y, m.")] = 0.0,
    noise_phi: Annotated[float, typer.Option(help="Standard deviation on phi, rad.")] = 0.0,
    seed: Annotated[int, typer.Option(help="Seed of the noise.", min=0)] = 0,
    out: Annotated[Path | None, typer.Option(help="File to write. [default: print]")] = None,
) -> None:
    """Simulate a throw under a friction law, in the format that `curlfit fit` reads.

    Examples:

    `curlfit simulate --set mu2_xi=0.06 --noise-xy 0.005 --noise-phi 0.01 --out a.csv`

    `curlfit simulate --line hog --v0 2.3 --slope-x 2e-4 --drag 0.8 --sweep 8:14=0.9 --out b.csv`

    `curlfit simulate --fit a-fit --omega0=-1.2 --until 30 --out c.csv`: another throw of a fit
    """
    from dataclasses import replace

    from curlfit.environment import Environment
    from curlfit.errors import InputError, warn_once
    from curlfit.throws.synthetic import SIMULATED, synthetic_throw, write_table

    start = {
        name: value
        for name, value in {
            "x0": x0, "y0": y0, "heading": heading, "v0": v0, "phi0": phi0, "omega0": omega0,
        }.items()
        if value is not None
    }  # fmt: skip
    if line is not None:
        if y0 is not None:
            raise InputError("--line and --y0: expected one of them")
        start["y0"] = _line(line)
    ice: dict[str, Any] = {
        name: value
        for name, value in {"slope_x": slope_x, "slope_y": slope_y, "drag": drag}.items()
        if value is not None
    }
    if sweep is not None:
        ice |= _sweeping(sweep)
    given = _Given(law, s.pairs("--set", set_ or ()), unbounded, s.pairs("--stone", stone or ()))
    model = _given_model(given) if fit is None else _fitted_model(fit, given)
    throw = synthetic_throw(
        model.law,
        model.stone,
        load=load or model.load,
        environment=replace(model.environment, **ice) if ice or model.environment != Environment()
        else None,
        until=model.duration if until is None else until,
        dt=dt, noise_xy=noise_xy, noise_phi=noise_phi, seed=seed,
        **(model.start | start),
    )  # fmt: skip
    if line is not None:
        throw = throw.with_defaults(axes="from-hack")
    for note in throw.notes:
        warn_once(note)
    text = write_table(throw)
    if out is None:
        typer.echo(text, nl=False)
        return
    from curlfit.output.files import atomic_write, require_replaceable

    if not out.parent.is_dir():
        raise InputError(f"{out}: the folder {out.parent} does not exist")
    require_replaceable(out, "a simulated throw", SIMULATED)
    with atomic_write(out) as temporary:
        temporary.write_text(text)
    typer.echo(f"Written: {out}")


class _Given(NamedTuple):
    """Flags that set the model of a simulation."""

    law: str | None
    coefficients: dict[str, float]
    unbounded: bool
    stone: dict[str, float]


class _Simulated(NamedTuple):
    """What is simulated unless flags say otherwise."""

    law: Law
    stone: Stone
    load: str
    environment: Environment
    start: dict[str, float]
    duration: float


def _given_model(given: _Given) -> _Simulated:
    from curlfit.environment import Environment
    from curlfit.stone import Stone
    from curlfit.throws.synthetic import law_with

    law = law_with(given.law or "front-back", given.coefficients, unbounded=given.unbounded)
    return _Simulated(
        law, Stone().with_values(given.stone), "uniform", Environment(), {"v0": 2.0, "omega0": 1.0},
        20.0,
    )  # fmt: skip


def _fitted_model(folder: Path, given: _Given) -> _Simulated:
    """Law, stone, conditions and initial state of a saved fit, except for what is given."""
    from dataclasses import replace

    from curlfit.environment import Environment
    from curlfit.errors import UnusableFitError
    from curlfit.friction import find_law
    from curlfit.inference.parameters import START
    from curlfit.inference.system import System
    from curlfit.throws.synthetic import law_with

    fit, _ = s.load_fit_and_chain(folder)
    wanted = None if given.law is None else find_law(given.law)
    if not fit.converged:
        raise UnusableFitError(f"{folder}: nothing can be simulated from this fit: {fit.status}")
    system = System.of(fit.model, [float(value) for value in fit.values], fit.stone, Environment())
    environment, swept = system.environment, fit.data["swept"]
    begin = fit.data["from"]
    if swept is not None:
        environment = replace(environment, swept_from=swept[0] - begin, swept_to=swept[1] - begin)
    if wanted is None or wanted.name == fit.law:
        own = {name: item.value for name, item in fit.coefficients.items()}
        law = fit.fitted_law
        if given.coefficients:
            law = law_with(fit.law_class, given.coefficients, unbounded=given.unbounded, others=own)
    else:
        law = law_with(wanted, given.coefficients, unbounded=given.unbounded)
    return _Simulated(
        law, system.stone.with_values(given.stone), fit.load, environment,
        {item.name: fit.parameters[item.name].value for item in START},
        fit.data["to"] - begin,
    )  # fmt: skip


def _line(name: str) -> float:
    """y of a line, m from the hack."""
    from curlfit.errors import InputError
    from curlfit.sheet import LINES

    names = list(LINES)[:-1]
    if name not in names:
        raise InputError(f"--line {name}: expected one of {', '.join(names)}")
    return LINES[name]


def _sweeping(text: str) -> dict[str, float]:
    """`A:B=V` as conditions."""
    from curlfit.errors import InputError

    period, equals, factor = text.partition("=")
    if not equals:
        raise InputError(f"--sweep {text}: expected A:B=V, times in s and the ratio of friction")
    pairs = s.swept_choice(period)
    value = s.number("--sweep", period, factor)
    if value < 0 or pairs is None:
        raise InputError(f"--sweep {text}: expected a ratio of friction of 0 or more")
    return {"sweep": value, "swept_from": pairs[0], "swept_to": pairs[1]}
