"""Sampling that is stopped, killed or out of room loses nothing and can be resumed,
bit for bit."""

from __future__ import annotations

import json
import os
import signal
import time
from dataclasses import replace

import h5py
import numpy as np
import pytest
from conftest import DATA, command, invoke, started

from curlfit import DataError, InputError, load_chain, load_fit, sample
from curlfit.inference.sampling import chain, density, sampler as sampling

ENDLESS = ("--effective", "100000000", "--max-steps", "1000000")


def finished(process):
    out, err = process.communicate(timeout=200)
    return process.returncode, out, err


def assert_same(one, other):
    for name in ("values", "log_posterior", "accepted"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert one.subject == other.subject
    assert (one.discarded, one.mostly_ridge) == (other.discarded, other.mostly_ridge)
    for mine, its in zip(one.random_state, other.random_state, strict=True):
        np.testing.assert_array_equal(mine, its)


def snapshot(folder):
    return {file.name: file.read_bytes() for file in folder.iterdir()}


@pytest.mark.slow
@pytest.mark.parametrize("blow", [signal.SIGINT, signal.SIGKILL])
def test_a_process_struck_in_mid_sampling_goes_on_as_if_nothing_had_been(
    tmp_path, blow
):
    struck = tmp_path / "struck"
    unbroken = tmp_path / "whole"
    fit = ("fit", DATA, "--no-figures", "--seed", 5)
    process = started(*fit, *ENDLESS, "--out", struck)
    until = time.monotonic() + 300
    while process.poll() is None:
        assert time.monotonic() < until, "the chain has not grown"
        # Moved into place whole, so that it can be read at any moment.
        if (struck / "chain.h5").exists() and len(
            load_chain(struck / "chain.h5").values
        ) > 3:
            break
        time.sleep(0.05)
    time.sleep(0.3)
    process.send_signal(blow)
    status, out, err = finished(process)
    assert status in (0, -blow), err
    left = load_chain(struck / "chain.h5")
    record = load_fit(struck)
    assert {file.name for file in struck.iterdir()} >= {"fit.json", "chain.h5"}
    if blow == signal.SIGKILL:
        assert (status, out, err) == (-signal.SIGKILL, "", "")
        assert record.posterior is None
        assert record.sampling == "unfinished"
    else:
        assert status == 0
        assert "stopped by the user" in err
        assert not record.posterior.converged
        assert record.posterior.samples == len(left.flat)
    status, out, err = command("show", struck, cwd=tmp_path)
    assert (status, err) == (0, "")
    if blow == signal.SIGKILL:
        shown = " ".join(out.split())
        assert "Posterior: not finished: " in shown
        assert f" {len(left.values)} steps)" in shown
        assert "with --resume to continue it" in shown

    more = ("--effective", "100000000", "--max-steps", max(40, len(left.values) + 1))
    status, _, err = command(*fit, *more, "--out", struck, "--resume", cwd=tmp_path)
    assert status == 0, err
    status, _, err = command(*fit, *more, "--out", unbroken, cwd=tmp_path)
    assert status == 0, err
    once = load_chain(unbroken / "chain.h5")
    assert len(once.values) > len(left.values)
    np.testing.assert_array_equal(once.values[: len(left.values)], left.values)
    assert_same(load_chain(struck / "chain.h5"), once)
    assert (struck / "fit.json").read_bytes() == (unbroken / "fit.json").read_bytes()


RUN = {"effective": 1e9, "most_steps": 60, "seed": 2}


@pytest.fixture(scope="module")
def short(eq12_fit):
    """A run of a few blocks."""
    return sample(eq12_fit, **RUN)


def stopped_at_call(number, monkeypatch):
    """Ctrl-C within the posterior's evaluation of that number."""
    calls = []
    real = density.log_posterior

    def stopping(*arguments):
        calls.append(1)
        if len(calls) == number:
            raise KeyboardInterrupt
        return real(*arguments)

    monkeypatch.setattr(density, "log_posterior", stopping)


@pytest.mark.parametrize("call", [16, 47, 66])
def test_ctrl_c_at_any_point_loses_no_step_and_adds_none(
    eq12_fit, short, tmp_path, monkeypatch, call
):
    file = tmp_path / "chain.h5"
    with monkeypatch.context() as patch:
        stopped_at_call(call, patch)
        _, part = sample(eq12_fit, **RUN, checkpoint=file)
    assert 4 <= len(part.values) < 60
    np.testing.assert_array_equal(part.values, short[1].values[: len(part.values)])
    assert np.isfinite(part.log_posterior).all()
    eq12_fit.save(tmp_path / "fit.json")
    result, again = sample(load_fit(tmp_path), **RUN, checkpoint=file, resume=True)
    assert_same(again, short[1])
    assert result.posterior == short[0].posterior


@pytest.mark.parametrize("steps", [10, pytest.param(30, marks=pytest.mark.slow)])
def test_the_change_of_moves_is_resumed_too(eq12_fit, tmp_path, monkeypatch, steps):
    # as though the ridge proposals failed: from the first block on, ensemble
    # moves do the work
    monkeypatch.setattr(sampling, "_LEAST_ACCEPTANCE", 2.0)
    result, unbroken = sample(eq12_fit, **RUN)
    assert "most proposals were ensemble moves" in result.posterior.status
    file = tmp_path / "chain.h5"
    done = []
    real = sampling.Run.write_if_due

    def crash(run, file):
        run._next_write = 0
        real(run, file)
        done.append(run)
        if len(done) == steps:
            raise MemoryError

    with monkeypatch.context() as patch:
        patch.setattr(sampling.Run, "write_if_due", crash)
        with pytest.raises(MemoryError):
            sample(eq12_fit, **RUN, checkpoint=file)
    assert load_chain(file).mostly_ridge == (steps < 20)
    again, resumed = sample(eq12_fit, **RUN, checkpoint=file, resume=True)
    assert_same(resumed, unbroken)
    assert again.posterior == result.posterior


def test_a_run_that_ended_goes_on_with_more(eq12_fit, short, tmp_path):
    file = tmp_path / "chain.h5"
    # to resume nothing is a first run
    _, first = sample(
        eq12_fit, **RUN | {"most_steps": 20}, checkpoint=file, resume=True
    )
    assert len(first.values) == 20
    _, second = sample(eq12_fit, **RUN, checkpoint=file, resume=True)
    assert_same(second, short[1])
    before = file.read_bytes()
    _, third = sample(
        eq12_fit, effective=100, most_steps=10, seed=2, checkpoint=file, resume=True
    )
    assert_same(third, second)
    assert file.read_bytes() == before
    with pytest.raises(InputError, match="expected a checkpoint"):
        sample(eq12_fit, resume=True)


@pytest.fixture
def saved(eq12_fit, short, tmp_path):
    """A folder with an unfinished run of seed 2."""
    folder = tmp_path / "saved"
    folder.mkdir()
    begun = replace(eq12_fit, posterior=None, sampling="unfinished")
    begun.save(folder / "fit.json")
    short[1].save(folder / "chain.h5")
    return folder


def refused(folder, *words):
    before = snapshot(folder)
    seed = () if "--seed" in words else ("--seed", "2")
    words = ["fit", str(DATA), "--out", str(folder), "--resume", *seed, *words]
    error = invoke(words).exception
    assert isinstance(error, InputError)
    assert error.exit_status == 2
    assert snapshot(folder) == before
    return str(error)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--seed", "3"], "chain.h5: cannot be resumed: seed was 2, now 3"),
        (
            ["--law", "coulomb"],
            "fit.json: cannot be resumed: law was front-back, now coulomb",
        ),
        (["--until", "15"], "not the same data"),
        (["--sigma", "x=0.01"], "not the same data"),
        (
            ["--stone", "rho=0.11"],
            "stone was m = 20.0, R = 0.054, rho = 0.1, h = 0.057, now",
        ),
        (["--bound", "mu2_xi=0:0.3"], "bounds of mu2_xi was 0.0:1.0, now 0.0:0.3"),
        (["--fix", "mu1_xi=0"], "bounds of mu1_xi was 0.0:1.0, now 0.0:0.0"),
        (["--no-sample"], "--resume continues sampling"),
    ],
)
def test_a_chain_of_something_else_is_refused(saved, words, said):
    assert said in refused(saved, *words)


def test_a_chain_of_another_version_or_fit_is_refused(saved, monkeypatch):
    stored = load_chain(saved / "chain.h5")
    with monkeypatch.context() as patch:
        patch.setattr(chain, "__version__", "9.9")
        assert "version of curlfit was 0." in refused(saved)
    fit = load_fit(saved)
    moved = fit.parameters | {"v0": replace(fit.parameters["v0"], value=2.0)}
    replace(fit, parameters=moved).save(saved / "fit.json")
    assert "not the same least-squares result" in refused(saved)
    fit.save(saved / "fit.json")
    replace(stored, subject={}, random_state=None).save(saved / "chain.h5")
    assert "not the same data" in refused(saved)
    replace(stored, random_state=None).save(saved / "chain.h5")
    with pytest.raises(DataError, match="the sampler's state is not in it"):
        sample(fit, seed=2, checkpoint=saved / "chain.h5", resume=True)
    with h5py.File(saved / "chain.h5", "w") as earlier:
        earlier.create_group("mcmc")
    assert "not a chain.h5 of this version of curlfit" in refused(saved)
    (saved / "chain.h5").write_bytes(b"half a file")
    assert "sample again with `curlfit fit FILE`, without --resume" in refused(saved)


def test_a_law_s_file_that_changed_makes_another_subject(
    eq12_fit, tmp_path, monkeypatch
):
    file = tmp_path / "law.py"
    monkeypatch.setattr(eq12_fit.law_class, "origin", f"{file}:Mine")
    file.write_text("mu = 1")
    before = chain.subject_of(eq12_fit, 0)
    chain.require_same(before, chain.subject_of(eq12_fit, 0), file)
    file.write_text("mu = 2")
    with pytest.raises(DataError, match="not the same law's file"):
        chain.require_same(before, chain.subject_of(eq12_fit, 0), file)


def test_an_unfinished_run_is_shown_and_drawn(saved, tmp_path):
    (saved / "chain.h5").rename(tmp_path / "chain.h5")
    status, out, err = command("show", saved, cwd=tmp_path)
    assert (status, err) == (0, "")
    assert "Sampling is unfinished" in out
    assert "Posterior:" not in out
    (tmp_path / "chain.h5").rename(saved / "chain.h5")
    status, out, _ = command("show", saved, "--json", cwd=tmp_path)
    record = json.loads(out)
    assert record["sampling"] == "unfinished"
    assert record["posterior"]["converged"] is False
    assert record["posterior"]["status"].startswith("not finished: ")
    status, out, err = command("plot", saved, "--out", tmp_path / "p", cwd=tmp_path)
    assert (status, err) == (0, "")
    assert (tmp_path / "p" / "corner.png").stat().st_size > 10_000


def test_a_disk_that_fills_up_while_sampling(tmp_path):
    fit = ("fit", DATA, "--no-figures", "--effective", 100_000_000, "--out", tmp_path)
    status, out, err = finished(started(*fit, room=100_000))
    assert (status, out) == (2, "")
    assert err == f"curlfit: {tmp_path}/chain.h5: cannot be written (File too large)\n"
    left = load_chain(tmp_path / "chain.h5")
    assert load_fit(tmp_path).sampling == "unfinished"
    assert sorted(os.listdir(tmp_path)) == ["chain.h5", "fit.json"]
    status, _, err = command(*fit, "--max-steps", 40, "--resume", cwd=tmp_path)
    assert status == 0, err
    again = load_chain(tmp_path / "chain.h5")
    assert len(again.values) == 40
    np.testing.assert_array_equal(again.values[: len(left.values)], left.values)
