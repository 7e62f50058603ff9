"""Whether two versions of curlfit answer alike.

    python tests/two_versions/compare_versions.py [--against COMMIT] [--own FOLDER]

asks this checkout and an earlier commit, installed in an environment of its own, the
same commands: every verb on the shipped files and on 200 synthetic throws of all laws.
It prints what was compared, with the largest difference of each kind, and each answer
that differs, unless `tests/expected_changes.toml` names it. Exit status 1 where an
answer differs that is not named there, or where one that is named does not differ.

It takes some 12 minutes on two cores. `--against` may also be the Python of an
environment that exists; `--keep FOLDER` keeps environment and answers, and goes on from
them; `--case "front-back*"` asks a part; `--own FOLDER` adds tables of one's own.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

from commands import Case, own_cases, shipped_cases, synthetic_cases, timed_cases
from differences import Comparison, Difference
from versions import (
    ROOT,
    Version,
    ask,
    checkout,
    commit_in_environment,
    git,
    installed,
    is_ancestor,
)

EXPECTED_CHANGES = ROOT / "tests" / "expected_changes.toml"


@dataclass(frozen=True)
class ExpectedChange:
    """Answers that are meant to differ from those of the base."""

    step: str
    """the work that changed them"""
    reason: str
    case: str
    """the case, as a pattern of file names"""
    place: str
    """file and place in it, as such a pattern"""

    def covers(self, difference: Difference) -> bool:
        return fnmatchcase(difference.case, self.case) and fnmatchcase(
            difference.place, self.place
        )


@dataclass(frozen=True)
class ExpectedChanges:
    """The changes since a commit, the base."""

    base: str
    changes: tuple[ExpectedChange, ...]

    @classmethod
    def read(cls, file: Path = EXPECTED_CHANGES) -> ExpectedChanges:
        record = tomllib.loads(file.read_text(encoding="utf-8"))
        changes = (ExpectedChange(**change) for change in record.get("change", ()))
        return cls(record["base"], tuple(changes))

    def unexpected(self, differences: Iterable[Difference]) -> list[Difference]:
        """Differences that no change covers."""
        return [
            difference
            for difference in differences
            if not any(change.covers(difference) for change in self.changes)
        ]

    def unmatched(self, comparison: Comparison) -> list[ExpectedChange]:
        """Changes of the compared cases that cover no difference; the case of the quick
        test is none of all cases."""
        return [
            change
            for change in self.changes
            if any(fnmatchcase(case, change.case) for case in comparison.case_names)
            and not any(
                change.covers(difference) for difference in comparison.differences
            )
        ]


def main() -> int:
    """Compare two versions by the command line; returns the exit status."""
    expected = ExpectedChanges.read()
    options = parsed_options(expected.base)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(options.keep or scratch).resolve()
        folder.mkdir(parents=True, exist_ok=True)
        before = version_named(options.against, folder)
        cases = [
            case
            for case in all_cases(folder, options.own)
            if fnmatchcase(case.name, options.case)
        ]
        versions = {"before": before, "after": checkout(folder / "sources")}
        answers = ask(versions, commands_by_case(cases, folder), folder, progress)
        print(file=sys.stderr)
        comparison = Comparison()
        names = [case.name for case in cases]
        comparison.cases(answers["before"], answers["after"], names)
    is_complete = options.case == "*" and is_base(options.against, expected.base)
    print(f"{before.name} and {versions['after'].name}, {len(cases)} cases")
    return report(comparison, expected, whole=is_complete)


def parsed_options(base: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--against",
        metavar="COMMIT|PYTHON",
        default=base,
        help=f"the version to compare with [default: {base}]",
    )
    parser.add_argument("--case", metavar="PATTERN", default="*", help="a part of it")
    parser.add_argument("--own", metavar="FOLDER", type=Path, help="tables to add")
    parser.add_argument("--keep", metavar="FOLDER", type=Path, help="keep all in it")
    return parser.parse_args()


def version_named(name: str, folder: Path) -> Version:
    """The version that a Python has installed, or that of a commit."""
    if Path(name).is_file():
        return installed(name)
    commit = git("rev-parse", "--short", name).decode().strip()
    return commit_in_environment(commit, folder / f"environment of {commit}")


def is_base(name: str, base: str) -> bool:
    """Whether a name means the base."""
    return is_ancestor(name, base) and is_ancestor(base, name)


def all_cases(folder: Path, own: Path | None) -> list[Case]:
    """The cases, whose synthetic throws are written to a folder."""
    throws = folder / "throws"
    throws.mkdir(exist_ok=True)
    cases = [*shipped_cases(), *synthetic_cases(throws), *timed_cases(throws)]
    if own is not None:
        cases += own_cases(own.resolve())
    return cases


def commands_by_case(
    cases: Iterable[Case], folder: Path
) -> dict[str, list[tuple[str, ...]]]:
    """The words of the commands, with the folders of data in them."""
    folders = {"DATA": str(ROOT / "data"), "THROWS": str(folder / "throws")}
    return {
        case.name: [
            tuple(with_folders(word, folders) for word in words)
            for words in case.commands
        ]
        for case in cases
    }


def with_folders(word: str, folders: dict[str, str]) -> str:
    name, slash, rest = word.partition("/")
    return f"{folders[name]}/{rest}" if slash and name in folders else word


def progress(words: str) -> None:
    """Say how far it is, on one line of a terminal."""
    if sys.stderr.isatty():
        print(f"\r{words}", end="", file=sys.stderr, flush=True)


def report(
    comparison: Comparison, expected: ExpectedChanges, *, whole: bool = True
) -> int:
    """Print what was compared and what differs; returns the exit status.

    Parameters
    ----------
    whole : whether all was compared with the base, so that each expected change must be
        among the differences.
    """
    unexpected = expected.unexpected(comparison.differences)
    unmatched = expected.unmatched(comparison) if whole else []
    print(f"{'compared':18} {'number':>8} {'differ':>7} {'expected':>9}  furthest")
    for kind, number in sorted(comparison.compared.items()):
        differ = sum(difference.kind == kind for difference in comparison.differences)
        surprises = sum(difference.kind == kind for difference in unexpected)
        distance, where = comparison.furthest.get(kind, (0.0, ""))
        furthest = f"{distance:.2g} of its tolerance, {where}" if where else ""
        print(f"{kind:18} {number:8} {differ:7} {differ - surprises:9}  {furthest}")
    listed = {
        "near a threshold": comparison.near_threshold,
        "not expected": unexpected,
        "expected, but not so": unmatched,
    }
    for heading, entries in listed.items():
        if entries:
            print(f"\n{heading}: {len(entries)}")
        for entry in entries:
            print(f"  {entry}")
    return 1 if unexpected or unmatched else 0


if __name__ == "__main__":
    sys.exit(main())
