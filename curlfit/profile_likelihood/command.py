"""`curlfit profile`: profile likelihood of a parameter, or two."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from curlfit.errors import InputError
from curlfit.options import settings as s
from curlfit.options.output import COMPILES, Output, Saved
from curlfit.settings.choices import COUNT, Modelling, Reading
from curlfit.settings.forms import NAMES, Several, numbers, option

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
    limits, kind = dict(zip(param, ranges, strict=False)), f"profile-{'-'.join(param)}"
    fitted, parameters, chosen, usual = _known(data, kind, flags, reading, config)
    require_usable(parameters, param, points, limits)
    drawn.draw_beside()
    with output.status(f"Fitting {COMPILES}"):
        fit, chain = fitted()
        require_usable(
            parameters, param, points, limits, parameters.values_of(fit.values)
        )
        folder = claim_folder(output.out or usual)
        from curlfit.profile_likelihood.profile import profile as compute_profile

        found = compute_profile(fit, param, chain=chain, points=points, ranges=limits)
    words = [f"--param={name}" for name in param]
    words += [f"--range={low:.10g},{high:.10g}" for low, high in ranges]
    if points:
        words.append(f"--points={points}")
    words += [*reading.words(), *chosen.words()]
    found = replace(found, command=command_line("profile", str(data), *words))
    return output.finish(found, folder, drawn)


def _known(
    data: Path, kind: str, flags: Modelling, reading: Reading, config: Path | None
) -> tuple[Callable[[], Any], Any, Modelling, Path]:
    """What gives the fit and its chain, if it is saved or when it is made; its
    parameters and choices, and the usual folder."""
    if data.is_dir() or data.name == "fit.json":
        own = (
            *replace(flags, law=None).words(),
            *reading.words(),
            *(["--config"] if config else []),
        )
        if own:
            option_of = own[0].partition("=")[0]
            raise InputError(
                f"{option_of}: a saved fit has its own; give the data to fit again"
            )
        saved = s.load_fit_and_chain(data, flags.law)
        folder = Path(f"{s.name_of(data)}-{kind}")
        return lambda: saved, saved[0].parameter_set, flags, folder
    request = s.checked(s.prepare(data, config, reading, flags))

    def fitted() -> Any:
        from curlfit.inference.least_squares import prepare_minimize
        from curlfit.numerics.batches import FEW

        prepare_minimize(*request.problem(), FEW)
        return request.fit(), None

    folder = s.result_folder(data, kind, reading)
    return fitted, request.parameters, request.chosen, folder
