"""Findings: codes, words, records and `curlfit explain`."""

from __future__ import annotations

import json
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import pytest
from conftest import invoke

import curlfit
from curlfit import Finding
from curlfit.errors import InputError, Option
from curlfit.findings import Level, Remedy
from curlfit.findings.words import message_of, messages

ROOM = Path(curlfit.__file__).parent
WORDS = tomllib.loads((ROOM / "findings" / "messages.toml").read_text("utf-8"))
FAR = [{"name": "hog_to_hog", "sigmas": 4.9}, {"name": "curl", "sigmas": 5.25}]


def test_every_code_has_words_and_every_words_are_said():
    source = "\n".join(path.read_text("utf-8") for path in ROOM.rglob("*.py"))
    remedies = WORDS["remedies"]
    for code in [*messages(), *remedies]:
        assert f'"{code}"' in source, code
    finding_codes = re.findall(
        r'Finding\.(?:warning|note|refusal)\(\s*"([^"]+)"', source
    )
    assert set(finding_codes) <= messages().keys()
    proposed = re.findall(r'\bRemedy\(\s*"([^"]+)"', source)
    assert set(proposed) <= remedies.keys()
    for code, message in messages().items():
        assert message.title, code
        assert message.means.strip(), code
        assert not message.says.endswith("."), code


def test_a_sentence_has_the_numbers_in_their_formats():
    remedy = Remedy("power-law", Option("law", "power"))
    finding = Finding.warning("events-missed", remedy, events=FAR, law="coulomb")
    assert str(finding) == (
        "the fit deviates from hog_to_hog by 4.9 sigma, curl by 5.2 sigma: the coulomb "
        "law does not describe the throw, or the value was mismeasured or mistyped; "
        "`--law power` lets the friction change with the speed"
    )
    assert finding.options == (Option("law", "power"),)


@pytest.mark.parametrize(
    ("count", "line", "said"),
    [
        (1, None, "one outlier: x at t = 2.5 s, 13 robust sigma off"),
        (1, 7, "one outlier: x at t = 2.5 s (line 7), 13 robust sigma off"),
        (3, 7, "3 outliers, the farthest: x at t = 2.5 s (line 7), 13 robust sigma"),
    ],
)
def test_one_is_said_otherwise_than_several(count, line, said):
    finding = Finding.warning(
        "outliers", count=count, channel="x", t=2.5, line=line, sigmas=12.7
    )
    assert str(finding).startswith(said)


def test_throws_that_a_finding_is_about_come_first():
    finding = Finding.note("text", text="rows are sorted")
    assert str(finding.of("a", "b")) == "a and b: rows are sorted"
    assert str(finding.of("a", "b", "c", "d")) == "a, b and 2 more: rows are sorted"


def test_findings_compare_by_what_they_say():
    finding = Finding.warning(
        "outliers", count=1, channel="x", t=2.5, line=7, sigmas=13.0
    )
    twin = Finding.warning("outliers", count=1, channel="x", t=2.5, line=7, sigmas=13.0)
    assert list(dict.fromkeys([finding, twin])) == [finding]
    assert replace(finding, numbers=finding.numbers | {"t": 3.0}) != finding


@pytest.mark.parametrize(
    ("option", "typed"),
    [
        (Option("as-given"), "`--as-given`"),
        (Option("as-given", in_python=True), '`Throw.from_arrays(..., defaults={"as'),
        (Option("axes", left_out=True), "leave out `--axes`"),
        (Option("units", "t=ms"), "`--units t=ms`"),
        (
            Option("units", "t=ms", in_python=True),
            '`Throw.from_arrays(..., units="t=ms")`',
        ),
        (Option("loss", "student", in_python=True), "`loss=student`"),
    ],
)
def test_an_option_is_written_as_it_is_typed(option, typed):
    assert str(option).startswith(typed)


# Records


@pytest.fixture(scope="module")
def record():
    """A saved fit that has warnings."""
    throw = curlfit.load_throw(Path(__file__).parents[2] / "data/without_angle.csv")
    fit = curlfit.fit(throw, "front-back", details=False)
    assert {"two-solutions", "curve"} <= {finding.code for finding in fit.warnings}
    return fit


def test_a_record_has_sentences_and_codes(record):
    entries = json.loads(json.dumps(record.to_json()))
    assert entries["warnings"] == list(map(str, record.warnings))
    codes = [finding["code"] for finding in entries["findings"]]
    assert codes == [finding.code for finding in record.warnings]
    again = curlfit.FitResult.from_json(entries)
    assert again.warnings == record.warnings


def test_a_record_of_an_earlier_version_keeps_its_sentences(record):
    entries = record.to_json()
    del entries["findings"]
    again = curlfit.FitResult.from_json(entries)
    assert {finding.code for finding in again.warnings} == {"text"}
    assert list(map(str, again.warnings)) == list(map(str, record.warnings))
    assert {finding.level for finding in again.warnings} == {Level.WARNING}


@pytest.mark.parametrize(
    "change", [{"code": "found-on-mars"}, {"numbers": {}}, {"numbers": {"open": 3}}]
)
def test_a_code_that_is_not_known_keeps_its_sentence(record, change):
    entries = json.loads(json.dumps(record.to_json()))
    entries["findings"][0] |= change
    again = curlfit.FitResult.from_json(entries)
    assert str(again.warnings[0]) == str(record.warnings[0])
    assert again.warnings[0].code == "text"
    assert again.warnings[1:] == record.warnings[1:]


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("findings", [], "findings are not those of its warnings and notes"),
        ("findings", 3, "findings are not those of its warnings and notes"),
        ("warnings", [1, 2, 3, 4], "1 found, expected text"),
        ("warnings", "text", "expected a list"),
    ],
)
def test_a_damaged_record_is_refused(record, key, value, said):
    with pytest.raises(curlfit.DataError, match=said):
        curlfit.FitResult.from_json(record.to_json() | {key: value})


# curlfit explain


def test_explain_says_what_a_code_means():
    text = " ".join(invoke(["explain", "correlated", "at-bound"]).stdout.split())
    assert text.startswith("correlated: the residuals are correlated from row to row")
    for code in ("correlated", "at-bound"):
        assert " ".join(message_of(code).means.split()) in text
    listed = invoke(["explain"]).stdout
    assert {line.split()[0] for line in listed.splitlines()} >= messages().keys()


def test_explain_refuses_what_is_no_code():
    with pytest.raises(InputError, match="no finding 'at-bund'; did you mean at-bound"):
        message_of("at-bund")
    refused = invoke(["explain", "xyz"])
    assert refused.exit_code == 2
    assert "`curlfit explain` lists the codes" in str(refused.exception)
