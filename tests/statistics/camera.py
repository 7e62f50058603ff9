"""Errors of coefficients of throws that a swaying camera films, by noise
model of the fit.

    python tests/statistics/camera.py THROWS [--only TEXT]

writes the table "camera" of README.md beside this file. Throws of the front-back law
(R = 0.065 m, mu1_xi 0.004, mu2_xi 0.05, mu1_eta + mu2_eta 0.018, v0 2.25 m/s, omega0
1.4 rad/s of either sense, within some per cent) are filmed until rest. Sway is an
Ornstein-Uhlenbeck process of each channel; jitter is independent from row to row.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from tables import Table, asked, correlated

import curlfit
from curlfit.inference.fit.fit import fit_throws
from curlfit.noises import NOISES

SWAY = np.array([0.01, 0.01, 0.015])  # m, m, rad
JITTER = np.array([0.001, 0.004, 0.005])
ASKED = ("mu1_xi", "mu2_xi", "mu1_eta + mu2_eta")


@dataclass(frozen=True)
class Case:
    """How throws are filmed."""

    memory: float
    """correlation time of the sway, s; 0 without sway"""
    jitter: bool = True
    frames: float = 25.0
    """per second"""

    @property
    def title(self) -> str:
        """The first cell of its row."""
        sway = f"sway of {self.memory:g} s" if self.memory else ""
        parts = (sway, "jitter" if self.jitter else "")
        return f"{' and '.join(filter(None, parts))}, {self.frames:g} a second"


CASES = (
    Case(0.0),
    *(Case(memory, jitter) for memory in (0.3, 0.6, 2.0) for jitter in (False, True)),
    Case(0.6, True, 30.0),
    Case(0.6, True, 60.0),
    Case(2.0, False, 60.0),
)


def filmed(
    case: Case, random: np.random.Generator
) -> tuple[curlfit.Throw, list[float]]:
    """A throw, and the true values of what is asked."""
    some = 1 + 0.05 * random.uniform(-1, 1, 5)
    mu1_xi, mu2_xi, eta = some[:3] * [0.004, 0.05, 0.018]
    law = curlfit.find_law("front-back")(
        mu1_xi=mu1_xi, mu2_xi=mu2_xi, mu1_eta=eta / 2, mu2_eta=eta / 2
    )
    start = curlfit.InitialState(
        v=2.25 * some[3], omega=random.choice([-1, 1]) * 1.4 * some[4]
    )
    t = np.arange(0.0, 40.0, 1 / case.frames)
    path = curlfit.simulate(law, curlfit.Stone(R=0.065), start, t).to_numpy()
    rows = int((path.speed > 0).sum()) + 10
    noise = JITTER * case.jitter * random.standard_normal((rows, 3))
    if case.memory:
        carry = np.exp(-1 / (case.frames * case.memory))
        noise += SWAY * correlated(random.standard_normal((rows, 3)).T, carry).T
    series = np.array([path.x, path.y, path.phi])[:, :rows] + noise.T
    return curlfit.Throw.from_arrays(t[:rows], *series), [mu1_xi, mu2_xi, eta]


Fits = Sequence[curlfit.FitResult | Exception]


def cells(fits: Fits, white: Fits, truth: Sequence[Sequence[float]]) -> list[str]:
    """Of a row of the table: pulls, shares within two errors, rms over
    that of `white`."""
    pulls = []
    ratio = 0.0
    failed = 0
    bound = 0
    for fit, other, true in zip(fits, white, truth, strict=True):
        if isinstance(fit, Exception) or not fit.converged:
            failed += 1
            continue
        estimates = {
            **fit.parameters,
            **{combination.expression: combination for combination in fit.combinations},
        }
        asked_estimates = [estimates.get(name) for name in ASKED]
        pulls.append(
            [
                (estimate.value - value) / estimate.stderr
                if estimate and estimate.stderr
                else np.nan
                for estimate, value in zip(asked_estimates, true, strict=True)
            ]
        )
        bound += any(np.isnan(pulls[-1]))
        if not isinstance(other, Exception):
            ratio = max(
                ratio, *(fit.rms[name] / size for name, size in other.rms.items())
            )
    z = np.array(pulls)
    return [
        *(f"{size:.2f}" for size in np.sqrt(np.nanmean(z**2, axis=0))),
        f"{100 * (abs(z) < 2).sum() / np.isfinite(z).sum():.1f} %",
        f"{ratio:.2f}",
        str(bound or ""),
        str(failed or ""),
    ]


def main() -> None:
    """Run the cases and write their table."""
    chosen = asked(__doc__)
    table = Table(
        "",
        "fitted noise",
        *(f"pull of {name}" for name in ASKED),
        "within two errors",
        "largest rms over white",
        "without error",
        "not converged",
    )
    for seed, case in enumerate(CASES):
        if chosen.only not in case.title:
            continue
        random = np.random.default_rng(seed)
        throws, truth = zip(
            *(filmed(case, random) for _ in range(chosen.throws)), strict=True
        )
        white: Fits = ()
        for noise in NOISES:
            fits = fit_throws(throws, "front-back", noise=noise)
            white = white or fits
            table.add(case.title, noise, *cells(fits, white, truth))
    if not chosen.only:
        table.put("camera", f"{chosen.throws} throws a case.")


if __name__ == "__main__":
    main()
