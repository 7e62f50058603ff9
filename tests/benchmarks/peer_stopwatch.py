"""What a user would write instead: the friction of a draw by its times, with scipy.

Constant deceleration in closed form, its standard errors, and a figure on request; a
file of lines `hog_to_hog = 14.2`, `curl = 4 ft left` and `rest = 0.6`.

    python tests/benchmarks/peer_stopwatch.py stopwatch.txt [stopwatch.png]
"""

import sys

import numpy as np
from scipy.optimize import least_squares

G = 9.81
FOOT = 0.3048
HOG_TO_HOG = 21.945
HOG_TO_TEE = 28.346
SIGMA = np.array([0.1, 0.05, 0.05])


def measured(file):
    """Time between the hog lines (s), resting position from the near one
    and curl (m)."""
    with open(file) as lines:
        entries = {
            key.strip(): text.split()
            for key, _, text in (line.partition("=") for line in lines)
        }
    size, unit, side = entries["curl"]
    curl = float(size) * (FOOT if unit == "ft" else 1.0) * (-1 if side == "left" else 1)
    return np.array(
        [float(entries["hog_to_hog"][0]), HOG_TO_TEE + float(entries["rest"][0]), curl]
    )


def model(p):
    """The same three from mu, heading and speed."""
    mu, heading, v = p
    a = mu * G
    c = np.cos(heading)
    length = v**2 / (2 * a)
    time = (v - np.sqrt(np.maximum(v**2 - 2 * a * HOG_TO_HOG / c, 0))) / a
    return np.array([time, length * c, length * np.sin(heading)])


def main(file, picture=None):
    """Fit a file, print mu, heading and speed with their errors."""
    data = measured(file)
    fit = least_squares(
        lambda p: (model(p) - data) / SIGMA,
        [0.01, 0.0, 2.4],
        x_scale=[0.01, 0.1, 1.0],
        xtol=1e-12,
    )
    errors = np.sqrt(np.diag(np.linalg.inv(fit.jac.T @ fit.jac)))
    if picture is not None:
        draw(fit.x, data, picture)
    return fit.x, errors


def draw(p, data, picture):
    """y and speed over time."""
    from matplotlib.figure import Figure

    mu, _, v = p
    t = np.linspace(0, v / (mu * G), 200)
    figure = Figure(figsize=(10, 4), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.plot(t, v * t - mu * G * t**2 / 2)
    left.errorbar(data[0], HOG_TO_HOG, xerr=SIGMA[0], fmt="o")
    left.errorbar(t[-1], data[1], yerr=SIGMA[1], fmt="o")
    left.set(xlabel="t (s)", ylabel="y (m)")
    right.plot(t, v - mu * G * t)
    right.set(xlabel="t (s)", ylabel="speed (m/s)")
    figure.savefig(picture, dpi=150)


if __name__ == "__main__":
    print(*main(*sys.argv[1:]))
