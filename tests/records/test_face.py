"""What `dir` of a fit lists, and what its entries are."""

from __future__ import annotations

import pytest


def public(result):
    return [name for name in dir(result) if not name.startswith("_")]


def test_dir_of_a_fit_lists_what_a_user_needs(eq12_fit):
    names = public(eq12_fit)
    assert len(names) <= 40
    needed = {
        *("parameters", "coefficients", "combinations", "values", "warnings", "rms"),
        *("residuals", "derive", "save", "to_frame", "posterior", "quantities"),
    }
    assert needed <= set(names)
    assert {"information", "ridge", "parameter_set"}.isdisjoint(names)


def test_what_dir_leaves_out_is_there_all_the_same(eq12_fit):
    assert eq12_fit.rank == eq12_fit.identifiability.rank
    assert eq12_fit.null_directions == eq12_fit.identifiability.null_directions
    assert eq12_fit.information.matrix.shape == (10, 10)


def test_entries_have_the_keys_of_the_file_as_items(eq12_fit):
    data = eq12_fit.data
    assert (data["from"], data["to"], data["rows"]) == (data.begin, data.end, data.rows)
    with pytest.raises(KeyError):
        data["begin"]


def test_matrices_of_a_record_cannot_be_changed(eq12_fit):
    information = eq12_fit.information
    for numbers in (
        information.matrix,
        information.gradient,
        eq12_fit.covariance.matrix,
    ):
        with pytest.raises(ValueError, match="read-only"):
            numbers += 1.0
