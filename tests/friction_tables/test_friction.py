"""Laws fitted to tables of friction against speed, beside closed forms and scipy."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from conftest import DATA, invoke
from sample_files import CELL, ods
from scipy.optimize import curve_fit

import curlfit
from curlfit.throws.friction_table import is_friction_table

SUTOR = DATA.parent / "sutor_1988_friction.csv"
# those of most tests, for one program
LAWS = ["coulomb", "power", "front-back", "sutor"]


@pytest.fixture(scope="module")
def table():
    return curlfit.load_friction_table(SUTOR)


@pytest.fixture(scope="module")
def found(table):
    return curlfit.fit_friction(table, LAWS)


def of(found, law):
    (fit,) = [fit for fit in found.fits if fit.law == law]
    return fit


def test_constant_friction_is_the_mean_with_its_error(found, table):
    n = len(table.mu)
    mu = of(found, "coulomb").coefficients["mu"]
    assert mu.value == pytest.approx(table.mu.mean(), rel=1e-9)
    assert mu.stderr == pytest.approx(table.mu.std(ddof=1) / np.sqrt(n), rel=1e-6)
    assert mu.dof == pytest.approx(n - 1)


def test_errors_that_are_given_are_weights(table):
    sigma = np.where(table.speed < 1, 0.001, 0.004)
    fit = curlfit.fit_friction(replace(table, sigma=sigma), "coulomb").fits[0]
    weight = 1 / sigma**2
    mu = fit.coefficients["mu"]
    assert mu.value == pytest.approx((weight * table.mu).sum() / weight.sum(), rel=1e-9)
    assert mu.stderr == pytest.approx(weight.sum() ** -0.5, rel=1e-6)
    assert mu.dof is None


def test_a_power_of_the_speed_as_scipy_fits_it(found, table):
    values, covariance = curve_fit(
        lambda v, c, k: c * v**k,
        table.speed,
        table.mu,
        (0.01, 0.0),
        xtol=1e-12,
        ftol=1e-12,
    )
    power = of(found, "power").coefficients
    assert [power["c"].value, power["k"].value] == pytest.approx(values, rel=1e-4)
    errors = [power["c"].stderr, power["k"].stderr]
    assert errors == pytest.approx(np.sqrt(np.diag(covariance)), rel=1e-3)


def test_friction_does_not_determine_the_split_nor_what_pushes_sideways(found, table):
    law = of(found, "front-back")
    assert all(
        coefficient.verdict == "not identifiable"
        for coefficient in law.coefficients.values()
    )
    (combination,) = law.combinations
    assert combination.expression == "mu1_eta + mu2_eta"
    # without spin, along the motion: half the sum
    assert combination.value == pytest.approx(2 * table.mu.mean(), rel=1e-6)


def test_the_law_of_the_table_is_found_in_exact_values_of_it():
    law = curlfit.LAWS["sutor"](0.0066, 3.0, 2.0, 0.0, 0.065)
    speed = np.linspace(0.3, 4, 30)
    a = 2 * (3 - np.sqrt(8))
    mu = 0.0066 / 4 * (speed + a + 4 / (speed + a))
    table = curlfit.FrictionTable("exact", speed, mu, np.zeros(30), np.full(30, 1e-5))
    fits = curlfit.fit_friction(table, LAWS).fits
    assert fits[0].law == "sutor"
    assert fits[0].rms < 1e-8
    assert fits[0].coefficients["v_b"].value == pytest.approx(law.v_b, rel=1e-3)


def test_a_record_comes_back_whole(found, tmp_path):
    found.save(tmp_path / "friction.json")
    again = curlfit.load_friction(tmp_path)
    assert again.to_json() == found.to_json()
    assert "sutor" in repr(again)
    entries = found.to_json()
    entries["observed"]["mu"].pop()
    (tmp_path / "friction.json").write_text(json.dumps(entries))
    with pytest.raises(curlfit.DataError, match="expected series of 12 values each"):
        curlfit.load_friction(tmp_path)


def test_units_and_a_column_of_spin(write):
    file = write(
        "speed_kmh;friction;spin_rpm;sigma\n3,6;0,01;0;0,001\n7,2;0,011;6;0,001\n"
        "1;0,012;3;0,002\n"
    )
    table = curlfit.load_friction_table(file)
    assert table.speed == pytest.approx([1.0, 2.0, 1 / 3.6])
    assert table.omega == pytest.approx([0.0, 0.2 * np.pi, 0.1 * np.pi])
    assert table.sigma == pytest.approx([0.001, 0.001, 0.002])


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        (
            "1,0.01\n2,low\n3,0.02\n",
            "line 3, column mu: 'low' found, expected a finite number",
        ),
        (
            "1,0.01\n2,2\n3,0.02\n",
            "line 3, column mu: 2 found, expected a number above 0, up to 1",
        ),
        ("-1,0.01\n2,0.01\n3,0.02\n", "line 2, column speed: -1 found"),
        ("1,0.01\n2,0.01\n", "2 rows, expected at least 3"),
        ("1,0.01\n2,\n3,x\n4,0.01\n", "2 rows, expected at least 3"),
    ],
)
def test_what_is_refused(rows, said, write):
    with pytest.raises(curlfit.DataError) as error:
        curlfit.load_friction_table(write(f"speed,mu\n{rows}"))
    assert said in str(error.value)


def test_a_throw_is_no_such_table(write):
    assert is_friction_table(SUTOR)
    assert not is_friction_table(DATA)
    assert not is_friction_table(write("t,speed,mu\n0,2,0.01\n"))
    assert not is_friction_table(write("1,2\n3,4\n"))


def test_the_commands(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = invoke(
        ["compare", SUTOR, "--laws", ",".join(LAWS), "--no-figures", "--report"]
    )
    assert done.exit_code == 0, done.exception
    assert (
        "sutor describes the values best by BIC; the others are far behind."
        in done.stdout
    )
    folder = tmp_path / "sutor_1988_friction-compare"
    laws = [fit.law for fit in curlfit.load_friction(folder).fits]
    assert laws == ["sutor", "coulomb", "front-back", "power"]
    assert (folder / "report.html").is_file()
    done = invoke(["fit", SUTOR, "--law", "sutor", "--fix", "r=2"])
    assert done.exit_code == 2
    assert "--fix=r=2" in str(done.exception)
    assert not (tmp_path / "sutor_1988_friction-fit").exists()


def test_a_worksheet_of_a_workbook_is_chosen_by_its_name(tmp_path):
    pytest.importorskip("python_calamine")

    def cells(mu: float) -> list[str]:
        head = CELL.format("string", "", "speed") + CELL.format("string", "", "mu")
        values = [(v, mu) for v in (0.5, 1.0, 2.0)]
        return [head] + [
            "".join(
                CELL.format("float", f'office:value="{number}"', number)
                for number in row
            )
            for row in values
        ]

    file = ods(tmp_path / "friction.ods", cells(0.01), warm=cells(0.02))
    assert curlfit.load_friction_table(file).mu.tolist() == [0.01] * 3
    warm = curlfit.load_friction_table(file, "warm")
    assert warm.mu.tolist() == [0.02] * 3
    assert str(warm.notes[0]) == (
        "2 worksheets: evening, warm; taken: warm; `--worksheet NAME` selects another"
    )
    assert is_friction_table(file, "warm")
    assert not is_friction_table(file, "cold")


def test_columns_and_units_are_the_user_s(write):
    """Those of a track that is read beside the table are none of it."""
    rows = "7.2,0.009\n3.6,0.0095\n1.8,0.011\n"
    file = write("Tempo,Reibung\n" + rows)
    named = {"speed": "Tempo", "mu": "Reibung", "t": "When"}
    assert not is_friction_table(file)
    assert is_friction_table(file, named=named)
    table = curlfit.load_friction_table(file, columns=named, units="speed=km/h")
    assert table.speed.tolist() == pytest.approx([2.0, 1.0, 0.5])
    assert table.mu.tolist() == [0.009, 0.0095, 0.011]
    assert not is_friction_table(write("t,x,y\n" + 3 * "1,2,3\n"), named=named)
