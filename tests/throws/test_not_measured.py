"""Numbers in a table that stand for no measurement."""

import numpy as np
import pytest

from curlfit import load_throw


def table_of(folder, x, y, phi):
    t = np.arange(len(x)) / 10
    rows = zip(t, x, y, phi, strict=True)
    lines = ["t,x,y,phi", *(",".join(f"{one:.4f}" for one in row) for row in rows)]
    file = folder / "throw.csv"
    file.write_text("\n".join(lines) + "\n")
    return file


@pytest.fixture
def path():
    t = np.arange(60) / 10
    return -0.01 * t**2, 2.2 * t - 0.04 * t**2, 1.2 * t


@pytest.mark.parametrize("number", [-1.0, 0.0, -9999.0])
def test_rows_of_a_placeholder_are_not_measured_and_named(tmp_path, path, number):
    columns = [channel.copy() for channel in path]
    for channel in columns:
        channel[[20, 21, 40]] = number
    throw = load_throw(table_of(tmp_path, *columns))
    lost = [20, 21, 40]
    for channel in (throw.x, throw.y, throw.phi):
        assert np.isnan(channel[lost]).all()
        assert np.isfinite(np.delete(channel, lost)).all()
    (note,) = (note for note in throw.notes if "taken" in note)
    assert f"3 rows with {number:g} in every column" in note
    assert "the first in line 22" in note
    kept = load_throw(table_of(tmp_path, *columns), as_given=True)
    assert np.isfinite(kept.x).all()


def test_a_stone_at_rest_at_the_origin_is_measured(tmp_path, path):
    columns = [np.concatenate([np.zeros(5), channel]) for channel in path]
    throw = load_throw(table_of(tmp_path, *columns))
    assert np.isfinite(throw.x).all()


@pytest.mark.parametrize(("place", "name"), [(0, "x"), (2, "phi")])
def test_a_channel_that_never_changes_is_left_out(tmp_path, path, place, name):
    columns = list(path)
    columns[place] = np.full(60, 2.0)
    throw = load_throw(table_of(tmp_path, *columns))
    assert np.isnan(getattr(throw, name)).all()
    assert any(f"{name} is 2 in every row" in note for note in throw.notes)
    kept = load_throw(table_of(tmp_path, *columns), as_given=True)
    assert (getattr(kept, name) == 2.0).all()


def test_few_equal_values_are_measured(tmp_path, path):
    columns = [channel[:8] for channel in path]
    columns[2] = np.full(8, 2.0)
    assert np.isfinite(load_throw(table_of(tmp_path, *columns)).phi).all()
