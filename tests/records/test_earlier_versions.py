"""Results that version 0.2.0 wrote are read: a chain may have cost hours.

The files in `results_of_0_2` were written by `curlfit fit`, `fit` of two files,
`compare` and `batch` of that version, from every eighth row of the shipped throw.
"""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import DATA, invoke

import curlfit
from curlfit.loads import Load

FILES = Path(__file__).parents[1] / "results_of_0_2"


@pytest.fixture(scope="module")
def fit():
    return curlfit.load_fit(FILES / "fit")


def test_a_fit_has_its_numbers_and_the_words_of_its_warnings(fit):
    assert fit["mu2_xi"].value == pytest.approx(0.0555976, abs=1e-7)
    assert fit["mu1_eta + mu2_eta"].stderr == pytest.approx(4.658e-05, rel=1e-3)
    assert fit.identifiability.rank == 9
    assert (fit.data.file, fit.data.rows, fit.data.end) == ("throw.csv", 26, 20.0)
    assert str(fit.warnings[0]).startswith("the residuals are smooth")
    assert fit.remedies[0].parameters == ("mu1_eta", "mu2_eta")
    assert fit.posterior.quantiles["mu2_xi"]["50"] == pytest.approx(0.0556, abs=2e-5)


def test_a_chain_is_that_of_its_fit(fit):
    chain = curlfit.load_chain(FILES / "fit" / "chain.h5", fit)
    samples = chain.of({"mu2_xi": 1.0})
    assert len(samples) == fit.posterior.samples == 1280
    assert samples.mean() == pytest.approx(fit.posterior.mean["mu2_xi"], rel=1e-9)
    assert np.isfinite(chain.log_posterior).all()
    assert fit.derive("mu2_xi - mu1_xi", chain).quantiles["50"] > 0.05


def test_a_chain_of_another_load_is_refused(fit):
    other = replace(fit, load=Load.CONSISTENT)
    with pytest.raises(curlfit.DataError, match="load was uniform, now consistent"):
        curlfit.load_chain(FILES / "fit" / "chain.h5", other)


def test_a_joint_fit_has_what_it_called_differences_as_its_variation():
    joint = curlfit.load_joint(FILES / "joint")
    variation = {quantity.expression: quantity for quantity in joint.variation}
    assert len(variation["mu1_xi"].each) == len(joint.throws) == 2
    assert not variation["mu1_xi"].significant
    assert (joint.differences, joint.groups) == ((), ())
    assert joint.identifiability.parameters == 16
    assert "2 throws together" in repr(joint)


def test_a_comparison_is_ranked_as_it_was():
    comparison = curlfit.load_comparison(FILES / "compare")
    assert [candidate.law for candidate in comparison.candidates] == [
        "front-back",
        "coulomb",
    ]
    assert comparison.best.coefficients["mu2_xi"].value == pytest.approx(0.0555976)
    assert comparison.best.noise_model.kind == "white"


def test_a_table_of_a_batch_is_not_mixed_with_rows_of_today(tmp_path):
    for name in ("season.csv", "season.settings.json"):
        shutil.copy(FILES / name, tmp_path)
    table = tmp_path / "season.csv"
    run = invoke(["batch", DATA, "--out", table])
    assert run.exit_code == 2
    assert "made by an earlier version, whose settings have no " in str(run.exception)
    assert table.read_bytes() == (FILES / "season.csv").read_bytes()
