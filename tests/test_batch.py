"""Many throws: the same answers as one by one, in a table that survives a kill."""

from __future__ import annotations

import csv
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from conftest import command
from distributed import Client, LocalCluster

import curlfit
from curlfit import FitResult, Stone, Throw
from curlfit.batch import fit_files, fit_throws
from curlfit.plan import Plan
from curlfit.synthetic import law_with, synthetic_throw, write_table

STONE = Stone(R=0.054)


@pytest.fixture(scope="module")
def season(tmp_path_factory):
    """Six throws, two of them without an angle or long at rest, and two files of no use."""
    folder = tmp_path_factory.mktemp("season")
    random = np.random.default_rng(3)
    for place in range(6):
        law = law_with(
            "front-back",
            {"mu1_xi": 0.0006, "mu2_xi": 0.055 * random.uniform(0.8, 1.2), "mu1_eta": 0.0085},
        )
        throw = synthetic_throw(
            law, STONE, v0=random.uniform(1.9, 2.3), omega0=random.choice([-1.5, 1.2]),
            heading=0.02, until=28.0 if place == 1 else 20.0, dt=0.2, noise_xy=0.005,
            noise_phi=0.01, seed=place,
        )  # fmt: skip
        text = write_table(throw)
        if place == 2:
            text = "\n".join(
                line if line.startswith("#") else ",".join(line.split(",")[:3])
                for line in text.splitlines()
            )
        (folder / f"throw{place}.csv").write_text(text)
    (folder / "broken.csv").write_text("t,x,y,phi\n0,0,0,0\n1,a,b,c\n")
    (folder / "still.csv").write_text("t,x,y\n" + "".join(f"{k},1,2\n" for k in range(30)))
    (folder / "notes.md").write_text("not a throw")
    return folder


def table(file):
    with file.open() as lines:
        return list(csv.DictReader(line for line in lines if not line.startswith("#")))


def test_each_row_is_the_fit_of_that_throw(season):
    files = sorted(season.glob("*.csv"))
    for row in fit_files(files, Plan()):
        if row["status"] == "failed":
            continue
        alone = curlfit.fit(curlfit.load_throw(row["file"]))
        assert row["status"] == ("ok" if alone.converged else "not usable")
        for name, item in alone.parameters.items():
            assert row[f"{name}_verdict"] == item.verdict, (row["file"], name)
            scale = item.stderr or 1e-3
            assert row[name] == pytest.approx(item.value, abs=1e-3 * scale + 1e-7), name
            if item.stderr is not None:
                assert row[f"{name}_stderr"] == pytest.approx(item.stderr, rel=1e-3), name
        assert row["rms_y"] == pytest.approx(alone.rms["y"], rel=1e-6)


def mixed():
    """Throws with gaps, without an angle, with some sigma, with speeds, and short."""
    law = law_with("front-back", {"mu1_xi": 6e-4, "mu2_xi": 0.055, "mu1_eta": 0.0087})
    whole = synthetic_throw(
        law, STONE, v0=2.1, omega0=-1.3, noise_xy=0.005, noise_phi=0.01, seed=7, dt=0.2
    )
    t, x, y, phi = whole.t, whole.x, whole.y, whole.phi
    gaps = np.where(np.random.default_rng(1).random(len(t)) < 0.3, np.nan, x)
    speed, omega = np.hypot(np.gradient(x, t), np.gradient(y, t)), np.gradient(phi, t)
    return {
        "gaps": Throw.from_arrays(t, gaps, y, phi),
        "no angle": Throw.from_arrays(t, x, y),
        "one sigma": Throw.from_arrays(t, x, y, phi, sigma={"x": 0.005}),
        "all sigmas": Throw.from_arrays(t, x, y, phi, sigma={"x": 0.005, "y": 0.005, "phi": 0.01}),
        "radar": Throw.from_arrays(t, x, y, phi, speed=speed),
        "no place": Throw.from_arrays(t, speed=speed, omega=omega),
        "short": Throw.from_arrays(t[:12], x[:12], y[:12], phi[:12]),
    }


def test_throws_of_every_kind_side_by_side_are_fitted_as_alone():
    throws = mixed()
    for (kind, throw), found in zip(
        throws.items(), fit_throws(throws.values(), Plan()), strict=True
    ):
        alone = curlfit.fit(throw)
        assert isinstance(found, FitResult), (kind, found)
        assert found.rank == alone.rank, kind
        assert found.warnings == alone.warnings, kind
        for name, item in alone.parameters.items():
            assert found.parameters[name].verdict == item.verdict, (kind, name)
            if item.stderr is not None:
                off = found.parameters[name].value - item.value
                assert abs(off) < 1e-3 * item.stderr, (kind, name)
                assert found.parameters[name].stderr == pytest.approx(item.stderr, rel=1e-3)


def test_company_changes_not_a_digit(season):
    files = sorted(season.glob("throw*.csv"))
    together = fit_files(files, Plan())
    for file, row in zip(files, together, strict=True):
        assert fit_files([file], Plan()) == [row]
    assert fit_files(files[::-1], Plan()) == together[::-1]


def test_a_useless_file_is_a_row_with_its_reason(season):
    rows = {row["file"]: row for row in fit_files(sorted(season.glob("*.csv")), Plan())}
    broken, still = (rows[str(season / name)] for name in ("broken.csv", "still.csv"))
    assert broken["status"] == still["status"] == "failed"
    assert "line 3" in broken["reason"]
    assert "move" in still["reason"]
    assert broken["mu1_xi"] is None
    assert sum(row["status"] == "ok" for row in rows.values()) >= 5


def test_a_table_cut_off_anywhere_is_completed_to_the_same_bytes(season, tmp_path):
    out = tmp_path / "results.csv"
    words = ["batch", str(season), "--out", str(out), "--workers", "1"]
    first = command(*words, cwd=tmp_path)
    assert first.returncode == 0, first.stderr
    assert "2 failed" in first.stdout
    whole = out.read_bytes()
    assert len(table(out)) == 8
    for size in (10, len(whole) // 2, len(whole) - 3):
        out.write_bytes(whole[:size])
        assert command(*words, cwd=tmp_path).returncode == 0
        assert out.read_bytes() == whole
    assert "8 of 8 throws" in command(*words, cwd=tmp_path).stdout


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--law", "fricton"], "unknown law 'fricton'"),
        (["--load", "even"], "even"),
        (["--fix", "mu=1"], "mu"),
        (["--stone", "R=-1"], "R"),
        (["--law", "coulomb"], "line 1: made with other settings"),
    ],
)
def test_what_cannot_be_done_is_one_sentence(season, tmp_path, words, said):
    out = tmp_path / "results.csv"
    if "coulomb" in words:
        out.write_text('# curlfit batch {"law": "front-back"}\nfile,status\n')
    before = out.read_bytes() if out.exists() else None
    done = command("batch", str(season), "--out", str(out), *words, cwd=tmp_path)
    assert done.returncode == 2
    assert said in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert (out.read_bytes() if out.exists() else None) == before


def test_a_table_of_something_else_is_left_alone(season, tmp_path):
    out = tmp_path / "results.csv"
    out.write_text("my own notes\n")
    done = command("batch", str(season), "--out", str(out), cwd=tmp_path)
    assert done.returncode == 2
    assert "not a table of `curlfit batch`" in done.stderr
    assert out.read_text() == "my own notes\n"


def test_nothing_found_is_said(tmp_path):
    done = command("batch", str(tmp_path), "--out", str(tmp_path / "r.csv"), cwd=tmp_path)
    assert done.returncode == 2
    assert "no file that ends in .csv" in done.stderr


@pytest.mark.slow
def test_whoever_does_the_work_the_table_is_the_same(season, tmp_path):
    texts = []
    for words in (["--workers", "1"], ["--workers", "2"], ["--dask", "local", "--workers", "2"]):
        out = tmp_path / "results.csv"
        done = command("batch", str(season), "--again", "--out", str(out), *words, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        texts.append(out.read_bytes())
    assert texts[0] == texts[1] == texts[2]


@pytest.fixture
def many(season, tmp_path):
    """A folder of 400 copies of a throw."""
    folder = tmp_path / "many"
    folder.mkdir()
    text = (season / "throw0.csv").read_text()
    for place in range(400):
        (folder / f"{place:04d}.csv").write_text(text)
    return folder


@pytest.mark.slow
def test_a_killed_worker_costs_no_throw(many, tmp_path):
    out, alone = tmp_path / "results.csv", tmp_path / "alone.csv"
    words = [sys.executable, "-m", "curlfit", "batch", many]
    with (
        LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        Client(cluster) as client,
    ):
        run = subprocess.Popen([*words, "--out", out, "--dask", cluster.scheduler_address])
        while run.poll() is None and (not out.exists() or out.stat().st_size < 20_000):
            time.sleep(0.02)
        assert run.poll() is None
        before = client.run(os.getpid)
        os.kill(next(iter(before.values())), signal.SIGKILL)
        assert run.wait() == 0
        assert set(client.run(os.getpid).values()) != set(before.values())
    assert subprocess.run([*words, "--out", alone, "--workers", "1"], check=False).returncode == 0
    assert out.read_bytes() == alone.read_bytes()
    assert [row["file"] for row in table(out)] == [str(file) for file in sorted(many.iterdir())]


@pytest.mark.slow
def test_a_killed_run_goes_on_without_repeating_or_losing_a_throw(many, tmp_path):
    out = tmp_path / "results.csv"
    words = [sys.executable, "-m", "curlfit", "batch", str(many), "--out", str(out)]
    run = subprocess.Popen(words, start_new_session=True)
    while run.poll() is None and (not out.exists() or out.stat().st_size < 20_000):
        time.sleep(0.02)
    os.killpg(run.pid, signal.SIGKILL)
    run.wait()
    assert subprocess.run(words, check=False).returncode == 0
    assert [row["file"] for row in table(out)] == [str(file) for file in sorted(many.iterdir())]
