"""What the README tells to type is typed here, as it stands."""

from __future__ import annotations

import re
import shutil
from concurrent.futures import ThreadPoolExecutor

import pytest
from transcripts import ROOT, blocks, require_shown, run, typed, without_gaps

README = (ROOT / "README.md").read_text()
BASH = [line for lines, _ in blocks(README) for line in lines]
# These are done by .ci/run, each in an environment that has nothing yet.
NOT_HERE = tuple(
    re.search(rf"<!-- {name} -->\n```bash\n(.*)\n```", README)[1] for name in ("fit", "tests")
)
MAIN = "curlfit fit data/jensen_shegelski_2004.csv"
PYTHON = re.findall(r"```python\n(.*?)```", README, re.S)
FIRST = tuple(
    f"curlfit {verb} " for verb in ("fit", "simulate", "batch", "predict", "profile", "export")
)
TABLE = re.search(r"A text table with a header:\n\n```text\n(.*?)```", README, re.S)[1]
INLINE = re.findall(r"`(curlfit(?: [^`]+))`", README)


@pytest.fixture(scope="module")
def clone(tmp_path_factory):
    """What a clone has beside the program."""
    folder = tmp_path_factory.mktemp("clone")
    shutil.copytree(ROOT / "data", folder / "data")
    return folder


def test_every_block_of_commands_is_known():
    assert set(NOT_HERE) < set(BASH)
    assert len(BASH) == len(set(BASH)) >= 6
    assert NOT_HERE[0].endswith(f"/{MAIN}")
    assert all(line.startswith("curlfit ") for line in BASH if line not in NOT_HERE)


@pytest.fixture(scope="module")
def printed(clone):
    """What each command of the blocks prints, in one folder."""
    lines = [MAIN, *(line for line in BASH if line not in NOT_HERE)]
    # a fit may resume another, or read what was simulated before
    first = [line for line in lines if line.startswith(FIRST)]
    jobs = [first, *[[line] for line in lines if line not in first]]
    with ThreadPoolExecutor(2) as pool:
        done = pool.map(lambda job: {line: typed(line, clone) for line in job}, jobs)
        return {line: text for part in done for line, text in part.items()}


def shown(command, after):
    """The lines of the README's text block after a command, without the gaps."""
    rest = README[README.index(f"{command}\n```") :]
    block = re.search(r"```text\n(.*?)```", rest[: rest.index(after)], re.S)[1]
    return without_gaps(block)


@pytest.mark.parametrize(
    ("command", "after"),
    [
        (MAIN, "The first run on a machine"),
        ("curlfit profile jensen_shegelski_2004-fit --param mu1_xi", "What the path does not"),
        ("curlfit compare data/jensen_shegelski_2004.csv --load both", "That is the paper's"),
        ("curlfit predict jensen_shegelski_2004-fit --to-tee", "![The path on the sheet"),
        ("curlfit design", "- **Uniform load**"),
        ("--no-sample --out with-a-prior", "Coefficients and the initial state"),
        ("--free slope_x --out both-spins", "In Python: `curlfit.fit("),
        ("curlfit predict first-12-s --check data/jensen_shegelski_2004.csv", "The parameters'"),
    ],
)
def test_the_commands_print_what_the_readme_shows(printed, command, after):
    (command,) = [line for line in printed if line.endswith(command)]
    require_shown(shown(command, after), printed[command])


def test_the_commands_write_what_the_readme_says(printed, clone):
    assert {file.name for file in (clone / "jensen_shegelski_2004-fit").iterdir()} == {
        "fit.json", "fit.png", "corner.png", "chain.h5",
    }  # fmt: skip
    assert {file.name for file in (clone / "jensen_shegelski_2004-compare").iterdir()} == {
        "compare.json", "compare.png",
    }  # fmt: skip
    assert {file.name for file in (clone / "jensen_shegelski_2004-predict").iterdir()} == {
        "predict.json", "predict.csv", "predict.png",
    }  # fmt: skip
    assert {file.name for file in (clone / "jensen_shegelski_2004-profile-mu1_xi").iterdir()} == {
        "profile.json", "profile.png",
    }  # fmt: skip
    assert {"claims.json", "claims.md"} < {file.name for file in (clone / "reproduction").iterdir()}
    assert "Posterior: converged" in " ".join(printed[RESUME].split())


def test_what_it_would_take_is_printed_as_the_readme_has_it(printed):
    """The block does not follow its command."""
    (line,) = [line for line in BASH if "--load consistent --out" in line]
    (text,) = re.findall(r"```text\n(mu1_eta is hardly.*?)```", README, re.S)
    assert " ".join(text.split()) in " ".join(printed[line].split())


RESUME = next(line for line in BASH if line.endswith("--resume"))


@pytest.mark.parametrize("line", sorted(set(INLINE)))
def test_commands_within_sentences(printed, clone, line):
    folders = [f"jensen_shegelski_2004-{kind}" for kind in ("fit", "compare", "predict")]
    folders.append("jensen_shegelski_2004-profile-mu1_xi")
    for folder in folders if "DIR" in line else [""]:
        assert typed(re.sub(r"\bDIR\b", folder, line), clone) != ""


def test_commands_within_sentences_are_found():
    assert set(INLINE) >= {
        "curlfit laws", "curlfit show DIR", "curlfit plot DIR --format pdf", "curlfit simulate",
        "curlfit fit --help",
    }  # fmt: skip


@pytest.mark.parametrize("block", PYTHON)
def test_python(block, tmp_path):
    shutil.copytree(ROOT / "data", tmp_path / "data")
    if "curlfit.sample(" in block:
        # in the next sentence, of what the block has defined
        (line,) = re.findall(r"`(curlfit\.sample\([^`]*\))`", README)
        block += f"again = {line}[1], {line}[1]\n"
        block += "assert all((one.values == chain.values).all() for one in again)\n"
    (tmp_path / "block.py").write_text(block)
    found = run(["-W", "error", "block.py"], tmp_path)
    assert (found.returncode, found.stderr) == (0, "")
    assert ("curlfit.sample(" in block) == (tmp_path / "chain.h5").exists()


def test_the_table_of_one_s_own_data_is_read(tmp_path):
    from curlfit import load_throw

    (tmp_path / "own.csv").write_text(TABLE)
    throw = load_throw(tmp_path / "own.csv")
    assert throw.defaults == {"until": 18, "stone": {"R": 0.0625}}
    assert throw.x.tolist() == [0.001, 0.001]
    assert throw.y[1] == pytest.approx(0.27 * 0.3048)
    assert throw.phi[1] == pytest.approx(5.2 * 3.141592653589793 / 180)
