"""The command: what the book promises."""

from __future__ import annotations

import json

import pytest
from conftest import DATA, command as curlfit, process, python
from sample_files import PIXELS, PLAIN, known_points

from curlfit import LAWS, load_chain, load_fit, load_throw

PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    folder = tmp_path_factory.mktemp("main")
    return folder, process("fit", DATA, "--out", "fit", cwd=folder)


def test_the_main_command_reports_and_writes_what_it_must(done):
    folder, run = done
    assert (run.returncode, run.stderr) == (0, "")
    for words in (
        "mu1_xi",
        "eq. 28",
        "0.058",
        "not identifiable",
        "mu1_eta + mu2_eta",
        "Only mu1_eta + mu2_eta is determined",
        "Posterior: converged",
        "no noise is that smooth",
        "Converged",
    ):
        assert words in run.stdout, words
    assert sorted(file.name for file in (folder / "fit").iterdir()) == [
        "chain.h5",
        "corner.png",
        "fit.json",
        "fit.png",
    ]
    for name in ("fit.png", "corner.png"):
        assert (folder / "fit" / name).read_bytes().startswith(PNG)
    record = json.loads((folder / "fit" / "fit.json").read_text())
    assert record["schema"] == 1
    assert record["stone"] == {"m": 20.0, "R": 0.054, "rho": 0.1, "h": 0.057}
    assert record["n_observations"] == 603
    for name in ("mu1_eta", "mu2_eta"):
        assert record["parameters"][name]["verdict"] == "not identifiable"
        assert record["parameters"][name]["stderr"] is None
    (combination,) = record["combinations"]
    assert combination["expression"] == "mu1_eta + mu2_eta"
    assert abs(combination["value"] - 0.0173) < 0.0004
    posterior = record["posterior"]
    assert posterior["correlation"]["mu1_eta"]["mu2_eta"] < -0.99
    assert set(posterior["quantiles"]["mu1_xi"]) == {"2.5", "16", "50", "84", "97.5"}
    assert min(posterior["ess"].values()) > 2000
    assert len(load_chain(folder / "fit" / "chain.h5").flat) == posterior["samples"]


def test_saved_results_are_shown_and_drawn_again(done):
    folder, run = done
    again = curlfit("show", "fit", cwd=folder)
    assert again.returncode == 0
    assert again.stdout == run.stdout[: run.stdout.index("Written:")]
    assert (
        json.loads(curlfit("show", "fit", "--json", cwd=folder).stdout)["law"]
        == "front-back"
    )
    drawn = curlfit("plot", "fit", "--out", "pictures", "--format", "pdf", cwd=folder)
    assert drawn.returncode == 0, drawn.stderr
    for name in ("fit.pdf", "corner.pdf"):
        assert (folder / "pictures" / name).read_bytes().startswith(b"%PDF")


def test_a_simulated_throw_comes_back(tmp_path):
    simulation = curlfit(
        "simulate",
        "--law",
        "front-back",
        "--set",
        "mu2_xi=0.06,mu1_eta=0.011",
        "--v0",
        2.1,
        "--omega0",
        -1.3,
        "--heading",
        0.03,
        "--until",
        22,
        "--dt",
        0.1,
        "--noise-xy",
        0.005,
        "--noise-phi",
        0.01,
        "--seed",
        7,
        "--stone",
        "R=0.06",
        "--out",
        "a.csv",
        cwd=tmp_path,
    )
    assert simulation.returncode == 0, simulation.stderr
    throw = load_throw(tmp_path / "a.csv")
    assert len(throw) == 221
    assert throw.reference.values["mu2_xi"] == 0.06
    run = curlfit(
        "fit", "a.csv", "--no-sample", "--no-figures", "--quiet", cwd=tmp_path
    )
    assert (run.returncode, run.stdout, run.stderr) == (0, "", "")
    result = load_fit(tmp_path / "a-fit")
    assert result.stone.R == 0.06
    true = {"mu1_xi": 0.005, "mu2_xi": 0.06, "v0": 2.1, "omega0": -1.3, "heading": 0.03}
    for name, value in true.items():
        estimate = result.parameters[name]
        assert abs(estimate.value - value) < 4 * estimate.stderr, name
    (combination,) = result.combinations
    assert abs(combination.value - 0.020) < 4 * combination.stderr
    assert [file.name for file in (tmp_path / "a-fit").iterdir()] == ["fit.json"]


def test_help_and_refusals_load_no_jax(tmp_path):
    commands = (
        ["--help"],
        ["fit", "--help"],
        ["check", "--help"],
        ["reproduce", "--help"],
        ["fit", str(DATA), "--law", "ice"],
        ["laws"],
        ["check", str(DATA)],
        ["check", str(DATA), "--axes", "q"],
        ["reproduce", f"--out={DATA}"],
    )
    code = (
        "import sys\n"
        "from curlfit.cli import main\n"
        f"for words in {commands!r}:\n"
        "    sys.argv[1:] = words\n"
        "    try:\n        main()\n    except SystemExit:\n        pass\n"
        "    assert 'jax' not in sys.modules and 'matplotlib' not in "
        "sys.modules, words\n"
        "    assert 'numpy' not in sys.modules or '--help' not in words, words\n"
    )
    run = python("-c", code, cwd=tmp_path)
    assert run.returncode == 0, run.stderr
    assert run.stdout.count("Usage: ") == 4


def test_the_process_ends_with_the_status_of_the_command_and_all_it_printed(tmp_path):
    code = (
        "import sys, threading, time\n"
        "import curlfit.cli\n"
        "from curlfit.__main__ import run\n"
        "def main():\n"
        "    threading.Thread(target=lambda: (time.sleep(0.3), "
        "print('stored'))).start()\n"
        "    print('done')\n"
        "    sys.exit(2)\n"
        "curlfit.cli.main = main\n"
        "run()\n"
    )
    run = python("-c", code, cwd=tmp_path)
    assert (run.returncode, run.stdout, run.stderr) == (2, "done\nstored\n", "")


def test_check_shows_what_was_understood(tmp_path):
    (tmp_path / "points.csv").write_text(known_points())
    (tmp_path / "pixels.csv").write_text(PIXELS)
    run = curlfit(
        "check",
        "pixels.csv",
        "--reference",
        "points.csv",
        "--out",
        "c.png",
        cwd=tmp_path,
    )
    assert (run.returncode, run.stderr) == (0, "")
    for words in (
        "pixels.csv: table, 60 rows, t = 0 .. 14.75 s",
        "px",
        "interval",
        "0.25 s",
        "first row",
        "rest",
        "Notes",
        "pixels to metres by 6 points",
        "Written: c.png",
    ):
        assert words in run.stdout, words
    assert (tmp_path / "c.png").read_bytes().startswith(PNG)
    shown = curlfit("check", DATA, cwd=tmp_path)
    assert "until = 20" in shown.stdout


def test_how_to_read_may_stand_in_the_configuration(tmp_path):
    (tmp_path / "c.toml").write_text('units = "y=ft"\naxes = "clockwise"\n')
    (tmp_path / "a.csv").write_text(PLAIN)
    run = curlfit("check", "a.csv", "--config", "c.toml", cwd=tmp_path)
    assert "y converted from ft" in run.stdout
    assert "axes: clockwise" in run.stdout


def test_the_seed_may_stand_in_the_file_and_in_the_configuration(tmp_path):
    simulation = curlfit(
        "simulate", "--noise-xy", 0.005, "--out", "a.csv", cwd=tmp_path
    )
    assert simulation.returncode == 0
    (tmp_path / "a.csv").write_text("# seed = 5\n" + (tmp_path / "a.csv").read_text())
    (tmp_path / "c.toml").write_text("seed = 6\n")
    words = ("fit", "a.csv", "--effective", 100, "--no-figures")
    for more, seed in (
        ((), 5),
        (("--config", "c.toml"), 6),
        (("--config", "c.toml", "--seed", 0), 0),
    ):
        run = curlfit(*words, *more, "--out", f"of-{seed}", cwd=tmp_path)
        assert run.returncode == 0, run.stderr
        assert load_chain(tmp_path / f"of-{seed}" / "chain.h5").seed == seed
        assert load_fit(tmp_path / f"of-{seed}").posterior.seed == seed


def test_laws(tmp_path):
    text = " ".join(curlfit("laws", cwd=tmp_path).stdout.split())
    for law in (law for law in LAWS.values() if law.shipped()):
        for words in (
            law.name,
            law.source,
            *(coefficient.meaning for coefficient in law.coefficients()),
        ):
            assert words in text
