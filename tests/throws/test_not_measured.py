"""Numbers in a table that stand for no measurement."""

import numpy as np
import pytest
from sample_files import note_on

from curlfit import Throw, load_throw


def table_of(folder, x, y, phi):
    t = np.arange(len(x)) / 10
    rows = zip(t, x, y, phi, strict=True)
    lines = ["t,x,y,phi", *(",".join(f"{value:.4f}" for value in row) for row in rows)]
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
    note = note_on(throw, "placeholders")
    assert str(note) == (
        f"3 rows with {number:g} in every column taken as not measured, the first in "
        "line 22; `--as-given` keeps them"
    )
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
    assert note_on(throw, "never-changes").numbers == {"quantity": name, "value": 2.0}
    kept = load_throw(table_of(tmp_path, *columns), as_given=True)
    assert (getattr(kept, name) == 2.0).all()


def test_few_equal_values_are_measured(tmp_path, path):
    columns = [channel[:8] for channel in path]
    columns[2] = np.full(8, 2.0)
    assert np.isfinite(load_throw(table_of(tmp_path, *columns)).phi).all()


def without(values, rows):
    return [None if row in rows else value for row, value in enumerate(values)]


@pytest.mark.parametrize("given", [np.ma.masked_array, "Float64", "object", list])
def test_masked_and_missing_entries_of_arrays_are_gaps(path, given):
    rows = (3, 17)
    t = np.arange(60) / 10
    channels = []
    for values in path:
        missing = np.isin(np.arange(60), rows)
        if given is np.ma.masked_array:
            # what is below a mask may be anything
            spoiled = np.where(missing, -999.0, values)
            channels.append(np.ma.masked_array(spoiled, mask=missing))
        elif given is list:
            channels.append(without(values, rows))
        else:
            pandas = pytest.importorskip("pandas")
            dtype = object if given == "object" else given
            cells = without(values, rows)
            cells = [pandas.NA if value is None else value for value in cells]
            channels.append(pandas.Series(cells, dtype=dtype))
    throws = [
        Throw.from_arrays(t, *channels),
        Throw.from_arrays(t, *channels, units="angle=rad"),
        Throw(t, *channels),
    ]
    for throw in throws:
        for channel, values in zip((throw.x, throw.y, throw.phi), path, strict=True):
            assert np.flatnonzero(np.isnan(channel)).tolist() == list(rows)
            kept = np.delete(values, rows)
            np.testing.assert_array_equal(np.delete(channel, rows), kept)


def test_a_masked_sigma_is_one_of_a_gap(path):
    lost = np.arange(60) == 8
    x = np.ma.masked_array(path[0], mask=lost)
    sigma = np.ma.masked_array(np.full(60, 0.005), mask=lost)
    throw = Throw.from_arrays(np.arange(60) / 10, x, path[1], sigma={"x": sigma})
    assert np.isnan(throw.sigma["x"][lost]).all()
