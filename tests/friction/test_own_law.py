"""A law of the user's own, from a file, in every verb; and what is wrong with a
file, in words."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from conftest import command as curlfit

from curlfit import LAWS, find_law
from curlfit.errors import DataError, InputError
from curlfit.friction.checks import Check

PAGE = (Path(__file__).parents[2] / "notebooks" / "book" / "laws.md").read_text()
LAW = re.search(r"<!-- law -->\n```python\n(.*?)```", PAGE, re.S)[1]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("own")
    (folder / "my_law.py").write_text(LAW)
    run = curlfit(
        "simulate",
        "--law",
        "my_law.py:WetSide",
        "--set",
        "lean=0.4",
        "--noise-xy",
        "0.003",
        "--noise-phi",
        "0.01",
        "--out",
        "throw.csv",
        cwd=folder,
    )
    assert run.returncode == 0, run.stderr
    run = curlfit(
        "fit",
        "throw.csv",
        "--law",
        "my_law.py:WetSide",
        "--no-sample",
        "--out",
        "fit",
        cwd=folder,
    )
    assert run.returncode == 0, run.stderr
    return folder


def test_it_is_listed_fitted_shown_drawn_and_compared(folder):
    listed = curlfit("laws", "my_law.py:WetSide", cwd=folder)
    assert "excess on the right; within -1 .. 1, default 0.2" in listed.stdout
    record = json.loads((folder / "fit" / "fit.json").read_text())
    lean = record["parameters"]["lean"]
    assert abs(lean["value"] - 0.4) < 4 * lean["stderr"]
    assert "WetSide law" in curlfit("show", "fit", cwd=folder).stdout
    compared = curlfit(
        "compare",
        "throw.csv",
        "--laws",
        "coulomb,my_law.py:WetSide",
        "--out",
        "all",
        "--no-figures",
        cwd=folder,
    )
    assert compared.returncode == 0, compared.stderr
    best = json.loads((folder / "all" / "compare.json").read_text())["candidates"][0]
    assert (best["law"], best["isotropic"], best["follows"]) == ("WetSide", True, True)


NAMED = (
    "WetSide is not a law of curlfit, and a saved result does not run "
    "the file of its law"
)


def test_a_saved_fit_never_runs_the_file_of_its_law(folder, monkeypatch):
    monkeypatch.delitem(LAWS, "WetSide")  # as in another process
    ran = folder / "ran"
    (folder / "sly.py").write_text(f"open({str(ran)!r}, 'w')\n{LAW}")
    record = json.loads((folder / "fit" / "fit.json").read_text())
    record["data"]["law_file"] = str(folder / "sly.py:WetSide")
    (folder / "sent").mkdir()
    (folder / "sent" / "fit.json").write_text(json.dumps(record))
    for words in (
        ("show", "sent"),
        ("plot", "sent"),
        ("report", "sent"),
        ("export", "sent", "--to", "csv", "--to", "latex"),
    ):
        run = curlfit(*words, cwd=folder)
        assert (run.returncode, run.stderr) == (0, "")
    assert (folder / "sent" / "fit.png").stat().st_size > 10_000
    assert "--law=" in (folder / "sent" / "report.html").read_text()
    for words in (
        ("predict", "sent"),
        ("profile", "sent", "--param", "lean"),
        ("design", "--fit", "sent"),
        ("export", "sent", "--to", "game"),
        ("simulate", "--fit", "sent", "--out", "a.csv"),
    ):
        run = curlfit(*words, cwd=folder)
        assert run.returncode == 2
        assert run.stderr.startswith(
            f"curlfit: {NAMED}; name it with --law FILE.py:CLASS"
        )
        assert len(run.stderr.splitlines()) == 1
    assert not ran.exists()


def test_a_law_that_the_user_names_is_that_of_the_saved_fit(folder, monkeypatch):
    monkeypatch.delitem(LAWS, "WetSide")  # as in another process
    (folder / "again.py").write_text(LAW)
    run = curlfit(
        "simulate",
        "--fit",
        "fit",
        "--law=again.py:WetSide",
        "--out",
        "again.csv",
        cwd=folder,
    )
    assert (run.returncode, run.stderr) == (0, "")
    other = LAW.replace("lean", "tilt")
    assert other != LAW
    (folder / "other.py").write_text(other)
    for law, message in (
        (
            "coulomb",
            "--law coulomb: coulomb found, but the saved fit is of the law WetSide",
        ),
        ("other.py", "the law WetSide has the coefficients"),
        ("none.py", "none.py: no such file"),
    ):
        run = curlfit("predict", "fit", "--law", law, cwd=folder)
        assert (run.returncode, len(run.stderr.splitlines())) == (2, 1)
        assert run.stderr.startswith(f"curlfit: {message}")


def test_reading_data_runs_no_program(folder):
    (folder / "sly.csv").write_text(
        '# law = "my_law.py:WetSide"\nt,x,y\n0,0,0\n1,0,1\n'
    )
    run = curlfit("fit", "sly.csv", cwd=folder)
    assert run.returncode == 2
    assert "sly.csv, line 1: unknown law" in run.stderr


HEAD = "from curlfit import LocalLaw, coefficient\nclass A(LocalLaw):\n"
NET = (
    "from curlfit import NetLaw, coefficient\nclass A(NetLaw):\n"
    '    c: float = coefficient(0.1, "c")\n'
    "    def accelerations(self, motion, stone):\n"
)
MU = '    mu: float = coefficient(0.01, "mu")\n    def traction(self, point):\n'


TAKEN = "this is the name of an attribute of every law"
DRIVES = "drives the stone"


def declared(name, default=0.01):
    return f'{HEAD}    {name}: float = coefficient({default}, "")\n'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("class A(:\n", "line 1: invalid syntax; expected Python"),
        ("import nothing_of_the_kind\n", "line 1: ModuleNotFoundError"),
        (
            "x = 1\n",
            "expected one law class, or FILE.py:CLASS; derive one from "
            "curlfit.LocalLaw",
        ),
        (
            HEAD + "    mu: float = 3\n    def traction(self, point): ...\n",
            "A.mu: declare it as",
        ),
        (
            HEAD + '    name = "coulomb"\n' + MU + "        return 1, 2\n",
            "already; choose another",
        ),
        (HEAD + MU + "        return point.nothing, 2\n", "line 5: AttributeError"),
        (HEAD + MU + "        if point.xi > 0: return 1, 2\n", "line 5: ValueError"),
        (
            HEAD + MU + "        return -self.mu * point.e_xi\n",
            "2: (to the right, forward)",
        ),
        (
            HEAD + MU + "        return float('nan'), 0.0\n",
            "A with its defaults, at 2 m/s",
        ),
        (declared("mu"), "TypeError"),
        (declared("mu", -0.01), "A.mu: default -0.01 lies outside its bounds, 0 .. 1"),
        (declared("x0"), "A.x0: this is the name of a parameter of the initial state"),
        (declared("source"), f"A.source: {TAKEN}"),
        (declared("from_vector"), f"A.from_vector: {TAKEN}"),
        (
            HEAD + MU + "        return self.mu * point.e_xi, self.mu * point.e_eta\n",
            DRIVES,
        ),
        (
            NET + "        return 0.0, self.c, 0.0\n",
            "expected a force against the motion",
        ),
    ],
)
def test_what_is_wrong_is_said_with_its_place(text, message, tmp_path):
    file = tmp_path / "bad.py"
    file.write_text(text)
    before = dict(LAWS)
    with pytest.raises(DataError, match=re.escape(message)) as caught:
        find_law(str(file))
    assert str(file) in str(caught.value)
    assert before == LAWS


SLIDING = "        return -s * point.e_xi, -s * point.e_eta\n"


@pytest.mark.parametrize(
    ("wrong", "right"),
    [
        ("np.sqrt(point.speed)", "jnp.sqrt(point.speed)"),
        ("np.where(point.front > 0, 1, 2)", "jnp.where(point.front > 0, 1, 2)"),
        ("1 if self.mu > 0 else 2", "jnp.where(self.mu > 0, 1, 2)"),
        ("[1, 2][int(point.front[0])]", "2 - point.front"),
    ],
)
def test_a_law_that_cannot_be_compiled_is_told_of_jax_numpy(wrong, right, tmp_path):
    text = "import math\nimport numpy as np\nimport jax.numpy as jnp\n" + HEAD + MU
    for name, line in (("bad", wrong), ("good", right)):
        (tmp_path / f"{name}.py").write_text(
            f"{text}        s = self.mu * ({line})\n{SLIDING}"
        )
    with pytest.raises(
        DataError, match=r"line 8: a law is compiled.*jnp\.sqrt for np\.sqrt"
    ):
        find_law(str(tmp_path / "bad.py"))
    assert find_law(str(tmp_path / "good.py")).__name__ == "A"


def test_the_book_shows_what_is_said_of_a_jump_that_is_not_declared(tmp_path):
    text = re.search(r"<!-- edges -->\n```python\n(.*?)```", PAGE, re.S)[1]
    (tmp_path / "two_sides.py").write_text(text)
    listed = curlfit("laws", "two_sides.py", cwd=tmp_path)
    assert (listed.returncode, listed.stderr) == (0, "")
    (tmp_path / "undeclared.py").write_text(
        re.sub(r"    def edges.*?\n\n", "", text, flags=re.S)
    )
    refused = curlfit("laws", "undeclared.py", cwd=tmp_path)
    sentence = re.search(r"```text\n(TwoSides: .*?)\n```", PAGE, re.S)[1]
    assert refused.returncode == 2
    assert refused.stderr.startswith(f"curlfit: undeclared.py: {sentence}, which")
    assert len(refused.stderr.splitlines()) == 1


def test_a_law_that_drives_a_part_of_the_ring_is_warned_of(tmp_path, capsys):
    file = tmp_path / "own.py"
    file.write_text(
        HEAD + MU + "        return self.mu * point.e_xi, -self.mu * point.e_eta\n"
    )
    find_law(str(file))
    warning = capsys.readouterr().err
    assert warning.startswith(f"curlfit: Warning: {file}: A with its defaults, at ")
    assert "drives some points of the ring" in warning
    file.write_text(
        HEAD + MU + "        return -self.mu * point.e_xi, -self.mu * point.e_eta\n\n"
    )
    find_law(str(file))
    assert capsys.readouterr().err == ""


@pytest.mark.slow
@pytest.mark.parametrize("law", [law for law in LAWS.values() if law.shipped()])
def test_the_laws_of_curlfit_pass_the_checks_of_a_users_law(law, capsys):
    check = Check(law)
    check.values()
    check.sums()
    check.changes()
    assert capsys.readouterr().err == ""


def test_a_class_that_is_not_there_is_named_beside_those_that_are(tmp_path):
    (tmp_path / "two.py").write_text(LAW)
    with pytest.raises(DataError, match="no law class 'B' in it; it has WetSide"):
        find_law(f"{tmp_path}/two.py:B")
    with pytest.raises(DataError, match="no such file"):
        find_law(f"{tmp_path}/none.py:B")
    with pytest.raises(InputError, match="unknown law 'nothing'"):
        find_law("nothing")
