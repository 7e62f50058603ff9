"""Figures: no text runs into another or out of the picture."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from matplotlib.text import Text

import curlfit
from curlfit.inference.information.verdict import Verdict
from curlfit.inference.sampling.chain import Chain
from curlfit.inference.together.result import (
    DeterminedTogether,
    JointResult,
    Variation,
)
from curlfit.loads import Load
from curlfit.options.figures import FigureFiles, write_figures
from curlfit.output.figures import Picture
from curlfit.output.panels import measured_slopes
from curlfit.output.ticks import neat_axis, unit_for
from curlfit.reports.corner import corner_figure
from curlfit.reports.figures import fit_figure, joint_figure


def agg(figure):
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    FigureCanvasAgg(figure)
    return figure


def require_room(figure):
    """Draw the figure, of which no text may leave it, no two labels of ticks may meet,
    and no label of an axis may lie on those of its ticks."""
    agg(figure)
    drawn = []
    draw = Text.draw

    def noted(self, renderer, *args, **kwargs):
        drawn.append(self)
        return draw(self, renderer, *args, **kwargs)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Text, "draw", noted)
        figure.canvas.draw()
    boxes = {
        text: text.get_window_extent()
        for text in dict.fromkeys(drawn)
        if text.get_visible() and text.get_text().strip()
    }
    x0, y0, x1, y1 = figure.bbox.extents
    outside = [
        text.get_text()
        for text, box in boxes.items()
        if box.x0 < x0 - 1 or box.x1 > x1 + 1 or box.y0 < y0 - 1 or box.y1 > y1 + 1
    ]
    assert not outside
    ticks = {
        axis: [label for label in axis.get_ticklabels() if label in boxes]
        for axes in figure.axes
        for axis in (axes.xaxis, axes.yaxis)
    }
    for first_label, second_label in combinations(
        [label for labels in ticks.values() for label in labels], 2
    ):
        assert not boxes[first_label].overlaps(boxes[second_label]), (
            first_label,
            second_label,
        )
    for axis, labels in ticks.items():
        if axis.label in boxes:
            assert not any(boxes[axis.label].overlaps(boxes[label]) for label in labels)


# --- corner ---------------------------------------------------------------------------


CASES = {
    "as fitted": None,
    "very long numbers": ([0.055626512, 2.091123456, -0.113456789, 1.00643212], 1e-8),
    "tiny": ([4e-7, 3e-8, 2e-5, 1e-9], [1e-7, 1e-8, 3e-6, 3e-10]),
    "huge": ([4e7, 3e8, 2e5, 1e9], [1e7, 1e8, 3e4, 3e8]),
}


@pytest.mark.parametrize("case", CASES)
def test_ticks_of_neighbouring_corner_panels_do_not_meet(
    eq12_posterior, case, monkeypatch
):
    fit, chain = eq12_posterior
    if CASES[case] is not None:
        centre, spread = CASES[case]
        samples = np.random.default_rng(1).normal(size=(4000, len(fit.coefficients)))
        drawn = dict(zip(fit.coefficients, (samples * spread + centre).T, strict=True))
        monkeypatch.setattr(
            Chain, "of", lambda self, weights: drawn[next(iter(weights))]
        )
        nothing = replace(fit.identifiability, null_directions=())
        fit = replace(fit, combinations=(), identifiability=nothing, reference=None)
    figure = corner_figure(fit, chain)
    require_room(figure)
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            assert all(low <= position <= high for position in axis.get_majorticklocs())
            shown = [
                label.get_text() for label in axis.get_ticklabels() if label.get_text()
            ]
            assert len(shown) != 1
            assert len(set(shown)) == len(shown)


def with_coefficients(fit, count):
    """The first few alone estimated."""
    held = {
        name: replace(fit[name], verdict=Verdict.FIXED)
        for name in list(fit.coefficients)[count:]
    }
    return replace(fit, parameters=fit.parameters | held)


@pytest.mark.parametrize("count", [1, 3])
def test_a_corner_of_few_coefficients_has_room_for_its_words(eq12_posterior, count):
    fit, chain = eq12_posterior
    name = f"a-{'very-' * 20}long-name-of-a-file.csv"
    few = replace(with_coefficients(fit, count), data=replace(fit.data, file=name))
    require_room(corner_figure(few, chain))


def test_ticks_say_what_they_stand_for():
    from matplotlib.figure import Figure

    axes = agg(Figure()).add_subplot()
    for low, high in (
        (0.0555, 0.0557),
        (2.0911230, 2.0911238),
        (-3e-9, 5e-9),
        (1e6, 9e6),
    ):
        axes.set_xlim(low, high)
        neat_axis(axes.xaxis, "a", "m/s^2")
        label = axes.get_xlabel()
        start = 0.0
        power = 0
        if "{" in label:
            power = int(label.split("{")[1].split("}")[0])
        head = label.split("(")[0]
        if "\N{MINUS SIGN}" in head:
            start = float(head.split("\N{MINUS SIGN}")[1])
        positions = axes.get_xticks()
        assert len(positions) >= 2
        for position, number in zip(positions, axes.get_xticklabels(), strict=True):
            value = float(number.get_text().replace("\N{MINUS SIGN}", "-"))
            assert value * 10.0**power + start == pytest.approx(
                position, rel=1e-12, abs=1e-15
            )
        assert "m/s\N{SUPERSCRIPT TWO})" in label


@pytest.fixture
def sampled_slope(eq12_posterior, monkeypatch):
    """A fit with a condition estimated, and Gaussian samples of all its parameters."""
    fit, chain = eq12_posterior
    slope = replace(
        fit.parameters["mu1_xi"],
        value=0.0,
        verdict=Verdict.PRIOR,
        unit="m/m",
        symbol="s_x",
        typical=1e-3,
        lower=-np.inf,
        upper=np.inf,
    )
    start = {
        name: fit.parameters[name]
        for name in list(fit.parameters)[len(fit.coefficients) :]
    }
    parameters = {**fit.coefficients, "slope_x": slope, **start}
    rng = np.random.default_rng(2)
    samples = {name: rng.normal(size=60_000) for name in parameters}
    monkeypatch.setattr(Chain, "of", lambda self, weights: samples[next(iter(weights))])
    plain = replace(
        fit,
        parameters=parameters,
        combinations=(),
        identifiability=replace(fit.identifiability, null_directions=()),
        reference=None,
    )
    return plain, chain


def test_a_corner_has_the_conditions_that_were_estimated(sampled_slope):
    fit, chain = sampled_slope
    figure = corner_figure(fit, chain)
    assert len(figure.axes) == 15
    below = [axes.get_xlabel() for axes in figure.axes[-5:]]
    symbols = [f"${coefficient.symbol}$" for coefficient in fit.coefficients.values()]
    for label, symbol in zip(below, [*symbols, "$s_x$ (m/m)"], strict=True):
        assert label.startswith(symbol)
    held = {
        **fit.parameters,
        "slope_x": replace(fit.parameters["slope_x"], verdict=Verdict.FIXED),
    }
    assert len(corner_figure(replace(fit, parameters=held), chain).axes) == 10


def test_regions_of_a_corner_hold_the_shares_they_say(sampled_slope):
    """Of independent normal variables the regions are circles, of squared radius
    -2 ln(1 - p)."""
    from matplotlib.contour import QuadContourSet

    figure = corner_figure(*sampled_slope)
    (lines,) = [
        collection
        for collection in figure.axes[1].collections
        if isinstance(collection, QuadContourSet) and not collection.filled
    ]
    radii = [np.hypot(*path.vertices.T).mean() for path in lines.get_paths()]
    expected = np.sqrt(-2 * np.log(1 - np.array([0.95, 0.68])))
    assert radii == pytest.approx(expected, rel=0.05)


# --- a fit ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("times", "channels"),
    [
        (1.0, ("x", "y", "phi")),
        (1e-9, ("x", "y", "phi", "speed", "omega")),
        (1e200, ("x", "y", "phi", "speed", "omega")),
    ],
)
def test_texts_of_a_fit_lie_within_the_figure(eq12_fit, times, channels):
    rng = np.random.default_rng(0)
    count = len(eq12_fit.observed["t"])
    observed = dict(eq12_fit.observed)
    fitted = dict(eq12_fit.fitted)
    for name in channels:
        observed[name] = fitted[name] + times * rng.normal(size=count)
    rms = {name: times * (1 + 0.1 * k) for k, name in enumerate(channels)}
    odd = replace(eq12_fit.data, file="x" * 250 + ".csv")
    figure = fit_figure(
        replace(eq12_fit, observed=observed, fitted=fitted, rms=rms, data=odd)
    )
    require_room(figure)
    boxes = [axes.title.get_window_extent() for axes in figure.axes if axes.get_title()]
    assert len(boxes) == len(channels)
    assert not [1 for a, b in combinations(boxes, 2) if a.overlaps(b)]


def lines_of(axes):
    """By label, what the lines show."""
    return {
        line.get_label(): np.array([line.get_xdata(), line.get_ydata()])
        for line in axes.lines
    }


def test_a_fit_with_a_discrepancy_is_drawn_with_it(eq12_fit):
    t = eq12_fit.observed["t"]
    missing = {name: (0.01 + k) * np.sin(t) for k, name in enumerate(eq12_fit.fitted)}
    fit = replace(eq12_fit, discrepancy=missing)
    path, *residuals, speed, spin = fit_figure(fit).axes
    shown = lines_of(path)
    for label, series in (
        ("data", fit.observed),
        ("law alone", fit.fitted),
        ("law and discrepancy", fit.predicted),
    ):
        np.testing.assert_allclose(shown[label], [series["y"], series["x"]])
    (alone,) = [line for line in path.lines if line.get_label() == "law alone"]
    assert alone.get_linestyle() == "--"
    for axes, name in zip(residuals, ("x", "y", "phi"), strict=True):
        (drawn,) = [
            line.get_ydata() for line in axes.lines if len(line.get_ydata()) == len(t)
        ]
        left = fit.observed[name] - fit.fitted[name] - missing[name]
        scale = np.abs(left).max() / np.abs(drawn).max()
        np.testing.assert_allclose(drawn * scale, left, atol=1e-12)
        rms = np.sqrt(np.mean(left**2))
        number, unit = axes.get_title().split("rms ")[1].split()
        size = {"m": 1, "mm": 1e-3, "rad": 1, "mrad": 1e-3}[unit]
        assert float(number) * size == pytest.approx(rms, rel=0.006)
        assert "of both" in axes.get_ylabel()
    for axes, name in ((speed, "speed"), (spin, "omega")):
        drawn = [
            line.get_ydata() for line in axes.lines if len(line.get_ydata()) == len(t)
        ]
        np.testing.assert_allclose(drawn, [fit.predicted[name], fit.fitted[name]])


def test_slopes_of_data_are_those_of_the_motion():
    """Of evenly spaced rows a straight line has the slope of a parabola
    at the middle."""
    t = np.linspace(2.0, 12.0, 201)
    x = 3 * t - 0.1 * t**2
    phi = 0.5 * t**2
    gap = (t > 5) & (t < 6)
    slopes = measured_slopes(t, np.where(gap, np.nan, x), phi)
    # away from groups on both sides of the gap
    away_from_gap = np.abs(slopes.at - 5.5) > 1
    at = slopes.at[away_from_gap]
    speed, spin = slopes.values[:, away_from_gap]
    np.testing.assert_allclose(speed, 3 - 0.2 * at, rtol=1e-9)
    np.testing.assert_allclose(spin, at, rtol=1e-9)
    assert 0.15 < slopes.duration < 0.3
    nothing = measured_slopes(t, np.full(201, np.nan))
    assert nothing.at.shape == (0,)
    assert nothing.values.shape == (1, 0)


# --- files ----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def written(eq12_posterior, tmp_path_factory):
    """The figures of a fit in all formats, written twice, once under other settings of
    matplotlib."""
    from matplotlib import rc_context

    folders = [tmp_path_factory.mktemp(name) for name in ("one", "other")]
    everything = FigureFiles.of("png, pdf,svg")
    fit, chain = eq12_posterior
    two = with_coefficients(fit, 2)

    def draw():
        return {"fit": fit_figure(fit), "corner": corner_figure(two, chain)}

    files = write_figures(folders[0], draw(), everything.formats)
    with rc_context(
        {"font.size": 25, "pdf.fonttype": 3, "axes.grid": True, "lines.linewidth": 9}
    ):
        again = write_figures(folders[1], draw(), everything.formats)
    return files, again


def test_files_are_of_the_format_they_are_named_for_with_text_in_embedded_fonts(
    written,
):
    begins = {".png": b"\x89PNG\r\n", ".pdf": b"%PDF-", ".svg": b"<?xml"}
    assert {file.name for file in written[0]} == {
        f"{name}{suffix}" for name in ("fit", "corner") for suffix in begins
    }
    for file in written[0]:
        content = file.read_bytes()
        assert content.startswith(begins[file.suffix])
        assert len(content) < 1_000_000
        if file.suffix == ".pdf":
            fonts = content.count(b"/Type /FontDescriptor")
            assert fonts > 0
            assert content.count(b"/FontFile2") == fonts  # TrueType
            assert b"/Type3" not in content
            assert b"CreationDate" not in content
        if file.suffix == ".svg":
            assert (
                b"jensen_shegelski_2004.csv: front-back law, uniform load</text>"
                in content
            )
            assert b"<dc:date>" not in content


def test_the_same_figure_is_the_same_file_under_any_settings(written):
    for file, again in zip(*written, strict=True):
        assert file.read_bytes() == again.read_bytes(), file.name


def test_formats_are_checked(tmp_path):
    assert FigureFiles.of(None).formats == ("png",)
    assert FigureFiles.of("pdf,PNG,pdf").formats == ("pdf", "png")
    assert FigureFiles.of(None, none=True).formats == ()
    for text in ("gif", "png,,pdf", ""):
        with pytest.raises(
            curlfit.InputError, match=r"--figures .*: expected png, pdf or svg"
        ):
            FigureFiles.of(text)
    with pytest.raises(curlfit.InputError, match="--no-figures draws nothing"):
        FigureFiles.of("pdf", none=True)


def test_figures_of_an_earlier_result_do_not_stay(tmp_path):
    def draw():
        return {"a": Picture(figsize=(1, 1))}

    def names():
        return sorted(file.name for file in tmp_path.iterdir())

    (tmp_path / "data.svg").write_text("of the user")
    FigureFiles.of("png,svg").replace(tmp_path, ["a", "b"], draw)
    assert names() == ["a.png", "a.svg", "data.svg"]
    (tmp_path / "b.pdf").write_text("of another result")
    FigureFiles.of("pdf").replace(tmp_path, ["a", "b"], draw)
    assert names() == ["a.pdf", "data.svg"]
    FigureFiles.of(None, none=True).replace(tmp_path, ["a", "b"], draw)
    assert names() == ["data.svg"]


@pytest.mark.parametrize(
    ("size", "channel", "unit"),
    [
        (0.0205, "y", (1e-3, "mm")),
        (3.0, "x", (1.0, "m")),
        (2e-6, "x", (1e-6, "\N{MICRO SIGN}m")),
        (0.00126, "phi", (1e-3, "mrad")),
        (2.0, "phi", (1.0, "rad")),
        (109.0, "phi", (2 * np.pi, "turns")),
        (0.0, "speed", (1e-6, "\N{MICRO SIGN}m/s")),
    ],
)
def test_units_go_by_size(size, channel, unit):
    assert unit_for(size, channel) == unit


# --- several throws -------------------------------------------------------------------


def a_joint_result(throws, differences):
    return JointResult(
        law="front-back",
        load=Load.UNIFORM,
        share=("mu1_xi",),
        converged=True,
        status="converged",
        warnings=(),
        coefficients={},
        combinations=(),
        identifiability=DeterminedTogether(rank=1, parameters=1),
        variation=differences,
        throws=throws,
    )


def test_throws_of_a_stop_watch_have_no_path_to_draw(eq12_fit):
    variation = Variation(
        "mu1_xi", ((0.01, 1e-4), (0.02, 1e-4)), 0.0, 5e-3, 0.015, 5e-3
    )
    figure = joint_figure(
        a_joint_result((replace(eq12_fit, rms={}),) * 2, (variation,))
    )
    require_room(figure)
    (estimates,) = figure.axes
    assert [container[0].get_xdata()[0] for container in estimates.containers] == [
        0.01,
        0.02,
    ]
    assert "mu_{1" in estimates.get_xlabel()
    assert "p < 0.001" in estimates.get_title(loc="left")


def test_a_joint_figure_has_the_units_of_what_varies(eq12_fit):
    estimates = ((2.0, 0.1), (2.1, 0.1))
    variations = tuple(
        Variation(name, estimates, 0.3, 0.0, 2.05, 0.1) for name in ("v0", "mu1_xi")
    )
    throws = (replace(eq12_fit, rms={}),) * 2
    of_speed, of_friction = joint_figure(a_joint_result(throws, variations)).axes
    assert of_speed.get_xlabel().endswith("(m/s)")
    assert "(" not in of_friction.get_xlabel()


def test_a_joint_figure_has_room_for_all(eq12_fit):
    throws = tuple(
        replace(eq12_fit, data=replace(eq12_fit.data, file=f"season/throw-{k:02d}.csv"))
        for k in range(12)
    )
    estimates = tuple((0.0417265 + 1e-6 * k, 2e-6) for k in range(12))
    differences = tuple(
        Variation(name, estimates, 0.3, 0.0, 0.04172, 1e-6)
        for name in ("mu1_xi", "mu2_xi", "mu1_eta + mu2_eta")
    )
    figure = joint_figure(a_joint_result(throws, differences))
    require_room(figure)
    assert max(axes.get_position().x1 for axes in figure.axes) > 0.97
