"""`curlfit profile`: profile likelihood of a parameter, or two."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from curlfit.options import flags as o
from curlfit.options import settings as s
from curlfit.options.figures import FigureFiles

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from curlfit.inference.fit.result import FitResult
    from curlfit.inference.mcmc.chain import Chain
    from curlfit.profile_likelihood.result import PairProfile, Profile


def profile(
    data: Annotated[
        Path,
        typer.Argument(
            help="Data as for `curlfit fit`; or a saved fit: its folder, or the fit.json in it.",
            metavar="DATA|FIT",
            show_default=False,
        ),
    ],
    param: Annotated[
        list[str],
        typer.Option(
            help="A fitted parameter: a coefficient, or one of x0 y0 heading v0 phi0 omega0. Given "
            "twice: two parameters jointly.",
            metavar="NAME",
            show_default=False,
        ),
    ],
    points: Annotated[
        int | None,
        typer.Option(
            help="Values of each parameter. [default: 41; 25 of each of two]", metavar="N"
        ),
    ] = None,
    span: Annotated[
        list[str] | None,
        typer.Option(
            "--range",
            help="Range; given twice, of the first and the second parameter. [default: 4 standard "
            "errors to either side; where there are none, up to the limits]",
            metavar="LO,HI",
        ),
    ] = None,
    law: o.Law = None,
    load: o.LoadName = None,
    since: o.Since = None,
    until: o.Until = None,
    exclude: o.Exclude = None,
    sweep: o.Swept = None,
    fix: o.Fix = None,
    bound: o.Bound = None,
    unbounded: o.Unbounded = False,
    free: o.Free = None,
    prior: o.PriorText = None,
    start: o.Start = None,
    sigma: o.Sigma = None,
    loss: o.Loss = None,
    noise: o.NoiseModel = None,
    stone: o.StoneValues = None,
    format: o.Format = None,
    axes: o.Axes = None,
    units: o.Units = None,
    reference: o.Reference = None,
    stone_index: o.StoneIndex = None,
    shot: o.Shot = None,
    handle: o.Handle = None,
    as_given: o.AsGiven = False,
    config: o.Config = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for the results. [default: DATA's name with -profile-NAME]"),
    ] = None,
    figures: o.FigureFormats = None,
    no_figures: o.NoFigures = False,
    report: o.Report = False,
    quiet: o.Quiet = False,
) -> o.Saved | None:
    """Profile likelihood: a parameter is fixed at many values, all others are fitted at each.

    The increase of chi squared gives intervals that are valid where it is not quadratic, and shows
    what the path does not determine. The noise is that of the fit. The posterior of a saved fit is
    drawn too. Writes `profile.json` and `profile.png`.

    Examples:

    `curlfit profile throw.csv --param mu1_xi`

    `curlfit profile throw-fit --param mu1_eta --param mu2_eta`: two of a saved fit
    """
    from curlfit.errors import InputError
    from curlfit.output.files import prepare_folder

    drawn = FigureFiles.of(figures, none=no_figures)
    flags = s.fit_flags(
        o.reader_options(format, axes, units, reference, stone_index, shot, handle, as_given),
        law=law, load=load, since=since, until=until, exclude=exclude, swept=sweep,
        stone=stone, sigma=sigma, fix=fix, bound=bound, start=start, unbounded=unbounded,
        free=free, prior=prior, loss=loss, noise=noise,
    )  # fmt: skip
    if len(span or ()) > len(param):
        raise InputError(f"--range is given {len(span or ())} times; expected one of each --param")
    ranges = {name: _range(text) for name, text in zip(param, span or (), strict=False)}
    saved = data.is_dir() or data.name == "fit.json"
    make_fit: Callable[[], tuple[FitResult, Chain | None]]
    if saved:
        given = [name for name, value in {**flags, "config": config, "law": None}.items() if value]
        if given:
            option = given[0].replace("_", "-")
            raise InputError(f"--{option}: a saved fit has its own; give the data to fit again")
        result, chain = s.load_fit_and_chain(data, law)
        parameters = result.parameter_set
        make_fit = lambda: (result, chain)  # noqa: E731
    else:
        request = s.request_fit(data, config, flags)
        parameters = request.parameters

        def make_fit() -> tuple[FitResult, Chain | None]:
            from curlfit.inference.least_squares import prepare_minimize_few

            prepare_minimize_few(*request.problem())
            return request.fit(), None

    from curlfit.profile_likelihood.result import require_usable

    require_usable(parameters, param, points, ranges)
    kind = f"profile-{'-'.join(param)}"
    drawn.draw_beside()

    with _progress(quiet) as progress:
        fit, chain = make_fit()
        require_usable(parameters, param, points, ranges, parameters.values_of(fit.values))
        folder = prepare_folder(
            out
            or (
                Path(f"{s.name_of(data)}-{kind}")
                if saved
                else s.result_folder(data, kind, shot, stone_index)
            )
        )

        from curlfit.profile_likelihood.profile import profile as compute_profile

        found = compute_profile(
            fit, param, chain=chain, points=points, ranges=ranges, progress=progress
        )
    written = [folder / "profile.json"]
    found.save(written[0])
    drawn.replace(folder, ["profile"], partial(_figures, found))

    from curlfit.output.console import terminal
    from curlfit.profile_likelihood.report import print_profile

    console = terminal(quiet=quiet)
    print_profile(found, console)
    written += drawn.written()
    console.print("Written: " + ", ".join(map(str, written)), soft_wrap=True)
    return o.saved(folder, report=report, quiet=quiet)


def _range(text: str) -> tuple[float, float]:
    from curlfit.errors import InputError

    parts = text.split(",")
    if len(parts) != 2:
        raise InputError(f"--range {text}: expected LOW,HIGH")
    low, high = (
        s.number("--range", end, part) for end, part in zip(("low", "high"), parts, strict=True)
    )
    return low, high


@contextmanager
def _progress(quiet: bool) -> Iterator[Callable[[int], None]]:
    """A status line on a terminal: the number of fits done."""
    from rich.console import Console

    console = Console(stderr=True, quiet=quiet)
    if not console.is_terminal or quiet:
        yield lambda done: None
        return
    with console.status("Fitting (a first run on a machine compiles the model)") as status:
        yield lambda done: status.update(f"Fitting the other parameters again: {done} fits")


def _figures(found: Profile | PairProfile) -> dict[str, Figure]:
    from curlfit.profile_likelihood.figures import profile_figure

    return {"profile": profile_figure(found)}
