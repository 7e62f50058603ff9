"""`curlfit predict`: prediction of a throw."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Group, Parameter

from curlfit.errors import InputError
from curlfit.foreign import safe_name
from curlfit.options import settings as s
from curlfit.options.output import COMPILES, Output, Saved
from curlfit.settings.choices import COUNT, SEED, Choices, Named, Reading
from curlfit.settings.forms import LABELS, NUMBER, PATH, SWITCH, TEXT, numbers, option

if TYPE_CHECKING:
    from curlfit.prediction.result import Call

_CHECK = Group("Comparison with measured rows", sort_key=1)


@Parameter(
    name="*",
    group=Group("Another throw: its goal (speed and heading are found)", sort_key=0),
)
@dataclass(frozen=True, kw_only=True)
class Goal(Choices):
    """Where another throw goes.

    Attributes
    ----------
    to_tee : Come to rest on the tee.
    weight : `draw`: rests on the tee line; `guard`: rests halfway between hog line and
        house, 4.115 m before the tee line; `takeout`: passes the tee line at 1.5 m/s.
        On the centre line, or at any x with --heading.
    tee_speed : Speed of a takeout at the tee line, m/s. [default: 1.5]
    target : Come to rest at this point: m to the right of the tee and m beyond it.
    """

    to_tee: Annotated[bool, option(SWITCH)] = False
    weight: Annotated[str | None, option(TEXT, "NAME")] = None
    tee_speed: Annotated[float | None, option(NUMBER, "V")] = None
    target: Annotated[
        tuple[float, float] | None, option(numbers(2, "X,Y in m from the tee"), "X,Y")
    ] = None


@Parameter(name="*", group=Group("Another throw in curlers' terms", sort_key=0))
@dataclass(frozen=True, kw_only=True)
class Called(Choices):
    """Another throw in curlers' terms.

    Attributes
    ----------
    hog_to_hog : Weight: time between the hog lines, s.
    broom : Where the broom is, seen from the thrower, at the far tee: `4 ft left`,
        `1.2 m right`.
    thrower_sd : Scatter of the thrower, standard deviations of weight and broom:
        `0.15 s, 4 in`. [default: none]
    turn : `clockwise` or `counter-clockwise`; `in` or `out` of a right-hander; `both`,
        whose `--broom` is that of the in-turn.
    sheet : Sheet of ice, of a joint fit by sheets.
    group : Group of a joint fit, by the labels of `--by`: `thrower=Anna`; or the
        place along a trend: `start=21:30`. [default: the mean of the groups; the end
        of the trend]
    """

    hog_to_hog: Annotated[float | None, option(NUMBER, "S")] = None
    broom: Annotated[str | None, option(TEXT, "OFFSET")] = None
    thrower_sd: Annotated[str | None, option(TEXT, "TIME, LENGTH")] = None
    turn: Annotated[str | None, option(TEXT, "TURN")] = None
    sheet: Annotated[str | None, option(TEXT, "NAME")] = None
    group: Annotated[Named, option(LABELS, "LABEL=NAME")] = field(default_factory=dict)

    def call(self) -> Call:
        """The throw. Raises `InputError` for an offset without a side."""
        from curlfit.prediction.result import Call

        labels = dict(self.group)
        if self.sheet is not None:
            labels["sheet"] = self.sheet
        broom = None if self.broom is None else _broom(self.broom)
        thrower = None if self.thrower_sd is None else _scatter(self.thrower_sd)
        return Call(labels, self.hog_to_hog, broom, thrower, self.turn)


def _broom(text: str) -> float:
    """A broom in m to the right of the centre line."""
    from curlfit.throws.readers.notation import parse_quantity

    length = parse_quantity(text, "x")
    if math.isnan(length.value) or length.words not in (set(), {"left"}, {"right"}):
        raise InputError(f"--broom {text}: expected a length, left or right")
    if length.value and not (length.words or length.signed):
        raise InputError(f"--broom {text}: to which side? Expected 4 ft left")
    return -length.value if "left" in length.words else length.value


def _scatter(text: str) -> tuple[float, float]:
    """Standard deviations of weight in s and of broom in m."""
    from curlfit.throws.readers.notation import parse_quantity

    time, comma, length = text.partition(",")
    if not comma:
        raise InputError(f"--thrower-sd {text}: expected TIME, LENGTH")
    return parse_quantity(time, "t").value, parse_quantity(length, "x").value


def predict(
    fit: Path,
    /,
    *,
    line: Annotated[str | None, option(TEXT, "LINE", name="--from")] = None,
    start: s.Start = s.Start(),
    goal: Goal = Goal(),
    called: Called = Called(),
    check: Annotated[Path | None, option(PATH, "DATA", group=_CHECK)] = None,
    reading: Reading = Reading(),
    draws: Annotated[int, option(COUNT, "N")] = 1000,
    seed: Annotated[int, option(SEED, "N")] = 0,
    law: s.LawOfFit = None,
    output: Output = Output(),
) -> Saved:
    """Predict a throw: path and resting position, with their uncertainties.

    Without options: the fitted throw, extrapolated to rest. With a start or a
    goal: another throw on the same ice, by default from the near hog line with the
    spin of the fitted one. Bands include the errors of the parameters and the
    model discrepancy.
    Writes `predict.json`, `predict.csv` (the path with its bands) and `predict.png`.

    Examples:

    `curlfit predict throw-fit --v0 2.2 --omega0 -1.5`: the path of another throw

    `curlfit predict throw-fit --to-tee`: how to throw a draw to the button

    `curlfit predict throw-fit --target -0.6,0.3`: to rest left of the tee and behind it

    `curlfit predict evening-fit --sheet 2 --hog-to-hog 13.9 --broom "4 ft left" --turn
    in`: the next stone on the ice of a joint fit

    `curlfit fit a.csv --until 12`, then `curlfit predict a-fit --check a.csv`:
    was it right?

    Parameters
    ----------
    fit
        A saved fit, also of several throws or of a season: its folder, or
        the file in it.
    line
        Line on which the throw starts: `hack`, `back`, `tee`, `hog` (the near
        ones), `centre` or `far-hog`; or `data`: at the start of the data, with y
        from the hack. [default: hog; data for the fitted throw where its file
        states its zero of y]
    check
        The data of the fitted throw; rows after the fitted ones are compared.
    draws
        Number of draws from the posterior. [default: 1000]
    seed
        Seed of the draws. [default: 0]
    """
    from curlfit.output.document import command_line
    from curlfit.output.files import atomic_write, claim_folder

    drawn = output.drawn()
    goals = [goal.to_tee, goal.weight is not None, goal.target is not None]
    if sum(goals) > 1:
        raise InputError("--to-tee, --weight and --target: expected one of them")
    result: Any
    chain = None
    if s.kind_of(fit) == "joint":
        from curlfit.inference.together.result import load_joint

        result = load_joint(fit).with_law(law)
    else:
        result, chain = s.load_fit_and_chain(fit, law)
    throw = None
    if check is not None:
        from curlfit.throws.load import load_throw

        throw = load_throw(check, **vars(reading))
    drawn.draw_beside()
    with output.status(f"Simulating the draws {COMPILES}"):
        from curlfit.prediction.predict import predict as prediction_of

        prediction = prediction_of(
            result,
            chain,
            start=start.given(),
            call=called.call(),
            line=line,
            target=(0.0, 0.0) if goal.to_tee else goal.target,
            weight=goal.weight,
            tee_speed=goal.tee_speed,
            draws=draws,
            seed=seed,
            check=throw,
        )
    words = [*start.words(), *goal.words(), *called.words(), *reading.words()]
    if line:
        words.append(f"--from={line}")
    if check:
        words.append(f"--check={check}")
    words += [f"--draws={draws}", f"--seed={seed}"]
    command = command_line("predict", str(fit), *words)
    prediction = replace(prediction, command=command)
    group = [safe_name(name) for name in prediction.call.labels.values()]
    usual = Path("-".join([s.name_of(fit), *group, "predict"]))
    folder = claim_folder(output.out or usual)
    table = folder / "predict.csv"
    atomic_write(table, prediction.table())
    return output.finish(prediction, folder, drawn, files=[table])
