"""What two versions of curlfit answer differently to the same commands.

Numbers are compared on the scale of their standard errors where they have one. The
tolerances are what is allowed to a change of the inside of curlfit that is meant to
change no answer. Printed numbers may differ by one unit of their last digit.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pages import (
    Page,
    Table,
    as_number,
    html_page,
    masked,
    numbers_in,
    parameters_of,
    printed_number,
    read_json,
    read_table,
    standard_errors,
    text_page,
)

VALUE = 1e-3
"""Tolerance of a value, in standard errors."""
STANDARD_ERROR = 1e-4
"""Tolerance of a standard error, relative."""
OTHER = 1e-4
"""Tolerance of other numbers, relative to the largest of a list or a table of them."""
POSTERIOR = 0.3
"""Tolerance of the quantiles of a sample, in standard deviations: of 4,000 effective
samples, the quantile at 2.5 % has a Monte Carlo error of 0.04."""
ROUNDING = 1e-9
"""Singular values over the largest, below which they are rounding errors."""
THRESHOLDS = {"stderr": (0.5,), "singular_values": (1.0, 1e-3)}
"""Standard error over typical size, and singular values, at which verdicts change (see
`curlfit.inference.information`)."""
NEAR = 0.02
"""Relative distance to a threshold within which a verdict may be another one."""

NOT_IDENTIFIABLE = "not identifiable"
PRINTED = (".out", ".md", ".tex")


@dataclass(frozen=True)
class Difference:
    """One answer that differs."""

    kind: str
    case: str
    place: str
    """the file and the place in it: `fitted/fit.json: parameters.mu1_xi.stderr`"""
    before: str
    after: str

    def __str__(self) -> str:
        return f"{self.case} | {self.place} | {self.before} -> {self.after}"


@dataclass
class Comparison:
    """Differences between the answers of two versions, and what was compared.

    Each method compares what stands at a place in the answers of the earlier version
    (`before`) and of the later one (`after`).
    """

    case: str = ""
    """the case that is being compared"""
    case_names: list[str] = field(default_factory=list)
    """the cases that were compared"""
    differences: list[Difference] = field(default_factory=list)
    near_threshold: list[Difference] = field(default_factory=list)
    """verdicts and combinations that differ in fits with a number near a threshold"""
    compared: Counter[str] = field(default_factory=Counter)
    """how many answers of each kind"""
    furthest: dict[str, tuple[float, str]] = field(default_factory=dict)
    """by kind, the largest difference of numbers over its tolerance, and where"""

    def cases(self, before: Path, after: Path, names: Sequence[str]) -> None:
        """Compare the answers to cases of these names."""
        for name in names:
            self.case = name
            self.case_names.append(name)
            self.folder(before / name, after / name)

    def folder(self, before: Path, after: Path) -> None:
        """Compare all files of a case."""
        names = self.names("files", "", files_in(before), files_in(after))
        for name in names:
            self.file(name, before / name, after / name)

    def file(self, name: str, before: Path, after: Path) -> None:
        """Compare a file by its kind; figures and chains are not read."""
        if before.name == "answers.json":
            statuses = [
                [answer["status"] for answer in read_json(file)]
                for file in (before, after)
            ]
            self.same("exit status", name, *statuses)
        elif before.suffix == ".json":
            self.value(f"{name}: ", read_json(before), read_json(after))
        elif before.suffix == ".csv":
            self.table(f"{name}: ", read_table(before), read_table(after))
        elif before.suffix == ".html":
            self.page(name, html_page(before), html_page(after))
        elif before.suffix == ".err":
            self.sentence("refusals", name, before.read_text(), after.read_text())
        elif before.suffix in PRINTED:
            self.page(name, text_page(before), text_page(after))

    # What all comparisons come to: equal things, numbers, names and sentences.

    def same(self, kind: str, place: str, before: Any, after: Any) -> bool:
        """Compare what must be equal; returns whether it is."""
        self.compared[kind] += 1
        if before == after:
            return True
        self.differ(kind, place, before, after)
        return False

    def differ(self, kind: str, place: str, before: Any, after: Any) -> None:
        """Note a difference."""
        difference = Difference(kind, self.case, place, str(before), str(after))
        self.differences.append(difference)

    def number(
        self, kind: str, place: str, before: float, after: float, tolerance: float
    ) -> None:
        """Compare two numbers, which may differ by a tolerance."""
        self.compared[kind] += 1
        if before == after or (math.isnan(before) and math.isnan(after)):
            return
        distance = abs(after - before) / tolerance if tolerance > 0 else math.inf
        if math.isnan(distance):
            distance = math.inf
        if distance > self.furthest.get(kind, (0.0, ""))[0]:
            self.furthest[kind] = (distance, f"{self.case} | {place}")
        if distance > 1:
            self.differ(kind, place, f"{before:.9g}", f"{after:.9g}")

    def names(
        self, kind: str, place: str, before: set[str], after: set[str]
    ) -> list[str]:
        """Compare sets of names; returns those in both."""
        self.compared[kind] += len(before | after)
        for name in sorted(before - after):
            self.differ(kind, f"{place}{name}", "there", "gone")
        for name in sorted(after - before):
            self.differ(kind, f"{place}{name}", "not there", "there")
        return sorted(before & after)

    def sentence(
        self, kind: str, place: str, before: str, after: str, relative: float = 0.0
    ) -> None:
        """Compare the words of a sentence, and the numbers in it as printed ones, or
        with a relative tolerance where they have more digits."""
        if self.same(kind, place, masked(before), masked(after)):
            numbers = numbers_in(before), numbers_in(after)
            self.printed(kind, place, *numbers, relative)

    def sentences(
        self, kind: str, place: str, before: Sequence[str], after: Sequence[str]
    ) -> None:
        """Compare sentences in any order."""
        by_words_before = {masked(sentence): sentence for sentence in before}
        by_words_after = {masked(sentence): sentence for sentence in after}
        in_both = self.names(
            kind, f"{place}: ", set(by_words_before), set(by_words_after)
        )
        for words in in_both:
            self.sentence(kind, place, by_words_before[words], by_words_after[words])

    def printed(
        self,
        kind: str,
        place: str,
        before: Sequence[str],
        after: Sequence[str],
        relative: float = 0.0,
    ) -> None:
        """Compare printed numbers, as many in both, by the unit of the last digit."""
        for text_before, text_after in zip(before, after, strict=True):
            number_before, unit_before = printed_number(text_before)
            number_after, unit_after = printed_number(text_after)
            unit = max(unit_before, unit_after)
            tolerance = max(1.01 * unit, relative * abs(number_before))
            self.number(kind, place, number_before, number_after, tolerance)

    # Records in JSON.

    def value(self, place: str, before: Any, after: Any) -> None:
        """Compare two values of JSON."""
        if is_number(before) and is_number(after):
            tolerance = OTHER * max(abs(before), abs(after))
            self.number("other numbers", place, before, after, tolerance)
        elif isinstance(before, str) and isinstance(after, str):
            self.sentence("texts", place, before, after)
        elif isinstance(before, dict) and isinstance(after, dict):
            self.record(place, before, after)
        elif isinstance(before, list) and isinstance(after, list):
            self.list(place, before, after)
        else:
            self.same("other values", place, before, after)

    def record(self, place: str, before: dict, after: dict) -> None:
        """Compare two objects of JSON: an estimate, a posterior, or others by key."""
        keys_in_both = before.keys() & after.keys()
        if {"value", "stderr"} <= keys_in_both:
            self.estimate(place, before, after)
        elif {"quantiles", "r_hat"} <= keys_in_both:
            self.posterior(place, before, after)
        elif "identifiability" in keys_in_both and (
            has_near_threshold(before) or has_near_threshold(after)
        ):
            self.fit_near_threshold(place, before, after)
        else:
            self.entries(place, before, after)

    def entries(self, place: str, before: dict, after: dict) -> None:
        """Compare two objects of JSON by key; numbers alone by the largest of them."""
        names = self.names("keys", place, set(before), set(after))
        numbers_before = [before[name] for name in names]
        numbers_after = [after[name] for name in names]
        if len(names) > 1 and all(map(is_number, numbers_before + numbers_after)):
            self.numbers(place, numbers_before, numbers_after, names)
            return
        for name in names:
            self.entry(f"{place}{name}", name, before[name], after[name])

    def entry(self, place: str, name: str, before: Any, after: Any) -> None:
        """Compare what stands under a key, by what is known of the key."""
        lists = isinstance(before, list) and isinstance(after, list)
        if name in ("warnings", "notes") and lists:
            self.sentences(name, place, before, after)
        elif name == "combinations" and lists:
            self.combinations(place, before, after)
        elif name == "null_directions" and lists:
            self.directions(place, before, after)
        elif name == "singular_values" and lists:
            self.singular_values(place, before, after)
        elif name in ("covariance", "information") and is_matrix(before):
            self.matrix(place, before, after)
        elif name in ("verdict", "rank"):
            self.same("verdicts", place, before, after)
        elif name == "status" and isinstance(before, str) and isinstance(after, str):
            self.sentence("status", place, before, after)
        else:
            inside = isinstance(before, dict) and isinstance(after, dict)
            self.value(f"{place}." if inside else place, before, after)

    def estimate(self, place: str, before: dict, after: dict) -> None:
        """Compare a value, its standard error, its verdict and what else is said."""
        error = before["stderr"]
        if is_number(error) and is_number(after["stderr"]):
            values = before["value"], after["value"]
            self.number("values", f"{place}value", *values, VALUE * error)
            errors = error, after["stderr"]
            tolerance = STANDARD_ERROR * error
            self.number("standard errors", f"{place}stderr", *errors, tolerance)
        else:
            self.same("standard errors", f"{place}stderr", error, after["stderr"])
            verdicts = before.get("verdict"), after.get("verdict")
            if NOT_IDENTIFIABLE not in verdicts:
                self.value(f"{place}value", before["value"], after["value"])
        names = self.names("keys", place, set(before), set(after))
        for name in names:
            if name == "quantiles" and is_number(error):
                quantiles = before[name], after[name]
                self.quantiles(f"{place}{name}", *quantiles, error)
            elif name not in ("value", "stderr"):
                self.entry(f"{place}{name}", name, before[name], after[name])

    def posterior(self, place: str, before: dict, after: dict) -> None:
        """Compare a sampled posterior within its Monte Carlo error."""
        self.same("status", f"{place}status", before["status"], after["status"])
        names = self.names("keys", f"{place}sd.", set(before["sd"]), set(after["sd"]))
        for name in names:
            quantiles = before["quantiles"][name], after["quantiles"][name]
            sd = before["sd"][name]
            self.quantiles(f"{place}quantiles.{name}", *quantiles, sd)

    def quantiles(
        self, place: str, before: dict | None, after: dict | None, sd: float
    ) -> None:
        """Compare quantiles by probability within their Monte Carlo error."""
        if not before or not after:
            self.same("posterior", place, before, after)
            return
        levels = self.names("posterior", f"{place}.", set(before), set(after))
        for level in levels:
            at_level = before[level], after[level]
            self.number("posterior", f"{place}.{level}", *at_level, POSTERIOR * sd)

    def combinations(self, place: str, before: list, after: list) -> None:
        """Compare weighted sums by the parameters in them."""
        sums_before = {
            parameters_of(combination["expression"]): combination
            for combination in before
        }
        sums_after = {
            parameters_of(combination["expression"]): combination
            for combination in after
        }
        in_both = self.names(
            "combinations", f"{place}.", set(sums_before), set(sums_after)
        )
        for names in in_both:
            self.record(f"{place}.{names}.", sums_before[names], sums_after[names])

    def directions(self, place: str, before: list, after: list) -> None:
        """Compare directions in parameter space, whose largest component is one."""
        if not self.same("directions", f"{place}: number", len(before), len(after)):
            return
        for weights_before, weights_after in zip(before, after, strict=True):
            names = self.names(
                "directions", f"{place}.", set(weights_before), set(weights_after)
            )
            for name in names:
                weights = weights_before[name], weights_after[name]
                self.number("directions", f"{place}.{name}", *weights, VALUE)

    def singular_values(self, place: str, before: list, after: list) -> None:
        """Compare singular values, largest first, with room for rounding errors."""
        if not self.same("other values", f"{place}: number", len(before), len(after)):
            return
        for singular_before, singular_after in zip(before, after, strict=True):
            singular = singular_before, singular_after
            tolerance = OTHER * max(singular) + ROUNDING * max(before)
            self.number("other numbers", place, *singular, tolerance)

    def matrix(self, place: str, before: dict, after: dict) -> None:
        """Compare a covariance or information matrix, in units of its diagonal."""
        if not self.same("keys", f"{place}.names", before["names"], after["names"]):
            return
        matrix_before = np.array(before["matrix"])
        matrix_after = after["matrix"]
        sizes = np.sqrt(np.abs(np.diag(matrix_before)))
        unit = np.maximum(np.outer(sizes, sizes), 1e-300)
        distances = np.abs(matrix_after - matrix_before) / unit
        furthest = float(distances.max(initial=0.0))
        self.number("other numbers", f"{place}.matrix", 0.0, furthest, OTHER)

    def fit_near_threshold(self, place: str, before: dict, after: dict) -> None:
        """Compare two fits whose verdicts may differ: those are listed apart."""
        comparison = Comparison(self.case)
        comparison.entries(place, before, after)
        for difference in comparison.differences:
            if difference.kind in ("verdicts", "combinations"):
                self.near_threshold.append(difference)
            else:
                self.differences.append(difference)
        self.compared += comparison.compared
        for kind, (distance, where) in comparison.furthest.items():
            if distance > self.furthest.get(kind, (0.0, ""))[0]:
                self.furthest[kind] = (distance, where)

    def list(self, place: str, before: list, after: list) -> None:
        """Compare two lists of JSON: numbers as an array, else each item."""
        array_before = as_array(before)
        array_after = as_array(after)
        if array_before is not None and array_after is not None:
            shapes = array_before.shape, array_after.shape
            if self.same("other values", f"{place}: shape", *shapes):
                self.numbers(place, array_before.ravel(), array_after.ravel())
            return
        if self.same("other values", f"{place}: number", len(before), len(after)):
            pairs = zip(before, after, strict=True)
            for index, (item_before, item_after) in enumerate(pairs):
                self.value(f"{place}.{index}.", item_before, item_after)

    def numbers(
        self,
        place: str,
        before: Sequence[float],
        after: Sequence[float],
        names: Sequence[str] = (),
    ) -> None:
        """Compare numbers of one kind: by the one that is furthest off."""
        if not len(before):
            return
        before, after = np.asarray(before, float), np.asarray(after, float)
        equal = (before == after) | (np.isnan(before) & np.isnan(after))
        distances = np.where(equal, 0.0, np.abs(after - before))
        distances = np.where(np.isnan(distances), np.inf, distances)
        worst = int(distances.argmax())
        size = np.abs(before[np.isfinite(before)]).max(initial=0.0)
        name = names[worst] if names else str(worst)
        values = float(before[worst]), float(after[worst])
        self.compared["other numbers"] += len(before) - 1
        self.number("other numbers", f"{place}.{name}", *values, float(OTHER * size))

    # Tables, printed pages and reports.

    def table(self, place: str, before: Table, after: Table) -> None:
        """Compare a table by column; values beside their standard errors by these."""
        for name in self.names("keys", place, set(before), set(after)):
            cells_before = before[name]
            cells_after = after[name]
            lengths = len(cells_before), len(cells_after)
            if not self.same("other values", f"{place}{name}: rows", *lengths):
                continue
            errors = standard_errors(name, before)
            kind = "values"
            if errors is None:
                numbers = (as_number(cell) for cell in cells_before)
                largest = max((abs(n) for n in numbers if n is not None), default=0.0)
                errors = [OTHER / VALUE * largest] * len(cells_before)
                kind = "other numbers"
            rows = zip(cells_before, cells_after, errors, strict=True)
            for row, (cell_before, cell_after, error) in enumerate(rows, start=1):
                where = f"{place}{name} of row {row}"
                number_before, number_after = map(as_number, (cell_before, cell_after))
                if number_before is None or number_after is None:
                    words = "verdicts" if name.endswith("verdict") else "texts"
                    self.sentence(words, where, cell_before, cell_after, OTHER)
                elif error is not None:  # else it is not identifiable
                    numbers = number_before, number_after
                    self.number(kind, where, *numbers, VALUE * error)

    def page(self, place: str, before: Page, after: Page) -> None:
        """Compare a page by its headings, the words in its tables, and its numbers."""
        if not self.same("headings", place, before.headings, after.headings):
            return
        lengths = len(before.numbers), len(after.numbers)
        if self.same("printed numbers", f"{place}: how many", *lengths):
            self.printed("printed numbers", place, before.numbers, after.numbers)


def files_in(folder: Path) -> set[str]:
    """Names of all files in a folder and those in it."""
    files = (file for file in folder.rglob("*") if file.is_file())
    return {str(file.relative_to(folder)) for file in files}


def is_number(value: Any) -> bool:
    """Whether a value of JSON is a number."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def is_matrix(value: Any) -> bool:
    """Whether a value of JSON is a matrix with the names of its rows."""
    return isinstance(value, Mapping) and {"names", "matrix"} <= value.keys()


def as_array(values: list) -> np.ndarray | None:
    """Numbers in a regular shape, gaps as NaN; None if the values are other things."""
    try:
        return np.array(values, dtype=float)
    except (TypeError, ValueError):
        return None


def has_near_threshold(fit: Mapping) -> bool:
    """Whether a number of a fit lies near a threshold at which its verdicts change."""
    identifiability = fit["identifiability"]
    ratios = [
        parameter["stderr"] / parameter["typical"] / threshold
        for parameter in fit.get("parameters", {}).values()
        for threshold in THRESHOLDS["stderr"]
        if parameter["stderr"] and parameter.get("typical")
    ]
    ratios += [
        singular / threshold
        for singular in identifiability.get("singular_values", ())
        for threshold in THRESHOLDS["singular_values"]
    ]
    return any(abs(ratio - 1) < NEAR for ratio in ratios)
