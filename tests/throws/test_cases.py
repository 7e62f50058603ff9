"""Small files as people export, save and merge them, with what is right of each.

They were made by a simulation that shares no code with curlfit: of the tracks the truth
is in `cases/00_truth.csv`, of the evenings in the columns that are written otherwise.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import curlfit
from curlfit import InputError, Throw, load_throw, load_throws
from curlfit.findings import Finding

CASES = Path(__file__).parent / "cases"
TRUTH = load_throw(CASES / "00_truth.csv")
ROUNDED = 6e-5  # m and rad; half of the last digit of the truth
WHOLE_MM = 5.1e-4


def codes(notes: tuple[Finding, ...]) -> set[str]:
    """The codes of a reader's notes."""
    return {note.code for note in notes}


def require_truth(throw: Throw, channels: tuple[str, ...], tolerance: float) -> None:
    """Assert that the measured values of some channels, and no others, are those of the
    truth at the times since the first row."""
    assert throw.seen == channels
    rows = np.round(10 * (throw.t - throw.t[0])).astype(int)
    assert np.allclose(throw.t - throw.t[0], TRUTH.t[rows], atol=1e-5)
    for name in channels:
        off = getattr(throw, name) - getattr(TRUTH, name)[rows]
        assert np.nanmax(np.abs(off)) < tolerance


PATH = ("x", "y", "phi")


@pytest.mark.parametrize(
    ("file", "choices", "channels", "measured", "tolerance", "noted"),
    [
        ("01_lost_rows_minus_one.csv", {}, PATH, 175, ROUNDED, "placeholders"),
        ("04_phi_all_zero.csv", {}, ("x", "y"), 181, ROUNDED, "never-changes"),
        ("04_x_constant.csv", {}, ("y", "phi"), 181, ROUNDED, "never-changes"),
        ("11_header_in_comment.txt", {}, PATH, 181, ROUNDED, ""),
        ("12_minus_u2212.csv", {}, PATH, 181, ROUNDED, ""),
        ("13_quoted_decimal_commas.csv", {}, PATH, 181, ROUNDED, ""),
        ("14_days.csv", {"units": "t=days"}, PATH, 181, ROUNDED, "converted"),
        ("14_unix_ns.csv", {"units": "t=ns"}, PATH, 181, ROUNDED, "converted"),
        (
            "15_kinovea_hundredths.csv",
            {},
            ("x", "y"),
            181,
            WHOLE_MM,
            "clock-times-in-hundredths",
        ),
        ("15_past_a_minute.csv", {}, PATH, 181, ROUNDED, "clock-times"),
        ("17_lost_rows_inf.csv", {}, PATH, 175, ROUNDED, "gaps"),
        ("18_r_write_table.txt", {}, PATH, 181, ROUNDED, ""),
        ("19_thousands_whole_mm.tsv", {}, PATH, 181, WHOLE_MM, "thousands"),
        (
            "19_thousands_whole_mm.tsv",
            {"units": "length=mm"},
            PATH,
            181,
            WHOLE_MM,
            "thousands",
        ),
        (
            "20_metres_beside_pixels.csv",
            {},
            ("x", "y"),
            181,
            ROUNDED,
            "columns-ignored",
        ),
    ],
)
def test_a_track_is_read_as_the_truth(
    file: str,
    choices: dict[str, Any],
    channels: tuple[str, ...],
    measured: int,
    tolerance: float,
    noted: str,
) -> None:
    throw = load_throw(CASES / file, **choices)
    require_truth(throw, channels, tolerance)
    assert np.isfinite(getattr(throw, channels[0])).sum() == measured
    assert len(throw) == 181
    assert codes(throw.notes) >= ({noted} if noted else set())
    assert noted or not throw.notes


def test_an_angle_that_stands_still_is_named_and_moves_no_other() -> None:
    throw = load_throw(CASES / "01_angle_frozen_three_rows.csv")
    off = np.abs(throw.phi - TRUTH.phi)
    assert np.flatnonzero(off > 1e-6).tolist() == [60, 61, 62]
    (note,) = throw.notes
    assert note.code == "angles-off-course"
    assert "`--exclude 5.95:6.25`" in str(note)


@pytest.mark.parametrize(
    ("file", "noted"),
    [
        ("06_points_good.csv", {"pixels-to-metres"}),
        (
            "06_points_one_twice.csv",
            {"pixels-to-metres-by-four-points", "points-listed-twice"},
        ),
        ("06_points_one_misclick.csv", {"pixels-to-metres", "odd-points"}),
    ],
)
def test_known_points(file: str, noted: set[str]) -> None:
    """A point twice is one, and a point that was clicked wrongly is left out."""
    throw = load_throw(CASES / "06_track_pixels.csv", reference=CASES / file)
    assert codes(throw.notes) >= noted
    good = load_throw(
        CASES / "06_track_pixels.csv", reference=CASES / "06_points_good.csv"
    )
    assert np.abs(throw.x - good.x).max() < 0.02
    assert np.abs(throw.y - good.y).max() < 0.15


RIGHT = load_throws(CASES / "05_one_watch.csv")


def times(throws: list[Throw]) -> list[tuple[str, float]]:
    """The hog-to-hog time and the place of rest of each throw."""
    return [
        (event.name, round(event.value, 6))
        for throw in throws
        for event in throw.events
        if event.name in ("hog_to_hog", "rest")
    ]


@pytest.mark.parametrize(
    ("file", "noted"),
    [
        ("03_footer_mean.csv", "rows-below-the-table"),
        ("08_watch_durations.xlsx", ""),
        ("08_watch_minutes.csv", ""),
        ("09_title.csv", "lines-above-the-header"),
        ("09_units_row.csv", ""),
        ("10_heading_interval.csv", "columns-not-fitted"),
        ("11_watch_draw_number.csv", "columns-ignored"),
        ("21_sep_line_watch.csv", ""),
    ],
)
def test_an_evening_is_read_however_it_is_saved(file: str, noted: str) -> None:
    throws = load_throws(CASES / file)
    assert times(throws) == times(RIGHT)
    expected = codes(RIGHT[0].notes) | ({noted} if noted else set())
    assert codes(throws[0].notes) - {"columns-ignored"} == expected - {
        "columns-ignored"
    }
    assert codes(throws[0].notes) >= expected


def test_a_total_is_no_throw() -> None:
    throws = load_throws(CASES / "03_footer_total.csv")
    assert [throw.events[0].value for throw in throws] == [12.9, 13.1, 12.7, 13.0]
    (note,) = (note for note in throws[0].notes if note.code == "rows-below-the-table")
    assert str(note) == "1 row below the table left out: 'Total' (line 6)"


def test_a_throw_that_was_not_timed_is_a_gap() -> None:
    throws = load_throws(CASES / "10_cell_dnf_in_row_5.csv")
    right = times(RIGHT)
    assert times(throws) == right[:8] + right[10:]
    assert codes(throws[0].notes) >= {"gaps", "rows-without-a-time"}


def test_a_time_with_a_wrong_digit_is_named_and_left_out() -> None:
    throws = load_throws(CASES / "02_evening_typo_time_long.csv")
    right = times(load_throws(CASES / "02_evening_right.csv"))
    (odd,) = throws[0].odd_rows
    assert (odd.column, odd.value, odd.left_out) == ("hog to hog", 22.2, True)
    assert times(throws) == right[: 2 * odd.row - 2] + right[2 * odd.row :]


@pytest.mark.parametrize(
    ("file", "draws", "first", "labels"),
    [
        (
            "e01.csv",
            14,
            {"hog_to_hog": 13.2, "rest": 38.405 + 0.26},
            {"uhrzeit": "19:05", "bahn": "1"},
        ),
        (
            "e02.xlsx",
            16,
            {
                "hog_to_hog": 12.85,
                "hog_to_rest": 12.84,
                "rest": 38.405 + 33 * 0.0254,
                "curl": 36 * 0.0254,
                "turns": -2.75 * 2 * np.pi,
            },
            {"sheet": "A", "time": "19:05"},
        ),
        (
            "e03.csv",
            23,
            {
                "hog_to_hog": 13.41,
                "hog_to_rest": 13.13,
                "rest": 38.405 + 30 * 0.0254,
                "curl": -50 * 0.0254,
                "turns": 4 * 2 * np.pi,
            },
            {"sheet": "1", "handle": "out"},
        ),
        (
            "e09.csv",
            16,
            {"hog_to_hog": 13.06, "hog_to_rest": 12.64, "rest": 38.405 + 19 * 0.0254},
            {"rink": "North", "when": "7:05 pm"},
        ),
        (
            "dt.xlsx",
            16,
            {"hog_to_hog": 13.24, "rest": 38.405 - 0.0254},
            {"start": "2026-01-12 19:05", "sheet": "1"},
        ),
    ],
)
def test_an_evening_in_words_of_its_own(
    file: str, draws: int, first: dict[str, float], labels: dict[str, str]
) -> None:
    """German words, other names of the same times, clocks with p.m., two titles and a
    header that is repeated after the break."""
    throws = load_throws(CASES / "evenings" / file)
    assert len(throws) == draws
    values = {event.name: event.value for event in throws[0].events}
    assert values == pytest.approx(first)
    assert throws[0].labels.items() >= labels.items()


@pytest.mark.parametrize("file", ["07_season_de.csv", "07_season_bom.csv"])
def test_a_season_saved_again_by_a_spreadsheet_is_the_same(file: str) -> None:
    season = curlfit.fit_season(CASES / "07_season.csv")
    again = curlfit.fit_season(CASES / file)
    assert again.coefficients == season.coefficients
    assert again.combinations == season.combinations


@pytest.mark.parametrize(
    ("file", "choices", "sentence"),
    [
        (
            "05_two_watches_same_heading.csv",
            {},
            "line 1: columns 'hog to hog' (column 2) and 'hog to hog' (column 3) both "
            "mean hog_to_hog; rename or remove one",
        ),
        (
            "14_unix_ns.csv",
            {},
            "line 2, column timestamp: 1.76e+18 s found, expected at most 1e+12; it "
            "may be a time since 1970 in ns: give `--units t=ns`",
        ),
        (
            "06_track_pixels.csv",
            {},
            "positions are in pixels; give four or more known points with "
            "`--reference FILE`",
        ),
    ],
)
def test_a_refusal_says_what_to_write(
    file: str, choices: dict[str, Any], sentence: str
) -> None:
    with pytest.raises(InputError) as caught:
        load_throw(CASES / file, **choices)
    assert sentence in str(caught.value)


def test_times_in_days_are_recognised_before_a_fit() -> None:
    throw = load_throw(CASES / "14_days.csv")
    with pytest.raises(InputError, match="if the time is in days: `--units t=days`"):
        curlfit.fit(throw)


def test_the_friction_by_light_gates() -> None:
    """Of hog-to-hog times and speeds at the near hog line, with the errors of watches
    and barriers that are usual: five and more times as large as in this file."""
    throws = load_throws(CASES / "23_light_gates.csv")
    joint = curlfit.fit_together(throws, "coulomb")
    friction = joint.coefficients["mu"]
    assert friction.stderr < 1.2e-4
    assert abs(friction.value - 0.0092) < friction.stderr


def test_the_friction_of_an_evening() -> None:
    """The draws stopped under constant friction of 0.009284(54); how friction depends
    on speed they do not tell, and the error of its mean says so."""
    throws = load_throws(CASES / "02_evening_right.csv")
    constant = curlfit.fit_together(throws, "coulomb").coefficients["mu"]
    assert constant.value == pytest.approx(0.009284, abs=5.4e-5)
    assert constant.stderr == pytest.approx(5.4e-5, rel=0.3)
    joint = curlfit.fit_together(throws)
    friction = next(effect for effect in joint.groups if effect.parameter == "friction")
    assert abs(friction.value - constant.value) < 1.5 * friction.stderr
    assert friction.stderr < 5e-4
