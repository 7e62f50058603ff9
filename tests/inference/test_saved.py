"""What is on disk: written whole or not at all, read whatever its age, used without the data."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
from contextlib import contextmanager
from dataclasses import replace

import pytest
from conftest import DATA, command, invoke
from matplotlib.figure import Figure

import curlfit
from curlfit import DataError, InputError, load_comparison, load_fit
from curlfit.inference.report import about_posterior
from curlfit.output.figures import save_figure
from curlfit.paper import printed as paper
from curlfit.throws.synthetic import SIMULATED


@pytest.fixture(scope="module")
def compared(eq12):
    return curlfit.compare(eq12, ["coulomb", "front-back"])


@contextmanager
def full_disk():
    """No file can be given a byte."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@contextmanager
def read_only_folder():
    """No file can be made. (Permissions do not bind root, who may run the tests.)"""

    def refuse(*_, **__):
        raise OSError(30, "Read-only file system")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tempfile, "mkstemp", refuse)
        patch.setattr(tempfile, "NamedTemporaryFile", refuse)
        yield


def writers(fit, chain, compared, folder):
    figure = Figure()
    figure.add_subplot().plot([1, 2])

    def run(*words):
        found = invoke([str(word) for word in words])
        if isinstance(found.exception, InputError):
            raise found.exception
        assert found.exit_code == 0, found.exception

    def reproduce():
        with pytest.MonkeyPatch.context() as patch:
            # the page and its figures are not made where the first file cannot be written
            found = type("Found", (), {"claims": ()})
            patch.setattr("curlfit.paper.reproduce.reproduce", lambda **_: found)
            patch.setattr("curlfit.paper.page.page", lambda found, format: "claims")
            patch.setattr("curlfit.paper.figures.FIGURES", {"eq14": lambda found: figure})
            run("reproduce", "--out", folder)

    fit.save(folder / "saved" / "fit.json")
    chain.save(folder / "saved" / "chain.h5")
    compared.save(folder / "both" / "compare.json")
    return {
        "fit.json": lambda: fit.save(folder / "fit.json"),
        "chain.h5": lambda: chain.save(folder / "chain.h5"),
        "compare.json": lambda: compared.save(folder / "compare.json"),
        "a.png": lambda: save_figure(figure, folder / "a.png"),
        "a.pdf": lambda: save_figure(figure, folder / "a.pdf"),
        "a.svg": lambda: save_figure(figure, folder / "a.svg"),
        "fit.pdf": lambda: run("plot", folder / "saved", "--format", "pdf", "--out", folder),
        "compare.png": lambda: run("plot", folder / "both", "--out", folder),
        "claims.json": reproduce,
        "a.csv": lambda: run("simulate", "--until", 1, "--out", folder / "a.csv"),
        "eq12.csv": lambda: paper.write_jensen_shegelski(folder / "eq12.csv"),
    }


NAMES = [
    "fit.json", "chain.h5", "compare.json", "a.png", "a.pdf", "a.svg", "fit.pdf", "compare.png",
    "claims.json", "a.csv", "eq12.csv",
]  # fmt: skip


@pytest.mark.parametrize("trouble", [full_disk, read_only_folder])
@pytest.mark.parametrize("name", NAMES)
def test_what_cannot_be_written_is_said_and_what_was_there_stays(
    eq12_posterior, compared, tmp_path, name, trouble
):
    for folder in ("saved", "both"):
        (tmp_path / folder).mkdir()
    write = writers(*eq12_posterior, compared, tmp_path)
    assert list(write) == NAMES
    before = SIMULATED if name == "a.csv" else "what was there"
    (tmp_path / name).write_text(before)
    with trouble(), pytest.raises(InputError, match="cannot be written") as caught:
        write[name]()
    assert caught.value.exit_status == 2
    assert "\n" not in str(caught.value)
    assert (tmp_path / name).read_text() == before
    assert sorted(file.name for file in tmp_path.iterdir()) == sorted(["saved", "both", name])
    write[name]()
    assert (tmp_path / name).stat().st_size > 100 or name == "claims.json"
    assert (tmp_path / name).read_bytes() != before.encode()


def test_a_full_disk_leaves_no_half_of_a_compiled_program(tmp_path):
    run = subprocess.run(
        [sys.executable, "-W", "error", "-c", COMPILE],
        capture_output=True, text=True, check=False,
        env=os.environ | {"CURLFIT_CACHE": str(tmp_path / "cache")},
    )  # fmt: skip
    assert (run.returncode, run.stderr) == (0, "")
    assert run.stdout == "0 1\n"


COMPILE = """
import os, resource
import numpy as np
from curlfit.numerics import program_cache
from curlfit.numerics.compiled import compiled
folder = program_cache.folder()
before = resource.getrlimit(resource.RLIMIT_FSIZE)
resource.setrlimit(resource.RLIMIT_FSIZE, (10, before[1]))
compiled()(lambda a: 2 * a)(np.ones(1))
left = len(os.listdir(folder))
resource.setrlimit(resource.RLIMIT_FSIZE, before)
compiled()(lambda a: 3 * a)(np.ones(1))
print(left, len(os.listdir(folder)))
"""


@pytest.mark.parametrize("words", [["show", "DIR"], ["laws"], ["simulate", "--until", "1"]])
def test_what_cannot_be_printed_is_said(eq12_fit, tmp_path, words):
    eq12_fit.save(tmp_path / "fit.json")
    with open("/dev/full", "w") as full:
        run = subprocess.run(
            [sys.executable, "-m", "curlfit", *[word.replace("DIR", ".") for word in words]],
            cwd=tmp_path, stdout=full, stderr=subprocess.PIPE, text=True, check=False,
        )  # fmt: skip
    assert (run.returncode, run.stderr) == (2, "curlfit: output: No space left on device\n")


def test_what_a_killed_run_left_half_written_is_cleared(tmp_path):
    from curlfit.output.files import prepare_folder

    old, new = tmp_path / ".curlfit-abc-chain.h5", tmp_path / ".curlfit-def-chain.h5"
    for file in (old, new):
        file.write_text("half")
    folder = tmp_path / ".curlfit-x"  # nobody knows whose
    folder.mkdir()
    for path in (old, folder):
        os.utime(path, (0, 0))
    prepare_folder(tmp_path)
    assert sorted(tmp_path.iterdir()) == [new, folder]


def test_results_are_shown_and_drawn_without_the_data(eq12_posterior, compared, tmp_path):
    data = tmp_path / "gone.csv"
    data.write_bytes(DATA.read_bytes())
    fit = replace(curlfit.fit(curlfit.load_throw(data)), posterior=eq12_posterior[0].posterior)
    for folder in ("fit", "both"):
        (tmp_path / folder).mkdir()
    fit.save(tmp_path / "fit" / "fit.json")
    eq12_posterior[1].save(tmp_path / "fit" / "chain.h5")
    compared.save(tmp_path / "both" / "compare.json")
    data.unlink()
    for words, said in (
        (["show", "fit"], "gone.csv"),
        (["show", "fit/fit.json"], "Posterior: converged"),
        (["show", "both"], "front-back"),
        (["plot", "fit"], "corner.png"),
        (["plot", "fit/fit.json", "--out", "more"], "more/corner.png"),
        (["plot", "both"], "compare.png"),
    ):
        run = command(*words, cwd=tmp_path)
        assert (run.returncode, run.stderr) == (0, "")
        assert said in run.stdout
    assert (tmp_path / "fit" / "corner.png").stat().st_size > 10_000


def record_of(result, folder, change):
    result.save(folder / "record.json")
    record = json.loads((folder / "record.json").read_text())
    change(record)
    (folder / "record.json").write_text(json.dumps(record))
    return folder / "record.json"


def test_records_of_schema_1_that_lack_what_was_added_since(eq12_posterior, compared, tmp_path):
    fit = eq12_posterior[0]

    def earlier(record):
        del record["sampling"], record["lag1"], record["reference"]
        del record["data"]["law_file"], record["posterior"]["ess_tail"]
        record["posterior"]["autocorrelation_time"] = {"mu1_xi": 1.8}

    again = load_fit(record_of(fit, tmp_path, earlier))
    assert again.sampling == "ended"
    assert again.data == fit.data
    assert again.posterior == replace(fit.posterior, ess_tail={})
    assert "in the tail" not in about_posterior(again.posterior).plain
    assert (again.lag1, again.reference) == ({}, None)
    assert again.law_class is fit.law_class

    def unsampled(record):
        del record["sampling"], record["posterior"]

    assert load_fit(record_of(fit, tmp_path, unsampled)).sampling == "none"

    def plain(record):
        for item in record["candidates"]:
            del item["sides"], item["negative"], item["curl_explained"]

    plain_again = load_comparison(record_of(compared, tmp_path, plain))
    assert plain_again.best.sides == plain_again.best.negative == ()
    assert plain_again.best.bic == compared.best.bic


def test_records_that_have_more_than_this_version_knows(eq12_posterior, compared, tmp_path):
    def later(record):
        record["new"] = 1
        for item in record["parameters"].values():
            item["new"] = 1
        for name in ("posterior", "stone", "reference", "data"):
            record[name]["new"] = 1
        record["combinations"][0]["new"] = 1

    fit = eq12_posterior[0]
    again = load_fit(record_of(fit, tmp_path, later))
    assert again.parameters == fit.parameters
    assert again.posterior == fit.posterior

    def later_still(record):
        record["candidates"][0]["new"] = record["stone"]["new"] = 1

    assert load_comparison(record_of(compared, tmp_path, later_still)).best == compared.best


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"schema": 2}, "written by a newer curlfit: schema 2 found, this version reads up to 1"),
        ({"schema": 0}, "schema 0 found, which was never written"),
        ({"schema": "1"}, "names no schema"),
        ({"stone": None}, "not a complete"),
    ],
)
def test_what_cannot_be_read_is_refused(eq12_fit, compared, tmp_path, change, said):
    for what, load in ((eq12_fit, load_fit), (compared, load_comparison)):
        file = record_of(what, tmp_path, lambda record: record.update(change))
        with pytest.raises(DataError, match=said) as caught:
            load(file)
        assert str(file) in str(caught.value)
        file.write_text("not json")
        with pytest.raises(DataError, match="this is not JSON"):
            load(file)
