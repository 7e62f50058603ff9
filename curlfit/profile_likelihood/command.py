"""`curlfit profile`: profile likelihood of a parameter, or two."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from curlfit.errors import InputError
from curlfit.options import settings as s
from curlfit.options.output import COMPILES, Output, Saved
from curlfit.settings.choices import COUNT, Modelling, Reading
from curlfit.settings.forms import NAMES, Several, numbers, option

if TYPE_CHECKING:
    from curlfit.inference.fit.result import FitResult
    from curlfit.inference.model.request import Request

_RANGES = Several(numbers(2, "LOW,HIGH"), "pairs of numbers", "LOW,HIGH", commas=False)


def profile(
    data: Path,
    /,
    *,
    param: Annotated[Sequence[str], option(NAMES, "NAME")],
    points: Annotated[int | None, option(COUNT, "N")] = None,
    ranges: Annotated[
        Sequence[tuple[float, float]], option(_RANGES, "LO,HI", name="--range")
    ] = (),
    flags: Modelling = Modelling(),
    reading: Reading = Reading(),
    config: s.Config = None,
    output: Output = Output(),
) -> Saved:
    """Profile likelihood: a parameter is fixed at many values, all others are
    fitted at each.

    The increase of chi squared gives intervals that are valid where it is not
    quadratic, and shows what the path does not determine. The noise is that of the fit.
    The posterior of a saved fit is drawn too. Writes `profile.json` and `profile.png`.

    Examples:

    `curlfit profile throw.csv --param mu1_xi`

    `curlfit profile throw-fit --param mu1_eta --param mu2_eta`: two of a saved fit

    Parameters
    ----------
    data
        Data as for `curlfit fit`; or a saved fit: its folder, or the fit.json in it.
    param
        A fitted parameter: a coefficient, or one of x0 y0 heading v0 phi0 omega0. Given
        twice: two parameters jointly.
    points
        Values of each parameter. [default: 41; 25 of each of two]
    ranges
        Range; given twice, of the first and the second parameter. [default: 4 standard
        errors to either side; where there are none, up to the limits]
    """
    from curlfit.output.document import command_line
    from curlfit.output.files import claim_folder
    from curlfit.profile_likelihood.result import require_usable

    drawn = output.drawn()
    if len(ranges) > len(param):
        raise InputError(
            f"--range is given {len(ranges)} times; expected one of each --param"
        )
    range_by_name = dict(zip(param, ranges, strict=False))
    kind = f"profile-{'-'.join(param)}"
    saved = data.is_dir() or data.name == "fit.json"
    if saved:
        _refuse_choices(flags, reading, config)
        choices = flags
        fit, chain = s.load_fit_and_chain(data, flags.law)
        parameters = fit.parameter_set
        usual_folder = Path(f"{s.name_of(data)}-{kind}")
    else:
        job = s.prepare(data, config, reading, flags)
        choices = job.chosen
        request = job.request
        parameters = request.parameters
        usual_folder = s.result_folder(data, kind, reading)
    require_usable(parameters, param, points, range_by_name)
    drawn.draw_beside()
    with output.status(f"Fitting {COMPILES}"):
        if not saved:
            fit = _fit(request)
            chain = None
        best = parameters.values_of(fit.values)
        require_usable(parameters, param, points, range_by_name, best)
        folder = claim_folder(output.out or usual_folder)
        from curlfit.profile_likelihood.profile import profile as compute_profile

        result = compute_profile(
            fit, param, chain=chain, points=points, ranges=range_by_name
        )
    words = [f"--param={name}" for name in param]
    words += [f"--range={low:.10g},{high:.10g}" for low, high in ranges]
    if points:
        words.append(f"--points={points}")
    words += [*reading.words(), *choices.words()]
    result = replace(result, command=command_line("profile", str(data), *words))
    return output.finish(result, folder, drawn)


def _refuse_choices(flags: Modelling, reading: Reading, config: Path | None) -> None:
    """Raise `InputError` for a choice that a saved fit has made already; the law alone
    may be given, as the file of a law of one's own."""
    refused = [*replace(flags, law=None).words(), *reading.words()]
    if config:
        refused.append("--config")
    if refused:
        flag = refused[0].partition("=")[0]
        raise InputError(f"{flag}: a saved fit has its own; give the data to fit again")


def _fit(request: Request) -> FitResult:
    """Fit a throw, while the program of the profile is compiled beside it."""
    from curlfit.inference.fit.fit import fit_request
    from curlfit.inference.fit.throw_stack import first_problem
    from curlfit.inference.solve.least_squares import prepare_minimize
    from curlfit.numerics.batches import FEW

    prepare_minimize(*first_problem(request), FEW)
    return fit_request(request)
