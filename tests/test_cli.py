"""The command as a process: what the README promises, and every refusal."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import DATA

from curlfit import load_chain, load_fit, load_throw

PNG = b"\x89PNG\r\n\x1a\n"


def curlfit(*words: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "curlfit", *map(str, words)],
        cwd=cwd, capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    folder = tmp_path_factory.mktemp("main")
    return folder, curlfit("fit", DATA, "--out", "fit", cwd=folder)


def test_the_main_command_reports_what_it_must(done):
    _, run = done
    assert run.returncode == 0, run.stderr
    assert run.stderr == ""
    for words in (
        "mu1_xi", "eq. 28", "0.058", "not identifiable", "mu1_eta + mu2_eta",
        "Only mu1_eta + mu2_eta is determined", "Posterior: converged", "residuals are smooth",
        "Converged",
    ):  # fmt: skip
        assert words in run.stdout, words


def test_the_main_command_writes_what_it_must(done):
    folder, _ = done
    assert sorted(file.name for file in (folder / "fit").iterdir()) == [
        "chain.h5", "corner.png", "fit.json", "fit.png",
    ]  # fmt: skip
    for name in ("fit.png", "corner.png"):
        assert (folder / "fit" / name).read_bytes().startswith(PNG)
    record = json.loads((folder / "fit" / "fit.json").read_text())
    assert record["schema"] == 1
    assert record["stone"] == {"m": 20.0, "R": 0.054, "rho": 0.1, "h": 0.057}
    assert record["n_observations"] == 603
    for name in ("mu1_eta", "mu2_eta"):
        assert record["parameters"][name]["verdict"] == "not identifiable"
        assert record["parameters"][name]["stderr"] is None
    (one,) = record["combinations"]
    assert one["expression"] == "mu1_eta + mu2_eta"
    assert abs(one["value"] - 0.0173) < 0.0004
    posterior = record["posterior"]
    assert posterior["correlation"]["mu1_eta"]["mu2_eta"] < -0.99
    assert set(posterior["quantiles"]["mu1_xi"]) == {"2.5", "16", "50", "84", "97.5"}
    assert min(posterior["ess"].values()) > 2000
    chain = load_chain(folder / "fit" / "chain.h5")
    assert len(chain.flat) == posterior["samples"]


def test_saved_results_are_shown_and_drawn_again(done):
    folder, run = done
    again = curlfit("show", "fit", cwd=folder)
    assert again.returncode == 0
    assert again.stdout == run.stdout[: run.stdout.index("Written:")]
    assert json.loads(curlfit("show", "fit", "--json", cwd=folder).stdout)["law"] == "front-back"
    drawn = curlfit("plot", "fit", "--out", "pictures", "--format", "pdf", cwd=folder)
    assert drawn.returncode == 0, drawn.stderr
    for name in ("fit.pdf", "corner.pdf"):
        assert (folder / "pictures" / name).read_bytes().startswith(b"%PDF")


def test_a_simulated_throw_comes_back(tmp_path):
    made = curlfit(
        "simulate", "--law", "front-back", "--set", "mu2_xi=0.06,mu1_eta=0.011", "--v0", 2.1,
        "--omega0", -1.3, "--heading", 0.03, "--until", 22, "--dt", 0.1, "--noise-xy", 0.005,
        "--noise-phi", 0.01, "--seed", 7, "--stone", "R=0.06", "--out", "a.csv", cwd=tmp_path,
    )  # fmt: skip
    assert made.returncode == 0, made.stderr
    throw = load_throw(tmp_path / "a.csv")
    assert len(throw) == 221
    assert throw.reference.values["mu2_xi"] == 0.06
    run = curlfit("fit", "a.csv", "--no-sample", "--no-figures", "--quiet", cwd=tmp_path)
    assert (run.returncode, run.stdout, run.stderr) == (0, "", "")
    result = load_fit(tmp_path / "a-fit")
    assert result.stone.R == 0.06
    true = {"mu1_xi": 0.005, "mu2_xi": 0.06, "v0": 2.1, "omega0": -1.3, "heading": 0.03}
    for name, value in true.items():
        item = result.parameters[name]
        assert abs(item.value - value) < 4 * item.stderr, name
    (one,) = result.combinations
    assert abs(one.value - 0.020) < 4 * one.stderr
    assert [file.name for file in (tmp_path / "a-fit").iterdir()] == ["fit.json"]


def test_flags_override_the_configuration_and_that_the_file(tmp_path):
    (tmp_path / "c.toml").write_text("until = 15\n[stone]\nR = 0.06\n[bound]\nmu1_xi = [0, 0.5]\n")
    run = curlfit(
        "fit", DATA, "--config", "c.toml", "--stone", "R=0.055", "--no-sample", "--out", "o",
        "--no-figures", cwd=tmp_path,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    result = load_fit(tmp_path / "o")
    assert (result.stone.R, result.stone.rho) == (0.055, 0.1)
    assert result.data["to"] == 15
    assert result.parameters["mu1_xi"].upper == 0.5


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["fit", "nothing.csv"], "nothing.csv: no such file"),
        (["fit", DATA, "--law", "ice"], "unknown law 'ice'"),
        (["fit", DATA, "--load", "heavy"], "expected uniform or consistent"),
        (["fit", DATA, "--fix", "mu=1"], "no parameter 'mu'"),
        (["fit", DATA, "--fix", "mu1_xi"], "expected NAME=VALUE"),
        (["fit", DATA, "--fix", "mu1_xi=a"], "expected a number"),
        (["fit", DATA, "--bound", "mu1_xi=1:0"], "is empty"),
        (["fit", DATA, "--bound", "mu1_xi=1"], "expected NAME=LOW:HIGH"),
        (["fit", DATA, "--start", "q=1"], "no parameter 'q'"),
        (["fit", DATA, "--stone", "R=-0.05"], "stone.R = -0.05 m: expected a positive"),
        (["fit", DATA, "--stone", "q=1"], "no property 'q'"),
        (["fit", DATA, "--sigma", "x=0"], "expected a positive number"),
        (["fit", DATA, "--until", "-3"], "before the first row"),
        (["fit", DATA, "--until", "0.5"], "6 rows for 10 parameters"),
        (["fit", DATA, "--out", DATA], "this is a file, expected a folder"),
        (["fit", DATA, "--out", "/proc/nothing"], "output folder cannot be written"),
        (["fit", DATA, "--config", "no.toml"], "no.toml: no such file"),
        (["fit", DATA, "--nonsense"], "No such option"),
        (["show", "nothing"], "no such file"),
        (["plot", "nothing"], "no such file"),
        (["simulate", "--set", "mu=1"], "no coefficient 'mu'"),
        (["simulate", "--dt", "0"], "dt = 0: expected a positive number"),
        (["simulate", "--out", "no/where.csv"], "does not exist"),
    ],
)
def test_refusals(words, said, tmp_path):
    run = curlfit(*words, cwd=tmp_path)
    assert run.returncode == 2
    assert said in " ".join(run.stderr.replace("│", " ").split())
    assert "Traceback" not in run.stderr
    assert run.stdout == ""
    assert list(tmp_path.iterdir()) == []


def test_a_refused_fit_leaves_earlier_results_alone(done, tmp_path):
    folder, _ = done
    before = {file.name: file.read_bytes() for file in (folder / "fit").iterdir()}
    bad = tmp_path / "bad.csv"
    bad.write_text(DATA.read_text().replace("0.205793511", "hello"))
    run = curlfit("fit", bad, "--out", folder / "fit", cwd=folder)
    assert run.returncode == 2
    assert run.stderr.startswith(f"curlfit: {bad}, line 13, column y: 'hello' found")
    assert {file.name: file.read_bytes() for file in (folder / "fit").iterdir()} == before


def test_help_and_refusals_load_no_jax(tmp_path):
    code = (
        "import sys; sys.argv[1:] = {words!r}\n"
        "from curlfit.cli import main\n"
        "try:\n    main()\nexcept SystemExit:\n    pass\n"
        "assert 'jax' not in sys.modules and 'matplotlib' not in sys.modules\n"
    )
    for words in (["--help"], ["fit", "--help"], ["fit", str(DATA), "--law", "ice"], ["laws"]):
        run = subprocess.run(
            [sys.executable, "-c", code.format(words=words)],
            cwd=tmp_path, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert run.returncode == 0, run.stderr


def test_laws(tmp_path):
    text = curlfit("laws", cwd=tmp_path).stdout
    listed = json.loads(curlfit("laws", "--json", cwd=tmp_path).stdout)
    assert {law["name"] for law in listed} >= {"front-back", "coulomb", "front-back-first-order"}
    for law in listed:
        assert law["name"] in text
        assert law["source"] in text
        for item in law["coefficients"]:
            assert item["meaning"] in text
            assert np.isfinite([item["lower"], item["upper"], item["default"]]).all()


def test_version(tmp_path):
    assert curlfit("--version", cwd=tmp_path).stdout.startswith("curlfit 0.")
