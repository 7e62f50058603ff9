"""What a user would write instead: the front-back law fitted with scipy, in one
short script.

The same model (uniform load, start free), the same data, 16 Gauss points on each
half of the ring. Sigma is estimated as curlfit does: even weights first, then one
sigma a channel.

    python tests/benchmarks/peer_scipy.py data/jensen_shegelski_2004.csv
"""

import sys

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

G = 9.81
RADIUS = 0.054
RHO = 0.1
TYPICAL = np.array([0.01, 0.01, 0.01, 0.01, 1.0, 1.0, 0.1, 1.0, 1.0, 1.0])

_x, _w = np.polynomial.legendre.leggauss(16)
ALPHA = np.concatenate([(_x + 1) * np.pi / 2, (_x - 1) * np.pi / 2])
WEIGHT = np.concatenate([_w, _w]) / 4
XI = np.cos(ALPHA)
ETA = np.sin(ALPHA)
FRONT = np.sin(ALPHA) > 0


def rates(_, state, mu_xi, mu_eta):
    """d/dt of x, y, heading, v, phi, omega."""
    _, _, heading, v, _, omega = state
    v = max(v, 1e-9)
    slide_xi = -RADIUS * omega * ETA
    slide_eta = v + RADIUS * omega * XI
    speed = np.sqrt(slide_xi**2 + slide_eta**2) + 1e-300
    t_xi = -mu_xi * slide_xi / speed
    t_eta = -mu_eta * slide_eta / speed
    a_xi = G * WEIGHT @ t_xi
    a_eta = G * WEIGHT @ t_eta
    spin = G * RADIUS / RHO**2 * WEIGHT @ (XI * t_eta - ETA * t_xi)
    return v * np.sin(heading), v * np.cos(heading), a_xi / v, a_eta, omega, spin


def stopped(_, state, *args):
    """A stone below 0.1 mm/s is at rest."""
    return state[3] - 1e-4


stopped.terminal = True


def path(p, t):
    """x, y, phi at the times, shape (3, n)."""
    mu_xi = np.where(FRONT, p[0], p[1])
    mu_eta = np.where(FRONT, p[2], p[3])
    start = [p[4], p[5], p[6], p[7], p[8], p[9]]
    run = solve_ivp(
        rates,
        (0, t[-1]),
        start,
        method="DOP853",
        args=(mu_xi, mu_eta),
        rtol=1e-8,
        atol=1e-9,
        dense_output=True,
        events=stopped,
    )
    return run.sol(np.minimum(t, run.t[-1]))[[0, 1, 4]]


def main(file):
    """Fit a file with columns t, x, y, phi and print the coefficients."""
    t, x, y, phi = np.loadtxt(
        file, delimiter=",", comments="#", skiprows=skipped(file)
    ).T[:4]
    data = np.stack([x, y, phi])
    v0 = (y[1] - y[0]) / (t[1] - t[0])
    start = np.array(
        [0.01, 0.01, 0.01, 0.01, x[0], y[0], 0.0, v0, phi[0], phi[1] / t[1]]
    )
    bounds = [0] * 4 + [-np.inf] * 6, [1] * 4 + [np.inf] * 6
    sigma = np.ones((3, 1))
    for _ in range(2):
        fit = least_squares(
            lambda p, sigma=sigma: ((path(p, t) - data) / sigma).ravel(),
            start,
            bounds=bounds,
            x_scale=TYPICAL,
            xtol=1e-10,
            ftol=1e-10,
            gtol=1e-10,
        )
        start = np.clip(fit.x, [0] * 4 + [-1e9] * 6, [1] * 4 + [1e9] * 6)
        residual = fit.fun.reshape(3, -1) * sigma
        sigma = residual.std(1, keepdims=True)
    return fit.x


def skipped(file):
    """Lines before the numbers: comments and the header."""
    with open(file) as lines:
        return next(n for n, line in enumerate(lines) if line[:1] in "-0123456789")


if __name__ == "__main__":
    print(main(sys.argv[1]))
