"""Results of every kind that has a page, of the shipped throw and small."""

from __future__ import annotations

import curlfit


def of_fit(throw):
    """A fit with a null direction, its chain, and a prediction from them."""
    fit, chain = curlfit.sample(curlfit.fit(throw), seed=1, effective=200)
    return {
        "fit": fit,
        "chain": chain,
        "prediction": curlfit.predict(fit, chain, draws=100),
    }


def of_all(throw):
    """The same, and the others."""
    results = of_fit(throw)
    return results | {
        "joint": curlfit.fit_together([throw, throw]),
        "comparison": curlfit.compare(throw, ["front-back", "coulomb"]),
        "profile": curlfit.profile(results["fit"], "mu1_xi", points=5),
        "design": curlfit.design("front-back", v0=[2.0, 2.2], omega0=[1.0, 5.0]),
    }
