"""Evidence and leave-one-out against samplers, see `samplers.py`."""

from __future__ import annotations

import numpy as np
import pytest
from samplers import CASES, closed_form, fitted, nested, psis
from tables import HERE

from curlfit.comparison.criteria import log_evidence, log_likelihood

each = pytest.mark.parametrize("case", CASES, ids=["coulomb", "ridge", "bound"])


@each
def test_log_evidence_is_that_of_nested_sampling_in_the_table(case):
    text = (HERE / "README.md").read_text().split("<!-- evidence -->")[1]
    (line,) = [
        line for line in text.splitlines() if line.startswith(f"| {case.title} |")
    ]
    expected, error = map(float, line.split("|")[3].split("±"))
    fit = fitted(case)
    evidence = log_evidence(fit, sum(log_likelihood(fit).values()))
    assert evidence == pytest.approx(expected, abs=3 * error)
    at_bound = [
        name
        for name, estimate in fit.parameters.items()
        if estimate.verdict == "at bound"
    ]
    assert at_bound == (["mu1_xi"] if "bound" in case.title else [])


@pytest.mark.slow
@each
def test_log_evidence_against_nested_sampling(case):
    fit = fitted(case)
    expected, error, _ = nested(fit, seed=1)
    evidence = log_evidence(fit, sum(log_likelihood(fit).values()))
    assert evidence == pytest.approx(expected, abs=3 * error)


@pytest.mark.slow
@each
def test_leave_one_out_against_importance_sampling(case):
    fit = fitted(case)
    leave_one_out = closed_form(fit)
    expected = psis(fit, seed=1)
    assert float(expected.pareto_k.max()) < 0.7
    assert leave_one_out.elpd == pytest.approx(expected.elpd, abs=0.3)
    assert leave_one_out.stderr == pytest.approx(expected.stderr, rel=0.02)
    assert leave_one_out.p_loo == pytest.approx(expected.p_loo, abs=0.3)
    np.testing.assert_allclose(leave_one_out.left_out, expected.left_out, atol=0.1)
