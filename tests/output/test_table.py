"""A table is the same rows and columns wherever it is shown: printed, as HTML, CSV,
LaTeX or a DataFrame."""

import csv
import math
import re
from io import StringIO
from typing import NamedTuple

import pytest
from rich.console import Console
from rich.text import Text

from curlfit.html_report.blocks import blocks_of
from curlfit.html_report.page import rendered
from curlfit.output.console import Printed
from curlfit.output.document import Document, Section
from curlfit.output.frames import csv_of, frame_of
from curlfit.output.html import brief
from curlfit.output.latex import escaped, latex_of, number
from curlfit.output.table import Column, Table


class Stone(NamedTuple):
    """A row."""

    name: str
    curl: float | None = None
    note: str = ""


NAME = Column("name")
CURL = Column(
    "curl", lambda stone: stone.curl, ".2f", unit="m", key="curl_m", right=True
)
NOTE = Column("note")
COLUMNS = (NAME, CURL, NOTE)


def printed(table, width):
    console = Console(width=width, file=StringIO())
    console.print(Printed(table))
    return console.file.getvalue()


def html(table):
    section = Section("id", "Heading", [table])
    return brief(Document(finding="", subject="", sections=[section]), "Result")


def page(table):
    return "".join(map(rendered, blocks_of([table])))


def a_table(**changes):
    """Five columns, the last of which may be wrapped."""
    columns = [
        Column("name", lambda row: f"row {row}"),
        Column("some estimate", lambda row: f"{row}.123456", right=True),
        Column("std. error", lambda row: f"0.{row:06d}", right=True),
        Column("interval of the estimate", lambda row: f"{row}.1 .. {row}.2"),
        Column("more", lambda row: f"all that is said of {row}" * 2, wraps=True),
    ]
    return Table(range(3), columns, **changes)


@pytest.mark.parametrize("width", [32, 60, 120])
def test_a_table_keeps_its_headers_and_numbers(width):
    table = a_table()
    text = printed(table, width)
    assert max(len(line.rstrip()) for line in text.splitlines()) <= width
    for column in table.columns:
        assert column.heading in text
    for column in table.columns[:4]:
        for row in table.rows:
            assert column.cell(row) in text
    assert "\N{HORIZONTAL ELLIPSIS}" not in text
    assert text.count("row 1") == len(text.split("\n\n")) or width < 60


def test_blocks_repeat_the_keys_and_leave_out_empty_rows():
    rows = (("1", "x", "100", "200"), ("2", "y", "300", ""))
    columns = [
        Column("a", lambda row: row[0]),
        Column("b", lambda row: row[1]),
        Column("first one", lambda row: row[2]),
        Column("second one", lambda row: row[3]),
    ]
    first, second = printed(Table(rows, columns, keys=2), 20).split("\n\n")
    assert first.split() == ["a", "b", "first", "one", "1", "x", "100", "2", "y", "300"]
    assert second.split() == ["a", "b", "second", "one", "1", "x", "200"]


def test_a_word_wider_than_the_terminal_is_folded():
    columns = [Column("file", lambda row: row[0]), Column("value", lambda row: row[1])]
    text = printed(Table([("x" * 50, "1.25")], columns), 30)
    assert text.count("x") == 50
    assert "1.25" in text


def test_columns_without_content_are_left_out_where_people_read():
    nothing = Table([Stone("a"), Stone("b")], COLUMNS)
    assert [column.heading for column in nothing.shown] == ["name"]
    assert printed(nothing, 40).split() == ["name", "a", "b"]
    for text in (html(nothing), page(nothing), latex_of(nothing)):
        assert "curl" not in text
        assert "note" not in text
    assert csv_of(nothing) == "name,curl_m,note\na,,\nb,,\n"
    assert not Table([], COLUMNS)
    assert nothing


def test_a_missing_value_is_a_dash_unless_its_column_says_otherwise():
    rows = [Stone("a"), Stone("b", 2.0)]
    assert printed(Table(rows, COLUMNS), 40).split() == [
        *("name", "curl", "(m)"),
        *("a", "-"),
        *("b", "2.00"),
    ]
    blank = Table(rows, (NAME, CURL.but(missing="")))
    assert printed(blank, 40).split() == ["name", "curl", "(m)", "a", "b", "2.00"]


def test_numbers_are_aligned_to_the_right_everywhere():
    table = Table([Stone("a", 10.25, "as it was"), Stone("b", 2.5)], COLUMNS)
    assert printed(table, 40) == (
        "name  curl (m)  note     \n"
        "a        10.25  as it was\n"
        "b         2.50           \n"
    )
    assert re.findall(r"text-align: (\w+)[^>]*>(\w[^<]*)", html(table)) == [
        ("left", "name"),
        ("right", "curl (m)"),
        ("left", "note"),
        ("left", "a"),
        ("right", "10.25"),
        ("left", "as it was"),
        ("left", "b"),
        ("right", "2.50"),
    ]
    assert '<td class="right">10.25</td>' in page(table)
    assert '<th scope="row">a</th>' in page(table)
    assert "{@{}l r l@{}}" in latex_of(table)


def test_the_unit_stands_after_the_heading_or_below_it():
    assert CURL.title == "curl (m)"
    assert CURL.but(heading="curl\n").title == "curl\n(m)"
    assert NAME.title == "name"


def test_words_may_need_more_than_the_value():
    column = CURL.but(words=lambda stone: f"{stone.name}: {stone.curl:.1f}")
    table = Table([Stone("a", 0.25)], [column])
    assert "a: 0.2" in printed(table, 40)
    assert csv_of(table) == "curl_m\n0.25\n"


def test_texts_stand_side_by_side_and_are_wrapped_between_them():
    texts = tuple(Text(f"mu{k} = 0.0{k}") for k in range(4))
    column = Column("all", lambda row: row, words=lambda row: row, wraps=True)
    table = Table([texts], [column])
    assert printed(table, 80).splitlines()[1].rstrip() == "   ".join(map(str, texts))
    narrow = printed(table, 30).splitlines()
    assert [line.rstrip() for line in narrow] == [
        "all",
        "mu0 = 0.00   mu1 = 0.01",
        "mu2 = 0.02   mu3 = 0.03",
    ]
    assert "mu0 = 0.00, mu1 = 0.01, " in html(table)
    assert not Table([()], [column])


def test_markup_of_foreign_text_is_text():
    table = Table([Stone("[bold]x[/bold] :smile: <b>")], [NAME])
    assert "[bold]x[/bold] :smile: <b>" in printed(table, 80)
    for text in (html(table), page(table)):
        assert "[bold]x[/bold] :smile: &lt;b&gt;" in text


def test_the_note_stands_below_and_the_caption_on_the_page():
    table = a_table(caption="What it shows", note=Text("What it means", style="dim"))
    assert printed(table, 200).splitlines()[-1] == "What it means"
    assert html(table).endswith("What it means</span></p></div>")
    assert "<caption>What it shows</caption>" in page(table)
    assert "What it shows" not in printed(table, 200) + html(table)


def test_a_csv_file_has_numbers_in_full_and_computes_nothing():
    rows = [Stone("=1+1", 1 / 3), Stone('a "b", c', math.nan), Stone("two\nlines")]
    text = csv_of(Table(rows, COLUMNS))
    cells = list(csv.reader(StringIO(text)))
    assert cells[0] == ["name", "curl_m", "note"]
    assert float(cells[1][1]) == 1 / 3
    assert cells[1][0] == "'=1+1"
    assert cells[2][:2] == ['a "b", c', ""]
    assert cells[3][0].splitlines() == [cells[3][0]]
    assert cells[3][1] == ""


def test_latex_has_its_cells_as_they_are():
    columns = (NAME.but(format=escaped), CURL.but(format=lambda x: number(f"{x:.0e}")))
    rows = [Stone("a_b & 5 % of #1", 1.25e-5)]
    text = latex_of(Table(rows, columns, caption="All"))
    assert r"a\_b \& 5 \% of \#1 & $1 \times 10^{-5}$ \\" in text
    assert r"\caption{All}" in text
    assert escaped("{~}") == r"\{\textasciitilde{}\}"
    assert escaped("^\\") == r"\textasciicircum{}\textbackslash{}"


def test_a_frame_has_the_values_under_the_names():
    table = Table([Stone("a", 0.5), Stone("b")], COLUMNS)
    frame = frame_of(table)
    assert frame.columns.tolist() == ["name", "curl_m", "note"]
    assert frame["curl_m"].tolist()[0] == 0.5
    assert math.isnan(frame["curl_m"].tolist()[1])
    assert frame["name"].tolist() == ["a", "b"]


def test_a_column_gets_the_attribute_of_its_name_unless_it_is_told_how():
    columns = (
        Column("name"),
        Column("how far", key="curl", format=".1f"),
        Column("curl", lambda stone: -stone.curl),
    )
    table = Table([Stone("a", 0.5)], columns)
    assert [column.get(table.rows[0]) for column in columns] == ["a", 0.5, -0.5]
    assert csv_of(table).splitlines() == ["name,curl,curl", "a,0.5,-0.5"]
    assert "how far" in printed(table, 40)
