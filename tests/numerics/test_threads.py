"""Programs that are loaded or compiled in threads before they are needed, and results of these."""

from __future__ import annotations

import time

import pytest
from conftest import STRICT, python

from curlfit.numerics.threads import cores, in_threads

CODE = """
import numpy as np
from curlfit.numerics import compiled as programs
from curlfit.numerics import program_cache as cache

traced = []

@programs.compiled("word")
def twice(word, values):
    traced.append(word)
    return {"of": values * 2, "word": (values,)} if word == "double" else values

"""
CALLS = """
assert twice("double", np.arange(3.0))["of"].tolist() == [0.0, 2.0, 4.0]
assert twice("same", np.arange(3.0)).tolist() == [0.0, 1.0, 2.0]
print(len(traced))
"""
two_cores = pytest.mark.skipif(cores() < 2, reason="nothing is done beside on a single core")


@pytest.fixture
def run(tmp_path):
    """Run code in a new process whose cache lies in a folder of the test; what it prints."""

    def run(code, **settings):
        place = {"CURLFIT_CACHE": str(tmp_path / "cache")}
        done = python(*STRICT, "-c", CODE + code, **(place | settings))
        assert (done.returncode, done.stderr) == (0, "")
        return int(done.stdout)

    return run


@two_cores
def test_a_program_in_preparation_is_compiled_once(run):
    prepared = 'twice.prepare("double", np.ones(3)); twice.prepare("double", np.zeros(3))\n'
    assert run(prepared + CALLS) == 2
    # What the thread has read stands though no file can be read any more.
    read = "while not any(p.done() for p in programs._programs.values()): pass\n"
    unreadable = "cache.read = lambda file: None\n"
    assert run(prepared + read + unreadable + CALLS) == 1


def test_an_error_in_preparation_comes_with_the_call(run):
    code = """
@programs.compiled()
def wrong(values):
    raise ValueError("no such path")

wrong.prepare(np.ones(3))
try:
    wrong(np.ones(3))
except ValueError as error:
    print(str(error) == "no such path" and 7)
"""
    assert run(code) == 7


def test_results_of_threads_come_in_order_and_errors_where_they_belong():
    with in_threads(lambda a, b: a - b, [(3, 1), (5, 4), (9, 2)]) as results:
        assert list(results) == [2, 1, 7]
    begun = []

    def inverse(number):
        begun.append(number)
        time.sleep(0.001)  # the other threads begin no more than a few
        return 1 / number

    with in_threads(inverse, [(1,), (0,)] * 50) as results:
        assert next(results) == 1.0
        with pytest.raises(ZeroDivisionError):
            next(results)
    assert len(begun) < 100
