"""What README and book tell to type is typed here, as it stands, and prints
what they show.

All commands are typed in one folder, each once, in the order of the book.
"""

from __future__ import annotations

import ast
import importlib.util
import inspect
import json
import re
import shutil
from pathlib import Path

import pytest
from conftest import STRICT, python
from transcripts import ROOT, blocks, require_shown, typed, without_gaps

import curlfit
from curlfit.cli import app
from curlfit.options.settings import read_config
from curlfit.sheet import CIRCLES, LINES

pytestmark = pytest.mark.documentation
NOTEBOOKS = ROOT / "notebooks"
ENTRIES = [
    entry
    for tree in re.findall(
        r"```{toctree}\n(.*?)```", (NOTEBOOKS / "index.md").read_text(), re.S
    )
    for entry in tree.split("\n\n", 1)[1].split()
]
PAGES = {"README": (ROOT / "README.md").read_text()} | {
    Path(entry).name: (NOTEBOOKS / f"{entry}.md").read_text()
    for entry in ["index", *ENTRIES]
    if (NOTEBOOKS / f"{entry}.md").exists()
}
README = PAGES["README"]
BOOK = "\n".join(PAGES.values())
# These are done by .ci/run, each in an environment that has nothing yet.
NOT_HERE = tuple(
    re.search(rf"<!-- {name} -->\n```bash\n(.*)\n```", README)[1]
    for name in ("fit", "tests")
)
MAIN = "curlfit fit data/jensen_shegelski_2004.csv"
BLOCKS = [
    (name, lines, text)
    for name, page in PAGES.items()
    for lines, text in blocks(page)
    if not set(lines) & set(NOT_HERE)
]
BASH = list(dict.fromkeys([MAIN, *(line for _, lines, _ in BLOCKS for line in lines)]))
BASH.remove("curlfit reproduce")  # of which all is in tests/paper, and in a notebook
OUTPUTS = [(name, lines, text) for name, lines, text in BLOCKS if text]
TABLE = re.search(
    r"A text table with a header:\n\n```text\n(.*?)```", PAGES["data"], re.S
)[1]
INLINE = set(re.findall(r"`(curlfit(?: [^`]+))`", BOOK)) - set(BASH)
QUOTED = {
    name: re.search(r"```text\n((?:Time|draw)[^\n]*[;,].*?)```", PAGES[name], re.S)[1]
    for name in ("tracked_throws", "stopwatch_evening", "two_sheets")
}
LINK = re.compile(r"\]\((?!https?:)([^)#\s]*)(?:#([^)\s]*))?\)")


@pytest.fixture(scope="module")
def clone(tmp_path_factory):
    """What a clone has beside the program."""
    folder = tmp_path_factory.mktemp("clone")
    shutil.copytree(ROOT / "data", folder / "data")
    return folder


@pytest.fixture(scope="module")
def printed(clone):
    """What each command of the blocks prints, in one folder."""
    return {line: typed(line, clone) for line in BASH}


def test_every_block_is_known():
    assert len(set(NOT_HERE)) == 2
    assert NOT_HERE[0].endswith(f"/{MAIN}")
    assert len(BASH) > 45
    assert all(line.startswith("curlfit ") for line in BASH)
    # output follows its commands; the others are of the README's first command,
    # nine files, and what is said of a law (tests/friction/test_own_law.py)
    assert len(re.findall(r"^```text$", BOOK, re.M)) == len(OUTPUTS) + 11
    assert len(OUTPUTS) > 30


@pytest.mark.parametrize("page", QUOTED)
def test_the_lines_of_a_file_are_those_of_the_file(page):
    files = [file.read_text() for file in (ROOT / "data").glob("*.csv")]
    assert any(text.startswith(QUOTED[page]) for text in files)


@pytest.mark.parametrize(
    ("lines", "text"),
    [
        pytest.param(
            [MAIN], re.search(r"```text\n(.*?)```", README, re.S)[1], id="README"
        ),
        *(
            pytest.param(lines, text, id=f"{name}: {lines[-1]}")
            for name, lines, text in OUTPUTS
        ),
    ],
)
def test_the_commands_print_what_is_shown(printed, lines, text):
    assert without_gaps(text)
    require_shown(without_gaps(text), "".join(printed[line] for line in lines))


def test_the_commands_write_what_the_book_says(printed, clone):
    for kind, files in {
        "fit": {"fit.json", "fit.png", "corner.png", "chain.h5"},
        "compare": {"compare.json", "compare.png"},
        "predict": {"predict.json", "predict.csv", "predict.png"},
        "profile-mu1_xi": {"profile.json", "profile.png"},
    }.items():
        folder = clone / f"jensen_shegelski_2004-{kind}"
        assert {file.name for file in folder.iterdir()} >= files
    (resumed,) = [line for line in BASH if line.endswith("--resume")]
    assert "Posterior: converged" in " ".join(printed[resumed].split())


def test_the_gallery_has_what_the_commands_write(printed, clone):
    drawn = _module(NOTEBOOKS / "pictures" / "draw_gallery.py")
    gallery = set(re.findall(r"pictures/([\w-]+)\.png", PAGES["gallery"]))
    assert (
        gallery == drawn.PICTURES.keys() == {f.stem for f in drawn.FOLDER.glob("*.png")}
    )
    assert all((clone / f"{file}.png").is_file() for file in drawn.PICTURES.values())


def test_the_table_of_fit_json_has_its_fields(printed, clone):
    record = json.loads((clone / "jensen_shegelski_2004-fit" / "fit.json").read_text())
    table = PAGES["files"].split("| field | content |")[1].split("\n\n")[0]
    first = [
        line.split(" | ")[0] for line in table.splitlines() if line.startswith("| `")
    ]
    fields = {name for cell in first for name in re.findall(r"`(\w+)`", cell)}
    assert fields == record.keys()


def test_options_within_sentences_exist():
    verbs = [app[name] for name in app if not name.startswith("-")]
    flag_names = {
        name
        for verb in verbs
        for flag in verb.assemble_argument_collection()
        for name in flag.names
    }
    options = set(re.findall(r"(?<=`)--[a-z0-9-]+", BOOK))
    assert len(options) > 40
    assert options <= flag_names | {"--help", "--version"}, options - flag_names


def test_calls_within_sentences_fit_their_functions():
    """Their arguments, by name and number."""
    calls = re.findall(r"`(curlfit\.\w+\([^`]*\))`", BOOK)
    assert len(calls) >= 10
    for text in calls:
        call = ast.parse(" ".join(text.split()), mode="eval").body
        assert isinstance(call, ast.Call)
        named = {str(keyword.arg): None for keyword in call.keywords}
        function = getattr(curlfit, call.func.attr)
        inspect.signature(function).bind(*call.args, **named)


@pytest.mark.parametrize("line", sorted(INLINE))
def test_commands_within_sentences(printed, clone, line):
    if re.fullmatch(r"curlfit [a-z]+", line):  # a verb alone
        shown = {" ".join(command.split()[:2]) for command in BASH}
        assert line in shown | {"curlfit show", "curlfit app"}
        return
    folders = [
        f"jensen_shegelski_2004-{kind}" for kind in ("fit", "compare", "predict")
    ]
    folders.append("jensen_shegelski_2004-profile-mu1_xi")
    for folder in folders if "DIR" in line else [""]:
        assert typed(re.sub(r"\bDIR\b", folder, line), clone) != ""


def test_commands_within_sentences_are_found():
    assert {
        "curlfit show DIR",
        "curlfit plot DIR --format pdf",
        "curlfit fit --help",
    } <= INLINE


def test_python(tmp_path):
    """All blocks in one process, each with names of its own."""
    shutil.copytree(ROOT / "data", tmp_path / "data")
    code_blocks = re.findall(r"```python\n(.*?)```", BOOK, re.S)
    assert len(code_blocks) >= 5
    for index, block in enumerate(code_blocks):
        if "curlfit.sample(" in block:
            # in the next sentence, of what the block has defined
            (line,) = set(
                re.findall(r"`(curlfit\.sample\([^`]*resume[^`]*\))`", PAGES["python"])
            )
            code_blocks[index] += f"again = {line}[1], {line}[1]\n"
            code_blocks[index] += (
                "assert all((one.values == chain.values).all() for one in again)\n"
            )
    (tmp_path / "blocks.json").write_text(json.dumps(code_blocks))
    (tmp_path / "all.py").write_text(
        "import json, pathlib\n"
        "for block in json.loads(pathlib.Path('blocks.json').read_text()):\n"
        "    exec(compile(block, block, 'exec'), {'__name__': 'block'})\n"
    )
    done = python(*STRICT, "all.py", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "chain.h5").exists()


def test_the_table_of_one_s_own_data_is_read(tmp_path):
    (tmp_path / "own.csv").write_text(TABLE)
    throw = curlfit.load_throw(tmp_path / "own.csv")
    assert throw.defaults == {"until": 18, "stone": {"R": 0.0625}}
    assert throw.x.tolist() == [0.001, 0.001]
    assert throw.y[1] == pytest.approx(0.27 * 0.3048)
    assert throw.phi[1] == pytest.approx(5.2 * 3.141592653589793 / 180)


# --- the pages themselves


def test_the_readme_is_a_screen_and_a_half():
    assert len(README.splitlines()) < 150


def test_every_page_is_in_the_book():
    pages = {
        str(file.relative_to(NOTEBOOKS).with_suffix(""))
        for folder in (NOTEBOOKS, NOTEBOOKS / "book")
        for file in folder.iterdir()
        if file.suffix in (".md", ".ipynb")
    }
    assert sorted(ENTRIES) == sorted(pages - {"index"})


def _slugs(text):
    """Anchors of the headings of a page, as GitHub and MyST make them."""
    text = re.sub(r"^```.*?^```", "", text, flags=re.S | re.M)
    heads = re.findall(r"^#+ (.*)$", text, re.M)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}


FILES = [ROOT / "README.md", *NOTEBOOKS.glob("*.md"), *NOTEBOOKS.glob("book/*.md")]


@pytest.mark.parametrize("file", sorted(FILES), ids=lambda file: file.stem)
def test_links_lead_somewhere(file):
    text = file.read_text()
    for target, anchor in LINK.findall(text):
        linked_file = file.parent / target if target else file
        assert linked_file.exists(), target
        if anchor:
            assert anchor in _slugs(linked_file.read_text()), (target, anchor)


def _module(file):
    spec = importlib.util.spec_from_file_location(file.stem, file)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


SHIPPED = sorted(name for name, law in curlfit.LAWS.items() if law.shipped())


def test_the_pictures_of_the_laws_are_what_the_laws_draw():
    """To the digits of a text in SVG, which libraries may round differently."""
    drawn = _module(NOTEBOOKS / "pictures" / "draw_laws.py")
    for name in SHIPPED:
        stored = (drawn.FOLDER / f"law_{name}.svg").read_text()
        now = drawn.picture(name)
        number = r"-?\d+(?:\.\d+)?"
        assert re.sub(number, "#", stored) == re.sub(number, "#", now), name
        pairs = zip(re.findall(number, stored), re.findall(number, now), strict=True)
        assert all(
            abs(float(stored_number) - float(drawn_number)) < 0.11
            for stored_number, drawn_number in pairs
        ), name


def test_the_page_of_the_laws_has_all_of_them():
    page = PAGES["laws"]
    assert set(re.findall(r"^## ([a-z][a-z0-9+-]+)$", page, re.M)) == set(SHIPPED)
    for name in SHIPPED:
        section = page.split(f"\n## {name}\n")[1].split("\n## ")[0]
        assert f"pictures/law_{name}.svg" in section
        row = re.search(rf"^\| \[`{re.escape(name)}`\].*$", page, re.M)[0]
        if name != "front-back-first-order":
            names = [
                coefficient.name for coefficient in curlfit.LAWS[name].coefficients()
            ]
            assert re.findall(r"`(\w+)`", row.split("|")[-2]) == names


def test_the_api_has_all_public_names():
    documented_names = re.findall(r"^\.\. [\w:]+:: curlfit\.(\w+)$", PAGES["api"], re.M)
    assert sorted(documented_names) == sorted(set(curlfit.__all__) - {"__version__"})


def test_the_configuration_is_understood(tmp_path):
    (text,) = re.findall(r"```toml\n(.*?)```", PAGES["command_line"], re.S)
    (tmp_path / "throw.toml").write_text(text)
    settings = read_config(tmp_path / "throw.toml")
    assert settings["exclude"] == [[3.2, 4.1]]
    assert settings["stone"] == {"R": 0.0625}
    assert settings["priors"] == {"rho": "0.1+-0.0025"}


def test_the_sheet_is_that_of_the_program():
    section = PAGES["conventions"].split("## The sheet")[1]
    lines = [
        float(value)
        for value in re.findall(r"^\| [^|]* \| ([\d.]+) \|$", section, re.M)
    ]
    assert lines == pytest.approx([y for y in LINES.values() if y > 0])
    assert ", ".join(f"{radius:.3f}" for radius in CIRCLES[:3]) in section


def test_what_is_wrong_with_a_site_is_found(tmp_path):
    site = _module(Path(__file__).with_name("check_site.py"))
    (tmp_path / "a.html").write_text(
        '<p id="here"><a href="b.html#there"></a><a href="#here"></a>'
    )
    (tmp_path / "b.html").write_text(
        '<p id="there"><a href="https://example.org">away</a>'
    )
    assert site.faults(tmp_path) == []
    (tmp_path / "b.html").write_text(
        '<a href="a.html#nowhere">a</a><a href="c.html">c</a>'
        '<script src="https://x.org/y.js"></script>'
    )
    (tmp_path / "style.css").write_text(
        "@import '//x.org/z.css'; b {background: url(own.png)}"
    )
    assert site.faults(tmp_path) == [
        "a.html: no anchor b.html#there",
        "b.html: no anchor a.html#nowhere",
        "b.html: no file c.html",
        "b.html: https://x.org/y.js comes from a network",
        "style.css: //x.org/z.css comes from a network",
    ]
    assert site.faults(tmp_path / "empty") != []
