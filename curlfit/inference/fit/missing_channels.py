"""Further measurements that would determine the parameters that a throw does not determine.

Channels that were not measured are added hypothetically at the same times, with the noise of an
ordinary tracker and gyroscope. If one of them, or all together, would determine a parameter, that
is the remedy; if not, no measurement along this path would, and another throw or another stone is
needed (`curlfit design`). All channels are weighted by their sigma alone, as for white noise. The
correlation of noise that was not measured is unknown; under other noise models only those
parameters are named that no channel determines under any noise (null directions).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np

from curlfit.inference.fit.summary import LeastSquaresFit
from curlfit.inference.identifiability import WEAK_ERROR, Identifiability, analyse
from curlfit.inference.likelihood import predict_channels
from curlfit.numerics.differences import slopes
from curlfit.throws.throw import CHANNELS

NOISE = {"x": 0.005, "y": 0.005, "phi": 0.01, "speed": 0.02, "omega": 0.02}
"""Of a hypothetical channel: m, m, rad, m/s, rad/s."""
_STEP = 1e-4  # of a typical size, of differences: the path is accurate to 1e-8 of it


def remedies(
    fit: LeastSquaresFit, open_: Sequence[str], held: Collection[str]
) -> tuple[dict[str, Any], ...]:
    """What would determine some parameters, as {"parameters": names, "measure": channels}.

    Parameters
    ----------
    open_ : parameters that the data do not determine.
    held : parameters that stay fixed whatever is measured.

    Returns
    -------
    Parameters with the same remedy are grouped. Of several channels in "measure" any one suffices,
    unless "all" is true: then all are needed. It is empty where no channel would help.
    """
    parameters, values = fit.prepared.local_parameters, fit.solution.values
    problem, rows = fit.problem, len(fit.prepared.throw)
    free = np.array([place for place, name in enumerate(parameters.names) if name not in held])
    fixed = parameters.lower >= parameters.upper  # for lack of a channel that depends on them
    jacobian = slopes(
        lambda moved: predict_channels(fit.model, moved, problem)[:, :rows],
        values, _STEP * parameters.typical, free,
        lower=np.where(fixed, -np.inf, parameters.lower),
        upper=np.where(fixed, np.inf, parameters.upper),
    )  # fmt: skip
    weight = np.zeros(jacobian.shape[:2])
    weight[: len(problem.weight)] = problem.weight[:, :rows]
    missing = [name for row, name in enumerate(CHANNELS) if not weight[row].any()]
    names = [parameters.names[place] for place in free]

    def analysed(channels: Sequence[str]) -> Identifiability:
        full = weight.copy()
        for name in channels:
            full[CHANNELS.index(name)] = 1 / NOISE[name]
        matrix = (full[..., None] * jacobian).reshape(-1, len(free))
        return analyse(matrix, names, values[free], parameters.typical[free])

    def determined(channels: Sequence[str]) -> set[str]:
        known = analysed(channels)
        spread = np.sqrt(np.diag(known.covariance))
        sharp = (spread < WEAK_ERROR * parameters.typical[free]) & ~known.unseen
        return {name for name, take in zip(names, sharp, strict=True) if take}

    if fit.noise.kind != "white":
        unseen = dict(zip(names, analysed(missing).unseen, strict=True))
        never = [name for name in open_ if unseen[name]]
        return ({"parameters": never, "measure": [], "all": False},) if never else ()
    alone = {name: determined([name]) for name in missing}
    together = determined(missing) if len(missing) > 1 else set()
    found: dict[tuple[tuple[str, ...], bool], list[str]] = {}
    for name in open_:
        enough = [channel for channel, sees in alone.items() if name in sees]
        all_ = not enough and name in together
        if all_:
            enough = list(missing)
            for channel in reversed(missing):  # speed and spin are the least commonly measured
                fewer = [other for other in enough if other != channel]
                if name in determined(fewer):
                    enough = fewer
        found.setdefault((tuple(enough), all_), []).append(name)
    return tuple(
        {"parameters": named, "measure": list(channels), "all": all_}
        for (channels, all_), named in found.items()
    )
