"""Draws of a prediction, animated in the page: they come to rest one by one."""

from __future__ import annotations

from typing import Any

import numpy as np

from curlfit.html_report.blocks import Block
from curlfit.html_report.replay import rounded
from curlfit.prediction.result import Prediction
from curlfit.sheet import HOUSE, STONE_RADIUS, TEE

_BEYOND = 0.6  # m drawn around the house
_CLOSE = 1.6  # half the height of the close view, relative to the spread of the resting positions
_SMALLEST = 0.25  # m, lower limit of half its height


def rests_of(prediction: Prediction, id: str) -> tuple[Block, dict[str, Any]] | None:
    """The throws of the posterior sample; None for a record without one."""
    sample = prediction.sample
    if not sample:
        return None
    x, y, phi = (sample[name] for name in ("x", "y", "phi"))
    ends = np.stack([x[:, -1], y[:, -1] - TEE], 1)
    inside = np.hypot(*ends.T) < HOUSE + STONE_RADIUS
    reach = HOUSE + _BEYOND
    low = np.minimum(ends.min(0) - _BEYOND, -reach)
    high = np.maximum(ends.max(0) + _BEYOND, reach)
    middle = np.median(ends, axis=0)
    half = max(_SMALLEST, _CLOSE * float(np.abs(ends - middle).max()))
    data = {
        "kind": "rests",
        "t": rounded(sample["t"], 3),
        "x": [rounded(row, 4) for row in x],
        "y": [rounded(row, 4) for row in y],
        "phi": [rounded(row, 3) for row in phi],
        "rest": rounded(sample["rest"], 3),
        "tee": TEE,
        "inside": inside.tolist(),
    }
    block = Block(
        "rests",
        {
            "id": id, "number": len(x), "ends": ends.tolist(), "inside": int(inside.sum()),
            "view": (low[0], -high[1], high[0] - low[0], high[1] - low[1]),
            "close": (middle[0] - half, -middle[1] - half, 2 * half, 2 * half),
            "radius": STONE_RADIUS, "half": half, "used": prediction.draws["used"],
        },
    )  # fmt: skip
    return block, data
