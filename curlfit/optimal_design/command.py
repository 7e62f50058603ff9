"""`curlfit design`: the expected errors of planned throws."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Group, Parameter

from curlfit.errors import InputError
from curlfit.foreign import is_size
from curlfit.options import settings as s
from curlfit.options.output import COMPILES, Output, Saved
from curlfit.settings.choices import COUNT, LAWS, Choices
from curlfit.settings.forms import NAMES, NUMBER, NUMBERS, PATH, TIME, Form, option

_SIZE = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")


def _quantity(name: str) -> Form:
    """A number in SI or followed by its unit, such as `5mm`; NaN for `none`."""

    def parse(word: str) -> float:
        if word.lower() == "none":
            return math.nan
        size = _SIZE.match(word)
        if size is None:
            raise ValueError
        from curlfit.throws.readers.columns import in_unit

        unit = word[size.end() :].strip()
        value = float(size[0]) * (in_unit(name, unit).factor if unit else 1.0)
        if not is_size(value):
            raise ValueError
        return value

    return Form(
        "a number in SI",
        lambda value: value,
        parse,
        "a number, followed by its unit unless in SI",
        lambda value: "none" if math.isnan(value) else f"{value:.10g}",
    )


@Parameter(name="*", group=Group("Assumed values", sort_key=0))
@dataclass(frozen=True, kw_only=True)
class Assumed(s.LawValues):
    """The law and the stone that a design assumes.

    Attributes
    ----------
    fit : A saved fit, for its law, coefficients, load and stone.
    """

    fit: Annotated[Path | None, option(PATH, "FIT")] = None


@Parameter(name="*", group=Group("The throws", sort_key=1))
@dataclass(frozen=True, kw_only=True)
class Grid(Choices):
    """The candidates.

    Attributes
    ----------
    v0 : Speeds, m/s. [default: 1.6,1.9,2.2]
    omega0 : Spins, rad/s, counter-clockwise positive. [default: 0.5,1,2,5,10, from a
        draw to a hard spinner]
    rate : Rows per second, Hz. [default: 30]
    """

    v0: Annotated[Sequence[float], option(NUMBERS, "V,V")] = ()
    omega0: Annotated[Sequence[float], option(NUMBERS, "V,V")] = ()
    rate: Annotated[float | None, option(NUMBER, "V")] = None


@Parameter(name="*", group=Group("The record", sort_key=2))
@dataclass(frozen=True, kw_only=True)
class Record(Choices):
    """What is measured of each throw.

    Attributes
    ----------
    until : Length of the record, s. [default: until the stone is at rest]
    sigma_xy : Noise of x, y: 0.005, 5mm, 0.2in. `none`: not measured. [default: 5mm]
    sigma_phi : Noise of the angle: 0.01, 10mrad, 0.5deg. `none`: not measured.
        [default: 10mrad]
    sigma_speed : Noise of a directly measured speed. [default: not measured]
    sigma_omega : Noise of a directly measured spin. [default: not measured]
    discrepancy : Size of the accelerations that the law may lack, over the friction,
        such as 0.05. [default: 0, an exact law]
    """

    until: Annotated[float | None, option(TIME, "S")] = None
    sigma_xy: Annotated[float | None, option(_quantity("x"), "V")] = 0.005
    sigma_phi: Annotated[float | None, option(_quantity("phi"), "V")] = 0.01
    sigma_speed: Annotated[float | None, option(_quantity("speed"), "V")] = None
    sigma_omega: Annotated[float | None, option(_quantity("omega"), "V")] = None
    discrepancy: Annotated[float, option(NUMBER, "V")] = 0.0

    def sigma(self) -> dict[str, float]:
        """Noise of each channel that is measured."""
        by_channel = {
            "x": self.sigma_xy,
            "y": self.sigma_xy,
            "phi": self.sigma_phi,
            "speed": self.sigma_speed,
            "omega": self.sigma_omega,
        }
        return {
            name: value
            for name, value in by_channel.items()
            if value is not None and not math.isnan(value)
        }


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Separated(Choices):
    """Two coefficients to be separated.

    Attributes
    ----------
    separate : Two coefficients, of whose difference the throws have the least standard
        error. [default: two of which only the sum is determined under uniform load]
    """

    separate: Annotated[Sequence[str], option(NAMES, "A,B")] = ()


def design(
    *,
    assumed: Assumed = Assumed(),
    grid: Grid = Grid(),
    throws: Annotated[int | None, option(COUNT, "N", group="The throws")] = None,
    record: Record = Record(),
    between: Annotated[Sequence[Any], option(LAWS, "A,B,...")] = (),
    pair: Separated = Separated(),
    output: Output = Output(),
) -> Saved:
    """Optimal design: the expected errors of a law's coefficients, and the best
    choice of throws.

    Every combination of speed and spin is a candidate. Each throw has its own unknown
    initial state; the coefficients are common to all. Errors are those of least squares
    (from the exact derivatives of the trajectory), for noise that is independent from
    row to row. Where only the sum of two coefficients is determined, the report gives
    the throws with the least error of their difference, under each load. With
    `--between`, the throws that decide between laws: how many, and which. The first law
    has the coefficients of `--set` or `--fit`, the others those that fit an ordinary
    draw of it. Writes `design.json`, `design-map.png` and `design-errors.png`; with
    `--between`, `discrimination.json` and `discrimination.png`.

    Examples:

    `curlfit design`: the front-back law, a camera over the ice, throws from draws to
    hard spinners

    `curlfit design --rate 60 --sigma-xy 2mm --sigma-phi 0.2deg --v0
    2.0,2.2 --omega0 -1.5,1.5`

    `curlfit design --load consistent --separate mu1_eta,mu2_eta --stone h=0.1`

    `curlfit design --fit throw-fit --until 12`: for the ice of a fitted throw

    `curlfit design --between front-back,pivot,sideways`: which throws decide
    between three laws

    Parameters
    ----------
    throws
        Number of throws, chosen among the candidates, with repetition. [default: 3;
        with `--between`, the least that decides at odds of 100 to 1]
    between
        Laws to decide between. A mechanism that does not brake, such as `pivot`,
        stands for its sum with the power law, `power+pivot`. The candidates have both
        senses of spin.
    """
    from curlfit.output.document import command_line
    from curlfit.output.files import claim_folder

    drawn = output.drawn()
    if between:
        of_one_law = {
            "separate": pair.separate,
            "law": assumed.law,
            "discrepancy": record.discrepancy,
        }
        for name, value in of_one_law.items():
            if value:
                raise InputError(f"--{name} is not an option with --between")
    else:
        throws = throws or 3
    law, options = _assumed(assumed, between[0] if between else assumed.law)
    drawn.draw_beside()
    options |= {
        "until": record.until,
        "sigma": record.sigma(),
        "throws": throws,
        **grid.given(),
    }
    words = [*assumed.words(), *grid.words(), *record.words()]
    if throws is not None:
        words.append(f"--throws={throws}")
    if between:
        words.append(f"--between={','.join(LAWS.words(between))}")
    else:
        words += pair.words()
        options |= {"discrepancy": record.discrepancy, **pair.given()}
    result = _computed(law, between, options, output)
    result = replace(result, command=command_line("design", *words))
    return output.finish(result, claim_folder(output.out or Path("design")), drawn)


def _assumed(assumed: Assumed, law: Any) -> tuple[Any, dict[str, Any]]:
    """The law, or the saved fit that is given; coefficients, load and stone."""
    from curlfit.inference.fit.result import load_fit
    from curlfit.stone import Stone

    stone = Stone()
    if assumed.fit is not None:
        kind = s.kind_of(assumed.fit)
        if kind != "fit":
            raise InputError(
                f"{assumed.fit}: a result of curlfit {kind}; expected the "
                "fit of one throw"
            )
        law = load_fit(assumed.fit).with_law(law)
        stone = law.stone
    return law, {
        "coefficients": dict(assumed.coefficients),
        "load": assumed.load,
        "stone": stone.with_values(dict(assumed.stone)),
    }


def _computed(
    law: Any, between: Sequence[Any], options: dict[str, Any], output: Output
) -> Any:
    if between:
        with output.status(f"Fitting each law to the throws of the others {COMPILES}"):
            from curlfit.optimal_design.discriminate import discriminate

            return discriminate([law, *between[1:]], **options)
    with output.status(f"Computing the information of the throws {COMPILES}"):
        from curlfit.optimal_design.design import design as compute_design

        return compute_design(law or "front-back", **options)
