"""The registry of results: every kind has its document, figures and loader."""

from __future__ import annotations

import pytest

import curlfit
from curlfit.output.display import document_of, figures_of, kind_of
from curlfit.output.kinds import KINDS, PARTS

OF_EARLIER = ("fit", "joint", "compare")


def test_every_kind_has_public_functions_of_its_noun():
    public = set(dir(curlfit))
    for kind in KINDS.values():
        assert {f"load_{kind.noun}", f"print_{kind.noun}"} <= public, kind.name
        drawn = {f"{kind.noun}_figure", f"{kind.noun}_figures"}
        assert drawn & public, kind.name


@pytest.mark.parametrize("name", OF_EARLIER)
def test_a_saved_result_is_read_said_and_drawn_by_its_kind(request, name):
    folder = request.path.parents[1] / "results_of_0_2" / name
    result = KINDS[name].load(folder)
    assert kind_of(result) == name
    assert document_of(result).subject
    figures = figures_of(result)
    assert figures.keys() <= set(KINDS[name].figure_names)
    assert KINDS[name].name in figures


def test_what_is_shown_but_not_saved_is_no_kind_of_result(request):
    folder = request.path.parents[1] / "results_of_0_2" / "fit"
    fit = curlfit.load_fit(folder)
    chain = curlfit.load_chain(folder / "chain.h5", fit)
    for part in (fit.posterior, chain):
        assert kind_of(part) == ""
        assert part.kind in PARTS
        assert repr(part).startswith(type(part).__name__)
        with pytest.raises(curlfit.InputError):
            curlfit.write_report(part, "report.html")
