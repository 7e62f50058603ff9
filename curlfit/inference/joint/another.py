"""Another throw on the ice of a joint fit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from curlfit.errors import InputError
from curlfit.foreign import file_and_number
from curlfit.inference.fit.result import FitResult
from curlfit.inference.joint.draw import Draw
from curlfit.inference.joint.result import JointResult
from curlfit.inference.parameters import START
from curlfit.numerics.arrays import Floats


def another(
    joint: JointResult, labels: Mapping[str, str], number: int, random: np.random.Generator
) -> tuple[FitResult, Floats]:
    """A throw on the same ice that has not been thrown, and draws of its parameters.

    It is that of the throws with as many of the labels as possible that was thrown last, with
    the coefficients of the mean, and a spin that gives the usual angle at rest.

    Raises
    ------
    InputError : labels that the fit does not distinguish.
    """
    if not joint.throws:
        raise InputError("a fit of a table predicts no throw; fit some of its throws together")
    alike = [len(one.data["labels"].items() & labels.items()) for one in joint.throws]
    near = joint.throws[max(range(len(alike)), key=lambda row: (alike[row], row))]
    if joint.means is None:
        raise InputError("the coefficients are equal in all throws; fit without --share")
    names = list(near.parameters)
    place = [names.index(name) for name in joint.means.names]
    ends = near.parameter_set.lower[place], near.parameter_set.upper[place]
    mean, drawn = joint.means.draw(labels, number, random, *ends)
    values = np.tile(near.values, (1 + number, 1))
    values[:, place] = [mean, *drawn]
    angle = np.copysign(joint.means.angle, near.parameters["omega0"].value)
    draw = Draw(near.model, near.stone)
    values[:, names.index("omega0")] = draw.spin(values[:, : -len(START)], angle)
    best = {
        name: replace(near.parameters[name], value=float(value))
        for name, value in zip(names, values[0], strict=True)
    }
    data = [one.data for one in joint.throws]
    files = list(dict.fromkeys(file_and_number(one["file"])[0] for one in data))
    own = {
        "file": files[0] if len(files) == 1 else f"{len(files)} files",
        "rows": sum(one["rows"] for one in data),
        "from": min(one["from"] for one in data), "to": max(one["to"] for one in data),
    }  # fmt: skip
    fitted = {
        name: np.concatenate([one.fitted[name] for one in joint.throws])
        for name in ("speed", "omega")
    }
    fit = replace(near, parameters=best, data=near.data | own, fitted=near.fitted | fitted)
    return fit, values[1:]
