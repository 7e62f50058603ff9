"""What is on disk: written whole or not at all, read whatever its age, used
without the data."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
from contextlib import contextmanager
from dataclasses import replace

import damaged_records
import h5py
import numpy as np
import pytest
from conftest import STRICT, invoke, python
from matplotlib.figure import Figure

import curlfit
from curlfit import DataError, InputError, load_comparison, load_fit
from curlfit.comparison.result import Lacking
from curlfit.output.figures import save_figure
from curlfit.paper import printed as paper
from curlfit.throws.synthetic import SIMULATED


@pytest.fixture(scope="module")
def compared(eq12):
    return curlfit.compare(eq12, ["front-back", "coulomb"])


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


def run(*words):
    outcome = invoke(words)
    if outcome.exception is not None:
        raise outcome.exception


def drawn(file):
    figure = Figure()
    figure.add_subplot().plot([1, 2])
    save_figure(figure, file)


WRITERS = {
    "fit.json": lambda file, saved: saved[0].save(file),
    "chain.h5": lambda file, saved: saved[1].save(file),
    "a.png": lambda file, _: drawn(file),
    "a.csv": lambda file, _: run("simulate", "--until", 1, "--out", file),
    "eq12.csv": lambda file, _: paper.write_jensen_shegelski(file),
}


@pytest.mark.parametrize("trouble", [full_disk, read_only_folder])
@pytest.mark.parametrize("name", WRITERS)
def test_what_cannot_be_written_is_said_and_what_was_there_stays(
    eq12_posterior, tmp_path, name, trouble
):
    before = SIMULATED if name == "a.csv" else "what was there"
    file = tmp_path / name
    file.write_text(before)
    with trouble(), pytest.raises(InputError, match="cannot be written") as caught:
        WRITERS[name](file, eq12_posterior)
    assert caught.value.exit_status == 2
    assert "\n" not in str(caught.value)
    assert file.read_text() == before
    assert [*tmp_path.iterdir()] == [file]
    WRITERS[name](file, eq12_posterior)
    assert file.stat().st_size > 100
    assert file.read_bytes() != before.encode()


def test_a_full_disk_leaves_no_half_of_a_compiled_program(tmp_path):
    run = python(*STRICT, "-c", COMPILE, CURLFIT_CACHE=str(tmp_path / "cache"))
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


@pytest.mark.parametrize("words", [["laws"], ["--version"]])
def test_what_cannot_be_printed_is_said(tmp_path, words):
    with open("/dev/full", "w") as full:
        run = subprocess.run(
            [sys.executable, "-m", "curlfit", *words],
            cwd=tmp_path,
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert (run.returncode, run.stderr) == (
        2,
        "curlfit: output: No space left on device\n",
    )


def test_what_a_killed_run_left_half_written_is_cleared(tmp_path):
    from curlfit.output.files import prepare_folder

    old = tmp_path / ".curlfit-abc-chain.h5"
    new = tmp_path / ".curlfit-def-chain.h5"
    for file in (old, new):
        file.write_text("half")
    folder = tmp_path / ".curlfit-x"  # nobody knows whose
    folder.mkdir()
    for path in (old, folder):
        os.utime(path, (0, 0))
    prepare_folder(tmp_path)
    assert sorted(tmp_path.iterdir()) == [new, folder]


def record_of(result, folder, change):
    result.save(folder / "record.json")
    record = json.loads((folder / "record.json").read_text())
    change(record)
    (folder / "record.json").write_text(json.dumps(record))
    return folder / "record.json"


def test_records_that_have_more_than_this_version_knows(eq12_posterior, tmp_path):
    def later(record):
        record["new"] = 1
        for parameter in record["parameters"].values():
            parameter["new"] = 1
        for name in ("posterior", "stone", "reference", "data"):
            record[name]["new"] = 1
        record["combinations"][0]["new"] = 1

    fit = eq12_posterior[0]
    same = load_fit(record_of(fit, tmp_path, lambda record: None))
    assert same.to_json() == fit.to_json()
    again = load_fit(record_of(fit, tmp_path, later))
    assert (again.parameters, again.posterior) == (fit.parameters, fit.posterior)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            {"schema": 2},
            "written by a newer curlfit: schema 2 found, this version reads up to 1",
        ),
        ({"schema": 0}, "schema 0 found"),
        ({"schema": "1"}, "names no schema"),
        ({"stone": None}, "stone: null found, expected an object"),
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


@pytest.mark.parametrize(
    ("place", "value", "said"),
    [
        ("stone.R", "x", "stone.R: 'x' found, expected a number"),
        ("stone.R", -1.0, "stone: stone.R = -1.0 m: expected a positive"),
        (
            "parameters.mu1_xi.value",
            [1],
            "parameters.mu1_xi.value: a list found, expected a num",
        ),
        (
            "parameters.mu1_xi.verdict",
            "sure",
            "parameters.mu1_xi.verdict: 'sure' found, expected",
        ),
        ("converged", 1, "converged: 1 found, expected true or false"),
        ("warnings", "abc", "warnings: 'abc' found, expected a list"),
        ("observed.x", [1.0, 2.0], "observed: expected series of 201 values"),
        ("covariance.matrix", [[1.0]], "covariance: expected a square matrix"),
        ("combinations", [{"expression": "a"}], "combinations.0: no 'weights' in it"),
        ("noise.initial_state", [[1.0]], "noise: expected a covariance"),
        ("noise.kind", "pink", "noise: 'pink' found, expected a kind, one of white"),
        ("noise.memory", [0.1], "noise.memory: a list found, expected an object"),
        ("noise.white", [1.0], "noise.white: a list found, expected an object"),
        ("data.flags", 3, "data.flags: 3 found, expected a list"),
        ("data.flags", [3], "data.flags.0: 3 found, expected text"),
        ("sigma", {}, "sigma: expected all that were estimated"),
        ("data.sigma", {}, "data: expected sigma of each"),
        ("null_directions", 3, None),
    ],
)
def test_what_is_of_another_type_is_refused_with_its_key(
    eq12_fit, tmp_path, place, value, said
):
    *way, last = place.split(".")

    def change(record):
        for key in way:
            record = record[key]
        record[last] = value

    file = record_of(eq12_fit, tmp_path, change)
    if said is None:  # nothing is read from there
        assert load_fit(file).identifiability == eq12_fit.identifiability
        return
    with pytest.raises(DataError) as caught:
        load_fit(file)
    assert str(caught.value).startswith(f"{file}: {said}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("speed", lambda values: values[:-1]),
        ("lacks", lambda values: values[:2]),
        ("others", lambda values: {"power": [[0.0]] * 3}),
    ],
)
def test_what_a_law_lacks_has_series_of_one_length(compared, tmp_path, name, change):
    rows = np.ones((3, 12))
    lacking = Lacking("front-back", rows[0], rows[0], rows, rows, rows)
    compared = replace(compared, lacking=lacking)

    def changed(record):
        record["lacking"][name] = change(record["lacking"][name])

    load_comparison(record_of(compared, tmp_path, lambda record: None))
    with pytest.raises(DataError, match="lacking: expected series of one length"):
        load_comparison(record_of(compared, tmp_path, changed))


@pytest.mark.parametrize("key", ["sampling", "data"])
def test_a_record_of_an_earlier_version_is_to_be_fitted_again(eq12_fit, tmp_path, key):
    file = record_of(eq12_fit, tmp_path, lambda record: record.pop(key))
    with pytest.raises(
        DataError, match=f"no '{key}' in it; .* an earlier version: fit again"
    ):
        load_fit(file)


@pytest.mark.parametrize(
    "text",
    [
        "[" * 100_000,
        '{"schema": 1, "a": ' * 100_000,
        '{"schema": 1, "a": NaN}',
        "9" * 5000,
    ],
)
def test_what_is_no_record_is_refused(tmp_path, text):
    (tmp_path / "fit.json").write_text(text)
    for verb in ("show", "predict"):
        run = invoke([verb, tmp_path])
        assert isinstance(run.exception, DataError), run.exception
        assert "this is not JSON; expected a fit.json of curlfit" in str(run.exception)


def test_a_record_is_of_limited_size(tmp_path):
    with (tmp_path / "fit.json").open("wb") as file:
        file.truncate(10**9)
    with pytest.raises(DataError, match=r"larger than a fit\.json of curlfit can be"):
        load_fit(tmp_path)
    (tmp_path / "fit.json").write_text('{"a": [' + "[]," * 1_000_000 + "0]}")
    with pytest.raises(DataError, match=r"larger than a fit\.json of curlfit can be"):
        load_fit(tmp_path)


def test_a_chain_is_of_its_fit_wherever_it_is_read(eq12_posterior, tmp_path):
    fit, chain = eq12_posterior
    other = replace(chain, subject=chain.subject | {"data": "#1234"})
    fit.save(tmp_path / "fit.json")
    other.save(tmp_path / "chain.h5")
    for words in (["show"], ["plot"], ["predict"], ["export", "--to", "netcdf"]):
        run = invoke([words[0], tmp_path, *words[1:]])
        assert str(run.exception) == (
            f"{tmp_path / 'chain.h5'}: the chain is of another fit: "
            "not the same data; sample this one again"
        )
    assert {file.name for file in tmp_path.iterdir()} == {"fit.json", "chain.h5"}


def test_a_chain_is_as_large_as_its_file(eq12_posterior, tmp_path):
    eq12_posterior[1].save(tmp_path / "chain.h5")
    with h5py.File(tmp_path / "chain.h5", "r+") as out:
        del out["mcmc"]["chain"]
        out["mcmc"].create_dataset("chain", (10**7, 32, 10), "f8")
    with pytest.raises(
        DataError, match=r"of this version of curlfit \(.*are not in the file"
    ):
        curlfit.load_chain(tmp_path / "chain.h5")


def test_damaged_records_are_read_or_refused(eq12_posterior, compared, tmp_path):
    fit, chain = eq12_posterior
    for result in (fit, compared):
        (tmp_path / result.kind).mkdir()
        result.save(tmp_path / result.kind / f"{result.kind}.json")
    chain.save(tmp_path / "fit" / "chain.h5")
    run = python(
        *STRICT, damaged_records.__file__, tmp_path, 1, 40, OPENBLAS_NUM_THREADS="1"
    )
    assert run.returncode == 0, run.stderr
    report = json.loads(run.stdout)
    assert report["faults"] == []
    assert report["statuses"]["0"] > 4
    assert report["statuses"]["2"] > 12
