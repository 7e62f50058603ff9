"""Many throws: the same answers as one by one, in a table that survives a kill."""

from __future__ import annotations

import csv
import json
import os
import re
import signal
import time
from contextlib import suppress

import numpy as np
import psutil
import pytest
from conftest import DATA, command, process, started
from distributed import LocalCluster
from sample_files import log, shot, two_masses

import curlfit
from curlfit import Stone, UnusableFitError
from curlfit.batch.columns import names_of_columns
from curlfit.batch.fit_many import fit_files
from curlfit.batch.settings import BatchSettings
from curlfit.batch.table import GrowingTable
from curlfit.friction import LAWS
from curlfit.friction.family import family_of
from curlfit.friction.registry import laws_under
from curlfit.inference.model.model import Model
from curlfit.inference.sampling import sampler
from curlfit.inference.solve.initial_values import POINTS, accelerations_and_slopes
from curlfit.numerics.batches import stacked
from curlfit.throws.synthetic import law_with, synthetic_throw, write_table

STONE = Stone(R=0.054)
RING = family_of(law for law, _ in laws_under(None))


def empty_table(out):
    """A table of the usual settings without rows."""
    plan = BatchSettings.of()
    return GrowingTable(out, names_of_columns(plan), plan.recorded(), [])


@pytest.fixture(scope="module")
def season(tmp_path_factory):
    """Six throws, two of them without an angle or long at rest, and two
    files of no use."""
    folder = tmp_path_factory.mktemp("season")
    random = np.random.default_rng(3)
    for number in range(6):
        law = law_with(
            "front-back",
            {
                "mu1_xi": 0.0006,
                "mu2_xi": 0.055 * random.uniform(0.8, 1.2),
                "mu1_eta": 0.0085,
            },
        )
        throw = synthetic_throw(
            law,
            STONE,
            v0=random.uniform(1.9, 2.3),
            omega0=random.choice([-1.5, 1.2]),
            heading=0.02,
            until=28.0 if number == 1 else 20.0,
            dt=0.2,
            noise_xy=0.005,
            noise_phi=0.01,
            seed=number,
        )
        text = write_table(throw)
        if number == 2:
            text = "\n".join(
                line if line.startswith("#") else ",".join(line.split(",")[:3])
                for line in text.splitlines()
            )
        (folder / f"throw{number}.csv").write_text(text)
    (folder / "broken.csv").write_text("t,x,y,phi\n0,0,0,0\n1,a,b,c\n")
    (folder / "cannot.csv").write_text(
        "t,x,y\n" + "".join(f"{k},1,2\n" for k in range(30))
    )
    (folder / "notes.md").write_text("not a throw")
    return folder


def table(file):
    with file.open(newline="") as lines:
        return list(csv.DictReader(lines))


@pytest.fixture(scope="module")
def done(season, tmp_path_factory):
    """The season's table, and what the command said."""
    out = tmp_path_factory.mktemp("done") / "season.csv"
    run = command(
        "batch", str(season), "--out", str(out), "--workers", "1", cwd=out.parent
    )
    assert run.returncode == 0, run.stderr
    return out, run


@pytest.fixture
def logs(tmp_path):
    """A log of three shots, the second of which never moves, and an export of
    two objects."""
    folder = tmp_path / "logs"
    folder.mkdir()
    entries = [shot(0, k) for k in range(3)]
    entries[1]["log"]["trajectory"]["frames"].clear()
    (folder / "a.jsonl").write_text(
        "".join(json.dumps(entry) + "\n" for entry in entries)
    )
    (folder / "b.txt").write_text(two_masses())
    (folder / "c.jsonl").write_text(log(2))
    return folder


def test_each_row_is_the_fit_of_that_throw(season, done):
    """In plain CSV, with columns of what is determined together, and with reasons."""
    out, run = done
    rows = table(out)
    assert [row["file"] for row in rows] == [
        str(file) for file in sorted(season.glob("*.csv"))
    ]
    total = "mu1_eta + mu2_eta"
    for row in rows[2:]:
        alone = curlfit.fit(curlfit.load_throw(row["file"]), details=False)
        assert row["status"] == ("ok" if alone.converged else "not usable")
        for name, estimate in alone.parameters.items():
            assert row[f"{name}_verdict"] == estimate.verdict, (row["file"], name)
            scale = estimate.stderr or 1e-3
            assert float(row[name]) == pytest.approx(
                estimate.value, abs=1e-3 * scale + 1e-7
            ), name
            if estimate.stderr is not None:
                assert float(row[f"{name}_stderr"]) == pytest.approx(
                    estimate.stderr, rel=1e-3
                ), name
        assert float(row["rms_y"]) == pytest.approx(alone.rms["y"], rel=1e-5)
        (combination,) = (c for c in alone.combinations if c.expression == total)
        assert float(row[total]) == pytest.approx(combination.value, rel=1e-5)
        assert float(row[f"{total} stderr"]) == pytest.approx(
            combination.stderr, rel=1e-3
        )
        assert (
            f"{total} = {row[total]} +- {row[f'{total} stderr']}" in row["combinations"]
        )
    broken, still = rows[:2]
    # read, though
    assert (broken["status"], still["status"]) == ("failed", "not usable")
    assert "line 3" in broken["reason"]
    assert "move" in still["reason"]
    assert broken["mu1_xi"] == broken[total] == still[total] == ""
    warned = sum(row["status"] == "ok" and row["warnings"] != "" for row in rows)
    assert warned
    summary = (
        f"ok ({warned} with warnings, in the column of that name), "
        "1 not usable, 1 failed"
    )
    assert summary in run.stdout


def test_company_changes_not_a_digit(season):
    files = sorted(season.glob("throw*.csv"))
    together = fit_files(files, BatchSettings.of())
    assert fit_files(files[:1], BatchSettings.of()) == together[:1]
    assert fit_files(files[:1:-1], BatchSettings.of()) == together[:1:-1]


def test_a_table_cut_off_anywhere_is_completed_to_the_same_bytes(season, done):
    out, run = done
    words = ["batch", str(season), "--out", str(out), "--workers", "1"]
    complete = out.read_bytes()
    settings = out.with_name("season.settings.json").read_bytes()
    for size in (10, len(complete) // 2, len(complete) - 3):
        out.write_bytes(complete[:size])
        assert command(*words, cwd=out.parent).returncode == 0
        assert out.read_bytes() == complete
        assert out.with_name("season.settings.json").read_bytes() == settings
    again = command(*words, cwd=out.parent).stdout
    assert "8 of 8 files" in again
    assert run.stdout.splitlines()[-1] in again


@pytest.mark.parametrize("name", [name for name, law in LAWS.items() if law.shipped()])
def test_the_sums_that_laws_name_are_all_that_uniform_load_hides(name):
    """Against the null space of forces and moment over many motions and
    coefficients."""
    law = LAWS[name]
    random = np.random.default_rng(1)
    ranges = ((0.05, 4), (-20, 20), (0, 12), (0, 20))
    states = np.array([random.uniform(*ends, POINTS) for ends in ranges])
    names = [coefficient.name for coefficient in law.coefficients()]
    default, typical = np.array(
        [
            (coefficient.default, coefficient.typical)
            for coefficient in law.coefficients()
        ]
    ).T
    model = Model(law, "uniform").within(RING)
    columns = []
    for _ in range(3):
        values = default + typical * random.uniform(0.1, 0.5, len(names))
        some = values[None], typical, stacked([Stone()]), states[None], 1
        columns.append(
            accelerations_and_slopes(model, *some)[1].reshape(-1, len(names))
        )
    slopes = np.concatenate(columns) * typical
    _, size, rows = np.linalg.svd(slopes / np.abs(slopes).max(), full_matrices=False)
    hidden = rows[size < 1e-6 * size[0]]
    hidden = hidden[(np.abs(hidden) > 1e-3).sum(1) > 1]  # single ones are no sums
    assert len(hidden) == len(law.sums)
    for direction, parts in zip(hidden, law.sums, strict=True):
        expected = np.zeros(len(names))
        expected[[names.index(part) for part in parts]] = 1, -1
        assert abs(direction @ expected) == pytest.approx(np.sqrt(2), abs=1e-6)


def test_a_log_has_a_row_for_each_shot_and_an_export_one_for_each_object(logs):
    files = sorted(logs.iterdir())
    rows = fit_files(files, BatchSettings.of())
    assert [(row["file"][-7:], row["shot"], row["stone_index"]) for row in rows] == [
        ("a.jsonl", 1, None),
        ("a.jsonl", 2, None),
        ("a.jsonl", 3, None),
        ("s/b.txt", None, 1),
        ("s/b.txt", None, 2),
        ("c.jsonl", 1, None),
        ("c.jsonl", 2, None),
    ]
    assert rows[1]["status"] == "failed"
    assert rows[1]["reason"].endswith("no stone moves in end 0 shot 1")
    for row in (rows[0], rows[3], rows[-1]):
        which = {"shot": row["shot"], "stone_index": row["stone_index"]}
        alone = curlfit.fit(curlfit.load_throw(row["file"], **which), details=False)
        assert row["n_observations"] == alone.n_observations
        assert row["rms_y"] == pytest.approx(alone.rms["y"], rel=1e-3)
    assert fit_files(files[-1:], BatchSettings.of(shot=2)) == rows[-1:]


@pytest.mark.parametrize(
    ("names", "status", "said"),
    [
        (["throw0.csv", "broken.csv"], 0, ""),
        (["cannot.csv", "broken.csv"], 1, "no throw is usable; the column reason of"),
        (["broken.csv"], 2, "no throw could be read; the column reason of"),
    ],
)
def test_the_exit_status_tells_what_became_of_the_throws(
    season, tmp_path, names, status, said
):
    out = tmp_path / "r.csv"
    words = [
        "batch",
        *(str(season / name) for name in names),
        "--out",
        str(out),
        "--quiet",
        "--workers",
        "1",
    ]
    for _ in range(2):  # the second time with everything in the table
        run = command(*words, cwd=tmp_path)
        assert run.returncode == status
        assert said in run.stderr
        assert bool(run.stderr) == bool(said)
        assert run.stdout == ""
    assert len(table(out)) == len(names)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--load", "even"], "even"),
        (
            ["--law", "coulomb"],
            'made with other settings (law = "front-back", not "coulomb")',
        ),
    ],
)
def test_what_cannot_be_done_is_one_sentence(season, tmp_path, words, said):
    out = tmp_path / "results.csv"
    if "coulomb" in words:
        with empty_table(out):
            pass
        out.write_text(out.read_text() + "a.csv\n")
    before = {file: file.read_bytes() for file in tmp_path.iterdir()}
    done = command("batch", str(season), "--out", str(out), *words, cwd=tmp_path)
    assert done.returncode == 2
    assert said in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert {file: file.read_bytes() for file in tmp_path.iterdir()} == before


@pytest.mark.parametrize(
    ("files", "said"),
    [
        ({"r.csv": "my own notes\n"}, "r.csv, line 1: not a table of `curlfit batch`"),
        ({"r.csv": "file,shot,status\na.csv,,ok\n"}, "r.settings.json is missing"),
        (
            {"r.settings.json": '{"mine": 1}'},
            "r.settings.json: not the settings of a table",
        ),
        (
            {"r.settings.json": "{"},
            "r.settings.json: this is not JSON; expected the sett",
        ),
        ({}, "no file that ends in .csv"),
    ],
)
def test_what_is_not_a_table_of_batch_is_left_alone(season, tmp_path, files, said):
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    throws = season / "throw0.csv" if files else tmp_path
    done = command("batch", throws, "--out", tmp_path / "r.csv", cwd=tmp_path)
    assert done.returncode == 2
    assert said in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert {file.name: file.read_text() for file in tmp_path.iterdir()} == files


def test_rows_of_other_settings_are_begun_anew_with_again(season, tmp_path):
    words = [
        "batch",
        str(season / "throw0.csv"),
        "--out",
        str(tmp_path / "r.csv"),
        "--quiet",
        "--workers",
        "1",
    ]
    (tmp_path / "r.csv").write_text('# curlfit batch {"law": "coulomb"}\nfile,status\n')
    assert command(*words, "--again", cwd=tmp_path).returncode == 0
    first = (tmp_path / "r.csv").read_bytes()
    fixed = command(*words, "--again", "--fix", "mu1_eta=0.009", cwd=tmp_path)
    assert fixed.returncode == 0, fixed.stderr
    assert "mu1_eta + mu2_eta" not in table(tmp_path / "r.csv")[0]
    assert command(*words, cwd=tmp_path).returncode == 2
    assert command(*words, "--again", cwd=tmp_path).returncode == 0
    assert (tmp_path / "r.csv").read_bytes() == first


def test_two_batches_do_not_write_one_table(season, tmp_path):
    out = tmp_path / "results.csv"
    words = ("batch", season / "throw0.csv", "--workers", 1, "--quiet")
    with empty_table(out):
        before = out.read_bytes()
        for more in ((), ("--again",)):
            done = command(*words, *more, cwd=tmp_path)
            message = "results.csv: another `curlfit batch` is writing this table"
            assert (done.returncode, message in done.stderr) == (2, True)
            assert out.read_bytes() == before
    assert command(*words, cwd=tmp_path).returncode == 0


@pytest.mark.slow
def test_whoever_does_the_work_the_table_is_the_same(season, tmp_path):
    texts = []
    with LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None
    ) as cluster:
        crews = (
            ["--workers", "1"],
            ["--workers", "2"],
            ["--dask", cluster.scheduler_address],
        )
        for words in crews:
            out = tmp_path / "results.csv"
            done = process(
                "batch", str(season), "--again", "--out", str(out), *words, cwd=tmp_path
            )
            assert done.returncode == 0, done.stderr
            texts.append(out.read_bytes())
    assert texts[0] == texts[1] == texts[2]


@pytest.fixture
def many(season, tmp_path):
    """A folder of 400 copies of a throw."""
    folder = tmp_path / "many"
    folder.mkdir()
    text = (season / "throw0.csv").read_text()
    for number in range(400):
        (folder / f"{number:04d}.csv").write_text(text)
    return folder


@pytest.mark.parametrize(
    ("blow", "status", "said"),
    [
        (signal.SIGINT, 130, "curlfit: stopped\n"),
        (signal.SIGTERM, 143, "curlfit: stopped\n"),
        (signal.SIGKILL, -signal.SIGKILL, ""),
        (
            None,
            1,
            "curlfit: a process was killed, perhaps for lack of memory; "
            "0 of 400 files are in results.csv, and the same command continues\n",
        ),
    ],
    ids=["ctrl-c", "terminated", "killed", "a worker killed"],
)
def test_a_stopped_batch_ends_at_once_with_all_its_processes(
    many, tmp_path, blow, status, said
):
    run = started("batch", many, "--workers", 2, cwd=tmp_path)
    workers = []
    while run.poll() is None and len(workers) < 2:
        children = psutil.Process(run.pid).children(recursive=True)
        with suppress(psutil.NoSuchProcess):
            workers = [
                child
                for child in children
                if "--multiprocessing-fork" in child.cmdline()
            ]
        time.sleep(0.01)
    if blow == signal.SIGINT:
        os.killpg(run.pid, blow)  # as a terminal does
    elif blow:
        run.send_signal(blow)
    else:
        workers[0].kill()
    out, err = run.communicate(timeout=100)
    assert not psutil.wait_procs(children, timeout=20)[1]
    if blow == signal.SIGKILL:
        # a worker that was about to start: Python itself tells that its input ended
        err = re.sub(r"(?s)Traceback .*?EOFError: Ran out of input\n", "", err)
    assert (run.returncode, out, err) == (status, "", said)


def test_a_throw_whose_posterior_cannot_be_sampled_keeps_its_row(monkeypatch):
    def without_beginning(*_, **__):
        raise UnusableFitError("no point of finite posterior was found near the fit")

    monkeypatch.setattr(sampler, "sample", without_beginning)
    (row,) = fit_files([DATA], BatchSettings.of(posterior=True))
    assert row["status"] == "ok"
    assert row["mu2_xi"] == pytest.approx(0.0556, abs=1e-4)
    assert "no posterior: no point of finite posterior" in row["warnings"]
    assert row["mu2_xi_50"] is None
