"""Tables as spreadsheets lay them out: titles, units apart, errors, thousands,
several throws."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import parts_in
from sample_files import (
    CELL,
    COLUMNS,
    PHI,
    PLAIN,
    ROWS,
    N,
    T,
    X,
    Y,
    is_throw,
    note_on,
    ods,
    table,
    xlsx,
    xlsx_rows,
)

from curlfit import DataError, InputError, Throw, load_throw, load_throws
from curlfit.foreign import quoted
from curlfit.throws.readers import worksheet_size

HEADER = ",".join(COLUMNS)


def test_titles_above_the_header(write):
    for titles in (
        "Curling club\nSheet 3, ice of January\n\n",
        "Throw,3,,\n,,,\nDate,12.1.,,\n",
    ):
        throw = load_throw(write(titles + "# until = 9\n" + PLAIN))
        is_throw(throw)
        assert throw.defaults == {"until": 9}
        assert throw.lines[0] == titles.count("\n") + 3
        first = titles.split("\n")[0].strip(",")
        above = titles.count("\n") - titles.count("\n\n")
        (note,) = throw.notes
        assert str(note) == f"{above} lines above the header not read: '{first}'"


def test_units_in_the_second_row(write):
    body = table({"Time": T, "X": 100 * X, "Y": 100 * Y, "Angle": np.degrees(PHI)})
    head, *rows = body.splitlines()
    for units in (
        "(s),(cm),(cm),(deg)",
        "s,cm,cm,°",
        "[s],[cm],[cm],[Grad]",
        ",cm,cm,deg",
    ):
        throw = load_throw(write("\n".join([head, units, *rows])))
        is_throw(throw)
        assert throw.lines[0] == 3
    titled = load_throw(
        write("\n".join(["Our throw", head, "(s),(cm),(cm),(deg)", *rows]))
    )
    is_throw(titled)
    with pytest.raises(
        DataError,
        match=r"line 2, column Time: '\(fortnights\)' found, expected a finite",
    ):
        load_throw(write("\n".join([head, "(fortnights),(au),(au),(gon)", *rows])))


def test_a_row_without_values_is_no_row_of_units(write):
    head = "t (s),x (m),y (m),phi (rad)"
    for empty in (",,,", "-,-,-,-", "n/a,,,-"):
        throw = load_throw(write("\n".join([head, empty, *ROWS])))
        is_throw(throw)
        (note,) = throw.notes
        assert str(note) == "1 empty row left out"


def test_errors_of_spreadsheets_are_gaps(write):
    rows = [row.split(",") for row in ROWS]
    for k, error in ((3, "#NV"), (5, "#DIV/0!"), (9, "#N/A"), (11, "n/a")):
        rows[k][2] = error
    throw = load_throw(write("\n".join([HEADER, *map(",".join, rows)])))
    assert np.flatnonzero(np.isnan(throw.y)).tolist() == [3, 5, 9, 11]
    (note,) = throw.notes
    assert str(note) == "3 cells such as '#NV' are taken as gaps"


def grouped(value: float, thousands: str, decimal: str) -> str:
    return f"{value:,.3f}".translate({44: thousands, 46: decimal})


@pytest.mark.parametrize(
    ("thousands", "decimal", "separator"),
    [
        (".", ",", ";"),
        (",", ".", "\t"),
        (" ", ",", ";"),
        ("\u202f", ",", ";"),
        ("'", ".", ";"),
        (",", ".", ","),
    ],
)
def test_thousands_may_be_separated(write, thousands, decimal, separator):
    quote = '"' if separator == "," else ""
    head = separator.join(["t (s)", "x (mm)", "y (mm)", "angle (rad)"])
    rows = [
        separator.join(
            f"{quote}{grouped(value, thousands, decimal)}{quote}" for value in row
        )
        for row in zip(T, 1000 * X, 1000 * Y, PHI, strict=True)
    ]
    throw = load_throw(write("\n".join([head, *rows])))
    is_throw(throw, atol=6e-4)
    assert note_on(throw, "thousands").numbers["mark"] == quoted(thousands)


def test_a_mark_that_cannot_separate_thousands_is_not_removed(write):
    """What was read with a decimal point or comma still is, and both in one file
    are refused."""
    throw = load_throw(write("t;x;y\n0,5;1,234;1.234\n0,6;1,5;1.5\n"))
    assert (throw.x[0], throw.y[0]) == (1.234, 1.234)
    throw = load_throw(write('t,x,y\n0.5,1,"1,234"\n0.6,1,"1,235"\n'))
    assert throw.y.tolist() == [1234, 1235]
    with pytest.raises(
        DataError, match=r"line 2, column y: '1\.064,3' found, expected a finite"
    ):
        load_throw(write("t;x;y\n0.5;1;1.064,3\n0.6;1;1.065,3\n"))


def test_a_spreadsheet_may_have_titles_units_apart_and_errors(tmp_path):
    pytest.importorskip("python_calamine")
    heads = (
        ["Curling, Bahn 3"],
        ["Sitzung", "2"],
        ["Zeit", "x", "y", "Winkel"],
        ["s", "cm", "cm", "°"],
    )
    rows = ["".join(CELL.format("string", "", word) for word in head) for head in heads]
    for k, row in enumerate(zip(T, 100 * X, 100 * Y, np.degrees(PHI), strict=True)):
        cells = [
            CELL.format("float", f'office:value="{value!r}"', value)
            for value in map(float, row)
        ]
        if k == 7:
            cells[2] = CELL.format("string", "", "#NV")
        rows.append("".join(cells))
    throw = load_throw(ods(tmp_path / "throw.ods", rows))
    assert np.flatnonzero(np.isnan(throw.y)).tolist() == [7]
    np.testing.assert_allclose(throw.phi, PHI, atol=1e-9)
    np.testing.assert_allclose(throw.x, X, atol=1e-9)
    note = note_on(throw, "lines-above-the-header")
    assert note.numbers == {"count": 2, "first": "'Curling, Bahn 3'"}


STRAY = '<row r="1048576"><c r="XFD1048576"><v>1</v></c></row>'


@pytest.mark.parametrize(
    ("stray", "named"),
    [
        (STRAY, "XFD1048576, 1048576 rows of 16384 columns"),
        (
            '<row><c r="A1048576"><v>1</v></c></row>'
            '<row><c r="ZZ70" t="inlineStr"><is><t>x</t></is></c></row>',
            "A1048576 and ZZ70, 1048576 rows of 702 columns",
        ),
        (STRAY.replace("<v>1</v>", ""), ""),  # a style alone
    ],
)
def test_a_stray_cell_far_from_the_table_is_named(tmp_path, stray, named):
    pytest.importorskip("python_calamine")
    file = xlsx(tmp_path / "throw.xlsx", xlsx_rows("a,b"), xlsx_rows(PLAIN) + stray)
    if named:
        with pytest.raises(DataError, match=f"reach to {named}, and a workbook may"):
            load_throw(file, worksheet="s2")
    else:
        is_throw(load_throw(file, worksheet="s2"))


def test_repeated_cells_of_a_worksheet_are_counted(tmp_path):
    pytest.importorskip("python_calamine")
    times = "number-columns-repeated"
    cell = CELL.format("float", f'office:value="1" table:{times}="{{}}"', "1")
    gap = f'<table:table-cell table:{times}="1000"/>'
    row = "</table:table-row><table:table-row {}>"
    many = row.format('table:number-rows-repeated="1048576"')
    for rows, named in (
        ([gap + cell.format(2_000_000)], "DIVAN1"),
        ([cell.format(2), many + cell.format(2)], "B1048578"),
        ([cell.format(1), many + row.format("") + cell.format(2)], "B1048579"),
    ):
        with pytest.raises(DataError, match=f"worksheet reach to {named}, "):
            load_throw(ods(tmp_path / "throw.ods", rows))
    rows = ["".join(map(said_cell, line.split(","))) for line in PLAIN.splitlines()]
    rows += [many + gap]  # as programs write the end of a worksheet
    is_throw(load_throw(ods(tmp_path / "throw.ods", rows)))


def said_cell(text: str) -> str:
    return CELL.format("string", "", text)


def test_the_largest_workbook(tmp_path, monkeypatch):
    pytest.importorskip("python_calamine")
    cells = (len(ROWS) + 1) * 4 + 2
    worksheets = (xlsx_rows(PLAIN), xlsx_rows("a,b"))
    monkeypatch.setattr(worksheet_size, "MOST_CELLS", cells)
    is_throw(load_throw(xlsx(tmp_path / "largest.xlsx", *worksheets)))
    monkeypatch.setattr(worksheet_size, "MOST_CELLS", cells - 1)
    with pytest.raises(DataError, match=f"a workbook may have {cells - 1} cells"):
        load_throw(xlsx(tmp_path / "too_large.xlsx", *worksheets))


def several(gap: float, shift: float = 0.5) -> str:
    second = table(COLUMNS | {"t": T + T[-1] + gap, "x": X + shift}).splitlines()[1:]
    return "\n".join([HEADER, *ROWS, *second]) + "\n"


def test_a_stone_that_is_back_at_the_start_is_another_throw(write):
    file = write(several(30.0))
    with pytest.raises(DataError) as caught:
        load_throw(file)
    assert str(caught.value) == (
        f"{file}: 2 throws; choose one with `--stone-index N`: "
        f"1 from line 2 (60 rows); 2 from line {N + 2} (60 rows)"
    )
    first, second = parts_in(file)
    is_throw(first.throw)
    is_throw(second.throw, 0.5, T[-1] + 30)
    jumps = [row.split(",") for row in ROWS]
    jumps[30][1:3] = "0", "0"  # a row that is off is no throw
    assert len(load_throw(write("\n".join([HEADER, *map(",".join, jumps)])))) == N
    # nor a stone out of sight
    gap = load_throw(write("\n".join([HEADER, *ROWS[:6], *ROWS[45:]])))
    assert len(gap) == 21


def test_a_joint_fit_takes_every_throw_of_a_table(write):
    file = write(several(-5.0))  # the clock starts again
    assert [throw.name for throw in load_throws(write(PLAIN, "one.csv"))] == [
        str(file.with_name("one.csv"))
    ]
    names = write(
        "stone,t,x,y\n"
        + "".join(
            f"{name},{t},{x},{y}\n"
            for name in "ab"
            for t, x, y in zip(T, X, Y, strict=True)
        ),
        "named.csv",
    )
    first, second = load_throws(names)
    assert (first.name, second.name) == (f"{names} throw 1", f"{names} throw 2")
    (second,) = load_throws(names, stone_index=2)
    assert second.name == str(names)
    assert len(load_throws(names, write(several(30.0)))) == 4


@pytest.mark.parametrize(
    "head",
    [
        "t1,x1,y1,phi1,t2,x2,y2,phi2",
        "t,x,y,phi,t.1,x.1,y.1,phi.1",
        "t,x,y,phi,t,x,y,phi",
        "t_1 (s),x_1 (m),y_1 (m),phi_1 (rad),t_2 (s),x_2 (m),y_2 (m),phi_2 (rad)",
        "Red,,,,Yellow,,,\nt (s),x (m),y (m),phi (rad),t (s),x (m),y (m),phi (rad)",
    ],
)
def test_throws_side_by_side(write, head):
    other_rows = table(COLUMNS | {"x": X + 0.5}).splitlines()[1:-5] + [",,,"] * 5
    rows = [f"{row},{other}" for row, other in zip(ROWS, other_rows, strict=True)]
    file = write("\n".join([head, *rows]))
    throw = load_throw(file)
    is_throw(throw)
    note = note_on(throw, "one-of-objects")
    assert (note.numbers["count"], note.numbers["taken"]) == (2, 1)
    np.testing.assert_allclose(load_throw(file, stone_index=2).x, X[:-5] + 0.5)


def test_one_clock_for_throws_side_by_side(write):
    rows = "".join(
        f"{t},{x},{y},{x + 0.5},{y}\n" for t, x, y in zip(T, X, Y, strict=True)
    )
    np.testing.assert_allclose(
        load_throw(write("t,x1,y1,x2,y2\n" + rows), stone_index=2).x, X + 0.5
    )


def test_a_worksheet_is_chosen_by_its_name_and_the_others_are_named(tmp_path, write):
    pytest.importorskip("python_calamine")

    def cells(shift: float) -> list[str]:
        head = "".join(CELL.format("string", "", name) for name in COLUMNS)
        columns = (COLUMNS | {"x": X + shift}).values()
        return [head] + [
            "".join(
                CELL.format("float", f'office:value="{v!r}"', v)
                for v in map(float, row)
            )
            for row in zip(*columns, strict=True)
        ]

    legend = [CELL.format("string", "", "red")]
    file = ods(tmp_path / "throws.ods", cells(0.0), second=cells(0.5), Legend=legend)
    first = load_throw(file)
    second = load_throw(file, worksheet="second")
    np.testing.assert_allclose(second.x, first.x + 0.5, atol=1e-12)
    those = (
        "3 worksheets: evening, second, Legend; taken: {}; `--worksheet NAME` selects "
        "another"
    )
    assert str(first.notes[0]) == those.format("evening")
    assert str(second.notes[0]) == those.format("second")
    assert second.read_with == ("--worksheet=second",)
    with pytest.raises(
        InputError, match="worksheet with data; expected one of evening, second, L"
    ):
        load_throw(file, worksheet="empty")
    with pytest.raises(DataError) as caught:
        load_throw(file, worksheet="Legend")
    assert str(caught.value).endswith(f"; {those.format('Legend')}")
    with pytest.raises(InputError, match="is no workbook and holds no worksheets"):
        load_throw(write(PLAIN), worksheet="second")
    with pytest.raises(InputError, match="holds no worksheets"):
        Throw.from_frame(COLUMNS, worksheet="second")
