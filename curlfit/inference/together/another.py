"""Another throw on the ice of a joint fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from curlfit.errors import InputError
from curlfit.foreign import file_and_number
from curlfit.inference.fit.entries import (
    DataOfFit,
    Determined,
    GaussNewtonInformation,
)
from curlfit.inference.fit.estimates import Estimate
from curlfit.inference.fit.result import FitResult
from curlfit.inference.information.named_matrix import NamedMatrix
from curlfit.inference.information.verdict import Verdict
from curlfit.inference.model.parameters import START, START_INDEX, before_start
from curlfit.inference.together.draw import Draw
from curlfit.inference.together.result import JointResult, SeparateFits
from curlfit.numerics.arrays import Floats


def another(
    joint: JointResult,
    labels: Mapping[str, str],
    number: int,
    random: np.random.Generator,
) -> tuple[FitResult, Floats]:
    """A throw on the same ice that has not been thrown, and draws of its parameters.

    It is that of the throws with as many of the labels as possible that was
    thrown last, with the coefficients of the mean, and a spin that gives the
    usual angle at rest.

    Raises
    ------
    InputError : labels that the fit does not distinguish.
    """
    if joint.means is None:
        raise InputError(
            "the coefficients are equal in all throws; fit without --share"
        )
    near = (
        _thrown_last(joint.throws, labels)
        if joint.table is None
        else _begun_last(joint, joint.table, labels)
    )
    names = list(near.parameters)
    of_mean = [names.index(name) for name in joint.means.names]
    ends = near.parameter_set.lower[of_mean], near.parameter_set.upper[of_mean]
    mean, drawn = joint.means.draw(labels, number, random, *ends)
    values = np.tile(near.values, (1 + number, 1))
    values[:, of_mean] = [mean, *drawn]
    angle = np.copysign(joint.means.angle, near.parameters["omega0"].value)
    draw = Draw(near.model, near.stone)
    values[:, START_INDEX["omega0"]] = draw.spin(before_start(values), angle)
    best = {
        name: replace(near.parameters[name], value=float(value))
        for name, value in zip(names, values[0], strict=True)
    }
    return replace(near, parameters=best), values[1:]


def _thrown_last(throws: Sequence[FitResult], labels: Mapping[str, str]) -> FitResult:
    """The throw that has most of the labels, with the extent of the data and the
    motion of all throws."""
    spins = [throw.parameters["omega0"].value for throw in throws]
    near = throws[_last([throw.data.labels for throw in throws], spins, labels)]
    data_by_throw = [throw.data for throw in throws]
    files = dict.fromkeys(file_and_number(data.file)[0] for data in data_by_throw)
    data_of_all = replace(
        near.data,
        file=next(iter(files)) if len(files) == 1 else f"{len(files)} files",
        rows=sum(data.rows for data in data_by_throw),
        begin=min(data.begin for data in data_by_throw),
        end=max(data.end for data in data_by_throw),
    )
    motion_of_all = {
        name: np.concatenate([throw.fitted[name] for throw in throws])
        for name in ("speed", "omega")
    }
    return replace(near, data=data_of_all, fitted=near.fitted | motion_of_all)


def _last(
    labels_by_throw: Sequence[Mapping[str, str]],
    spins: Sequence[float],
    labels: Mapping[str, str],
) -> int:
    """The row of the throw that has most of the labels, the last of these, among those
    that are known to turn if there are any."""
    alike = [len(of_throw.items() & labels.items()) for of_throw in labels_by_throw]
    return max(range(len(alike)), key=lambda row: (spins[row] != 0.0, alike[row], row))


def _begun_last(
    joint: JointResult, table: SeparateFits, labels: Mapping[str, str]
) -> FitResult:
    """The throw of a table that has most of the labels; only its motion is known."""
    if not table.starts:
        raise InputError(
            "the fit of the table does not say how its throws began: "
            "repeat the batch, without --free, and fit its table"
        )
    spins = [start.start["omega0"] for start in table.starts]
    begun = table.starts[_last([start.labels for start in table.starts], spins, labels)]
    start = {
        component.name: Estimate.of(
            component, begun.start[component.name], Verdict.DETERMINED
        )
        for component in START
    }
    data = DataOfFit(file=table.file, rows=table.throws, begin=0.0, end=table.duration)
    return FitResult(
        law=joint.law,
        load=joint.load,
        stone=table.stone,
        data=data,
        converged=joint.converged,
        status=joint.status,
        warnings=(),
        n_observations=0,
        rms={},
        sigma={},
        lag1={},
        parameters=joint.coefficients | start,
        combinations=joint.combinations,
        identifiability=Determined(
            joint.identifiability.rank, (), table.null_directions
        ),
        covariance=NamedMatrix((), np.zeros((0, 0))),
        information=GaussNewtonInformation.none(),
        reference=None,
        observed={"t": np.array([0.0, table.duration])},
        fitted={"speed": table.speeds, "omega": table.spins},
    )
