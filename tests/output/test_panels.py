"""Panels: what is drawn is what was given."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from curlfit import sheet
from curlfit.output.figures import DATA, MAX_POINTS, Style
from curlfit.output.panels import (
    ERROR_BARS,
    LAW,
    OUTLIERS,
    RESIDUALS,
    Band,
    Interval,
    Row,
    RowValue,
    Series,
    measured_rate,
    note_stretch,
    plot_on_sheet,
    plot_path,
    plot_rate,
    plot_residuals,
    plot_rows,
)

T = np.linspace(0.0, 10.0, 11)
X = 0.01 * T**2
Y = 3.0 * T - 0.1 * T**2


@pytest.fixture
def axes():
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    figure = Figure(figsize=(6, 2))
    FigureCanvasAgg(figure)
    return figure.add_subplot()


def line_of(axes, label):
    """The coordinates of the line or marks of a label, shape (2, points)."""
    (line,) = [line for line in axes.lines if line.get_label() == label]
    return np.array(line.get_data())


def labels_of(axes):
    return axes.get_legend_handles_labels()[1]


def bars_of(axes):
    """The ends of all error bars, shape (bars, 2, 2): each from (x, y) to (x, y)."""
    return np.concatenate(
        [
            [path.vertices for path in bars.get_paths()]
            for container in axes.containers
            for bars in container.lines[2]
        ]
    )


# --- path -----------------------------------------------------------------------------


def test_a_path_is_drawn_along_the_sheet_and_to_the_right_is_below(axes):
    plot_path(
        axes,
        [Series(Y, X + 0.02, DATA, "data"), Series(Y, X, LAW, "law")],
        [Band(Y, X - 0.1, X + 0.1, 0.3, label="95 %")],
    )
    np.testing.assert_array_equal(line_of(axes, "data"), [Y, X + 0.02])
    np.testing.assert_array_equal(line_of(axes, "law"), [Y, X])
    assert labels_of(axes) == ["95 %", "data", "law"]
    (band,) = [part for part in axes.collections if isinstance(part, PolyCollection)]
    (area,) = band.get_paths()
    assert area.get_extents().ymin == pytest.approx(-0.1)
    assert area.get_extents().ymax == pytest.approx(X[-1] + 0.1)
    assert band.get_alpha() == 0.3
    bottom, top = axes.get_ylim()
    assert bottom > X.max() > X.min() > top
    low, high = axes.get_xlim()
    assert low < Y.min() < Y.max() < high


def test_feet_beside_metres_are_the_same_lengths(axes):
    plot_path(axes, [Series(Y, X, LAW)])
    axes.figure.draw_without_rendering()
    (second,) = axes.child_axes
    assert np.array(second.get_ylim()) * 0.3048 == pytest.approx(axes.get_ylim())


def test_the_note_of_a_stretched_scale_says_how_much(axes):
    axes.set(xlim=(0, 30), ylim=(1, 0), xlabel="y (m)")
    box = axes.get_window_extent()
    note_stretch(axes)
    times = float(axes.get_xlabel().split("drawn ")[1].split(" times")[0])
    assert times == pytest.approx((box.height / 1) / (box.width / 30), rel=0.05)
    axes.set(ylim=(20, 0), xlabel="y (m)")
    note_stretch(axes)
    assert axes.get_xlabel() == "y (m)"


def test_a_path_on_the_sheet_is_to_scale_with_the_names_of_lines_in_view(axes):
    rest = Series(
        np.array([38.0]),
        np.array([0.5]),
        ERROR_BARS,
        "rest",
        sigma=np.array([0.1]),
        sigma_at=np.array([0.2]),
    )
    y = np.linspace(10.0, 38.0, 50)
    plot_on_sheet(
        axes,
        [Series(y, 0.01 * y, LAW, "law"), rest],
        ends=(9.0, 42.0),
        line_names={"hog": "hog line", "tee": "tee", "far-tee": "far tee"},
    )
    np.testing.assert_array_equal(line_of(axes, "law"), [y, 0.01 * y])
    assert axes.get_aspect() == 1
    assert axes.get_xlim() == (9.0, 42.0)
    ticks = axes.get_xticks()
    names = [label.get_text() for label in axes.get_xticklabels()]
    assert dict(zip(names, ticks, strict=True)) == {
        "hog line": sheet.LINES["hog"],
        "far tee": sheet.TEE,
    }
    across, up = bars_of(axes)
    np.testing.assert_allclose(across, [[37.8, 0.5], [38.2, 0.5]])
    np.testing.assert_allclose(up, [[38.0, 0.4], [38.0, 0.6]])
    bottom, top = axes.get_ylim()
    assert bottom > sheet.WIDTH / 2 > -sheet.WIDTH / 2 > top
    centres = {(*circle.center, circle.radius) for circle in axes.patches[1:]}
    assert (sheet.TEE, 0.0, sheet.HOUSE) in centres


def test_a_path_beyond_the_sheet_is_in_view(axes):
    far = Series(Y, np.where(T > 9, np.nan, -X - 4.0), LAW)
    plot_on_sheet(axes, [far], ends=(0.0, 30.0), line_names={})
    assert axes.get_ylim()[1] < np.nanmin(far.values)


def test_of_many_marks_some_are_drawn_and_of_a_line_all(axes):
    many = np.linspace(0.0, 1.0, 3 * MAX_POINTS)
    plot_path(axes, [Series(many, many, DATA, "data"), Series(many, many, LAW, "law")])
    drawn = line_of(axes, "data")
    assert drawn.shape == (2, MAX_POINTS)
    assert drawn[0, 0] == 0.0
    assert drawn[0, -1] == 1.0
    assert line_of(axes, "law").shape == (2, 3 * MAX_POINTS)


# --- residuals ------------------------------------------------------------------------


def test_residuals_lie_about_their_zero_within_their_band(axes):
    residuals = np.sin(T)
    plot_residuals(
        axes,
        [Series(T, residuals, RESIDUALS, "data")],
        [Band(T, residuals - 2, residuals + 2, 0.3)],
        label="residual (mm)",
        over="speed (m/s)",
    )
    np.testing.assert_array_equal(line_of(axes, "data"), [T, residuals])
    flat = [line for line in axes.lines if set(line.get_ydata()) == {0}]
    assert len(flat) == 1
    assert axes.get_ylabel() == "residual (mm)"
    assert axes.get_xlabel() == "speed (m/s)"
    low, high = axes.get_ylim()
    assert low < (residuals - 2).min() < (residuals + 2).max() < high


def test_outliers_far_away_are_drawn_at_the_edge(axes):
    residuals = np.full(100, 1.0)
    residuals[:2] = [2.0, -1000.0]
    t = np.arange(100.0)
    plot_residuals(
        axes,
        [Series(t, residuals, RESIDUALS)],
        outliers=Series(t[:2], residuals[:2], OUTLIERS, "2 outliers"),
        label="residual (mm)",
    )
    assert axes.get_ylim() == (-2.5, 2.5)
    (at, values) = line_of(axes, "2 outliers")
    np.testing.assert_array_equal(at, [0.0, 1.0])
    assert values[0] == 2.0
    assert -2.5 < values[1] < -2.3


# --- rates ----------------------------------------------------------------------------


def test_measured_speeds_are_drawn_rather_than_slopes():
    measured = measured_rate({"t": T, "x": X, "y": Y, "speed": 3 - 0.2 * T}, "speed")
    np.testing.assert_array_equal(measured.values, 3 - 0.2 * T)
    assert measured.label == ""


def test_without_measured_speeds_they_are_slopes_and_say_so():
    t = np.linspace(0.0, 10.0, 200)
    measured = measured_rate({"t": t, "x": 3 * t, "y": 4 * t, "phi": -2 * t}, "speed")
    assert measured.values == pytest.approx(5.0)
    assert measured.label.startswith("slopes of the data over 0.2")
    spins = measured_rate({"t": t, "phi": -2 * t}, "omega")
    assert spins.values == pytest.approx(-2.0)
    assert len(measured_rate({"t": t, "x": t, "y": t}, "omega").values) == 0


@pytest.mark.parametrize(
    ("values", "zero_ends"),
    [
        (1 + T, (True, False)),
        (-1 - T, (False, True)),
        (T - 5, (False, False)),
        (0 * T, (True, False)),
    ],
)
def test_the_axis_of_a_rate_ends_at_zero_where_the_law_has_one_sign(
    axes, values, zero_ends
):
    measured = Series(T, values + 0.1, DATA, "data")
    plot_rate(axes, "omega", [measured], [Series(T, values, LAW, "law")])
    np.testing.assert_array_equal(line_of(axes, "data"), [T, values + 0.1])
    np.testing.assert_array_equal(line_of(axes, "law"), [T, values])
    assert tuple(end == 0 for end in axes.get_ylim()) == zero_ends
    assert "rad/s" in axes.get_ylabel()


# --- values by row --------------------------------------------------------------------

ALONE = Style("blue", "none", marker="o")
POOLED = replace(ALONE, marker="D", fill="white")


def drawn_values(axes):
    """The marks as (value, height), in the order in which they were drawn."""
    return [
        (float(line.get_xdata()[0]), float(line.get_ydata()[0]))
        for line in axes.lines
        if line.get_marker() in ("o", "D")
    ]


def test_values_lie_in_their_rows_with_their_errors(axes):
    rows = [
        Row(
            "first",
            [RowValue(1.0, POOLED, label="with all"), RowValue(1.2, ALONE, 0.3)],
        ),
        Row("none"),
        Row("last", [RowValue(2.0, POOLED, label="with all")], bold=True),
    ]
    plot_rows(axes, rows)
    assert drawn_values(axes) == [(1.0, 0.0), (1.2, 0.0), (2.0, 2.0)]
    np.testing.assert_allclose(bars_of(axes), [[[0.9, 0.0], [1.5, 0.0]]])
    assert labels_of(axes) == ["with all"]
    names = axes.get_yticklabels()
    assert [name.get_text() for name in names] == ["first", "none", "last"]
    assert list(axes.get_yticks()) == [0, 1, 2]
    assert [name.get_fontweight() for name in names] == ["normal", "normal", "bold"]
    bottom, top = axes.get_ylim()
    assert bottom > 2
    assert top < 0


def test_ranges_are_shaded_in_one_row_or_in_all(axes):
    expected = Interval(0.5, 1.5, "blue", 0.25)
    row = Row("first", [RowValue(1.0, ALONE)], expected=expected)
    plot_rows(axes, [row, Row("second")], Interval(0.8, 1.1, "red", 0.4))
    common, of_row = [part for part in axes.patches if isinstance(part, Rectangle)]
    assert (common.get_x(), common.get_width()) == pytest.approx((0.8, 0.3))
    assert common.get_height() == 1  # of the axes
    assert common.get_alpha() == 0.4
    assert (of_row.get_x(), of_row.get_width()) == pytest.approx((0.5, 1.0))
    assert of_row.get_y() == pytest.approx(-of_row.get_height() / 2)
    assert of_row.get_alpha() == 0.25


def test_a_row_joins_its_values_and_has_a_remark(axes):
    row = Row(
        "far",
        [RowValue(1.0, ALONE), RowValue(5.0, POOLED)],
        joined=True,
        remark="16 sigma",
    )
    plot_rows(axes, [Row("near"), row])
    (joined,) = axes.collections
    np.testing.assert_array_equal(joined.get_segments(), [[[1.0, 1.0], [5.0, 1.0]]])
    (remark,) = axes.texts
    assert remark.get_text() == "16 sigma"
    assert 1 < remark.get_position()[1] < 1.5


def test_axes_beside_rows_share_their_names(axes):
    figure = axes.figure
    figure.clear()
    first, second = figure.subplots(1, 2, sharey=True)
    rows = [Row("a", [RowValue(1.0, ALONE)], bold=True), Row("b")]
    for panel in (first, second):
        plot_rows(panel, rows)
    figure.draw_without_rendering()
    names = first.get_yticklabels()
    assert [name.get_text() for name in names] == ["a", "b"]
    assert names[0].get_fontweight() == "bold"
    assert not second.get_yticklabels()
