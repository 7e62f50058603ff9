"""The ridge of the page "When the path tells a curve", drawn from the record of its
fit: `ridge.svg`.

`python notebooks/pictures/draw_ridge.py` draws it again. Colours are of medium
brightness, to be read on white and on black.
"""

from __future__ import annotations

import io
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import curlfit

FOLDER = Path(__file__).parent
DATA = FOLDER.parents[1] / "data" / "without_angle.csv"
LAW = "power+transverse"
LIMIT = 3.84  # rise of chi squared at the ends of a 95 % interval
TRUTH = {"b": 0.05, "omega0": 1.1}
GREY, BLUE, ORANGE = "#7b7b7b", "#3f7fc4", "#c8641e"
STYLE = {
    "svg.fonttype": "none",
    "svg.hashsalt": "ridge",
    "font.size": 10,
    "text.color": GREY,
    "axes.edgecolor": GREY,
    "axes.labelcolor": GREY,
    "xtick.color": GREY,
    "ytick.color": GREY,
}


def draw_curve(axes: Axes, fit: curlfit.FitResult) -> None:
    """b against omega0: the points of the ridge, the product, the truth."""
    names = list(fit.parameters)
    points = np.array([point.values for point in fit.ridge])
    b = points[:, names.index("b")]
    omega0 = points[:, names.index("omega0")]
    product = fit["b*omega0"]
    spins = np.geomspace(0.04, 13.0, 200)
    for value in (product.value - product.stderr, product.value + product.stderr):
        axes.plot(spins, value / spins, color=BLUE, linewidth=0.6)
    label = f"b omega0 = {product.value:.4f} +- {product.stderr:.4f}"
    axes.plot(spins, product.value / spins, color=BLUE, label=label)
    axes.plot(omega0, b, "o", color=GREY, markersize=4, label="values that fit")
    axes.plot(*reversed(TRUTH.values()), "x", color=ORANGE, ms=9, mew=2, label="truth")
    axes.set(xscale="log", yscale="log", xlabel="omega0 (rad/s)", ylabel="b (m/s²)")
    axes.legend(frameon=False)


def draw_profile(axes: Axes, profile: curlfit.Profile) -> None:
    """How far chi squared rises where b is held."""
    axes.plot(profile.at, profile.delta, color=BLUE)
    axes.axhline(LIMIT, color=GREY, linestyle=":")
    axes.text(1.0, LIMIT, "95 %", ha="right", va="bottom")
    axes.axvline(TRUTH["b"], color=ORANGE)
    axes.set(xscale="log", xlabel="b (m/s²)", ylabel="rise of chi squared", ylim=(0, 8))


def picture() -> str:
    """Both as SVG."""
    throw = curlfit.load_throw(DATA)
    fit = curlfit.fit(throw, LAW)
    profile = curlfit.profile(fit, "b")
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(9.0, 3.6), layout="constrained")
        left, right = figure.subplots(1, 2)
        draw_curve(left, fit)
        draw_profile(right, profile)
        text = io.StringIO()
        figure.savefig(text, format="svg", transparent=True, metadata={"Date": None})
    return text.getvalue()


if __name__ == "__main__":
    (FOLDER / "ridge.svg").write_text(picture(), encoding="utf-8")
