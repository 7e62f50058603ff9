"""The commands of two commits, each installed in an environment of its own, in turns.

    python tests/benchmarks/commits.py COMMIT [--now COMMIT] [--keep FOLDER]

Prints a table in Markdown: time and memory of an earlier commit and of a later one,
that of this checkout, and their ratio. The programs are compiled anew for each first
run. `--keep` keeps the environments for the next time.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
from collections.abc import Iterator
from itertools import count
from pathlib import Path

import numpy as np
from run import DATA, Usage, measured, row

sys.path.append(str(Path(__file__).parents[1] / "two_versions"))
from versions import Version, commit_in_environment, git

WITHOUT_ANGLE = [str(DATA.with_name("without_angle.csv"))]
WITHOUT_ANGLE += ["--law", "power+transverse", "--sigma", "x=0.005,y=0.005"]
"""Values of `b` and the spin that fit lie on a curve."""
THROWS = 2000
"""Of a batch, whose time is that of the processor, with all workers."""
TURNS = 5


class Timed:
    """One of the two commits: its command, and folders of its own."""

    def __init__(self, version: Version, folder: Path) -> None:
        self.version = version
        self.folder = folder
        self.caches: Iterator[Path] = (folder / f"programs {n}" for n in count())
        self.cache = next(self.caches)
        folder.mkdir(exist_ok=True)

    def forget_programs(self) -> None:
        """Have the next command compile its programs."""
        self.cache = next(self.caches)

    def run(self, *words: str) -> Usage:
        """Run a command; its results are written to a folder `out`."""
        curlfit = [self.version.python, "-P", "-m", "curlfit"]
        environment = self.version.environment(self.cache)
        return measured([*curlfit, *words], environment)


def commands(folder: Path) -> dict[str, list[str]]:
    """The commands that are timed, by name; later ones use results of the first."""
    fitted = str(folder / "fitted")
    out = ["--out", str(folder / "out")]
    return {
        "fit": ["fit", str(DATA), "--no-sample", "--out", fitted],
        "fit with posterior": ["fit", str(DATA), *out],
        "fit without an angle": ["fit", *WITHOUT_ANGLE, "--no-sample", *out],
        "the same with posterior": ["fit", *WITHOUT_ANGLE, *out],
        "compare --load both": ["compare", str(DATA), "--load", "both", *out],
        "predict --to-tee": ["predict", fitted, "--to-tee", *out],
    }


def compare_commands(before: Timed, after: Timed) -> None:
    """Each command: first, with nothing compiled, and then in turns."""
    for name in commands(before.folder):
        usages = {}
        for commit in (before, after):
            commit.forget_programs()
            usages[commit] = [commit.run(*commands(commit.folder)[name])]
        for _ in range(TURNS):
            for commit in (before, after):
                usages[commit].append(commit.run(*commands(commit.folder)[name]))
        first = [usages[commit][0] for commit in (before, after)]
        later = [median(usages[commit][1:]) for commit in (before, after)]
        for label, (earlier, now) in ((f"{name}, first", first), (name, later)):
            row(
                label,
                f"{earlier.seconds:.2f} s, {earlier.memory:.0f} MB",
                f"{now.seconds:.2f} s, {now.memory:.0f} MB",
                now.seconds / earlier.seconds,
            )


def compare_batch(before: Timed, after: Timed, throws: Path) -> None:
    """Processor time of a batch of throws of 150 to 200 rows, in three turns."""
    write_throws(throws)
    usages: dict[Timed, list[Usage]] = {before: [], after: []}
    for turn in range(4):
        for commit in (before, after):
            table = commit.folder / f"season {turn}.csv"
            usages[commit].append(commit.run("batch", str(throws), "--out", str(table)))
    earlier, now = (median(usages[commit][1:]) for commit in (before, after))
    row(
        f"batch of {THROWS}, processor",
        f"{earlier.processor:.1f} s, {earlier.memory:.0f} MB",
        f"{now.processor:.1f} s, {now.memory:.0f} MB",
        now.processor / earlier.processor,
    )


def median(usages: list[Usage]) -> Usage:
    """The median of each number."""
    return Usage(*map(statistics.median, zip(*usages, strict=True)))


def write_throws(folder: Path) -> None:
    """Throws of the front-back law to first order (eq. 27), in closed form.

    With deceleration a, v = v0 - a t; the spin is omega0 (v/v0)^q, and the path turns
    at the rate g R (mu1_xi - mu2_xi) omega/(pi v^2).
    """
    folder.mkdir()
    random = np.random.default_rng(5)
    R = 0.065
    rho = 0.1025
    g = 9.81
    for number in range(THROWS):
        mu1_xi = random.uniform(0.001, 0.01)
        mu2_xi = random.uniform(0.03, 0.06)
        a = g * random.uniform(0.014, 0.02) / 2
        v0 = random.uniform(1.8, 2.4)
        omega0 = random.choice([-1, 1]) * random.uniform(0.5, 2)
        step = 0.01
        t = np.arange(0.0, (v0 - 0.35) / a, step)
        v = v0 - a * t
        q = g * R**2 * (mu1_xi + mu2_xi) / (4 * rho**2) / a
        omega = omega0 * (v / v0) ** q
        heading = integral(g * R * (mu1_xi - mu2_xi) / np.pi * omega / v**2, step)
        columns = [
            t,
            integral(v * np.sin(heading), step) + random.normal(0, 0.005, len(t)),
            integral(v * np.cos(heading), step) + random.normal(0, 0.005, len(t)),
            integral(omega, step) + random.normal(0, 0.01, len(t)),
        ]
        rows = np.column_stack(columns)[::8]
        file = folder / f"{number:05}.csv"
        np.savetxt(file, rows, "%.5f", ",", header="t,x,y,phi", comments="")


def integral(rates: np.ndarray, step: float) -> np.ndarray:
    """The integral from the first time on, by the trapezoidal rule."""
    return np.append(0.0, np.cumsum((rates[1:] + rates[:-1]) / 2 * step))


def main() -> None:
    """Compare the commits by the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("commit", help="the earlier commit")
    parser.add_argument("--now", default="HEAD", help="the later one [default: HEAD]")
    parser.add_argument("--keep", type=Path, help="folder for the environments")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        kept = Path(options.keep or scratch).resolve()
        kept.mkdir(parents=True, exist_ok=True)
        timed = []
        for name in (options.commit, options.now):
            commit = git("rev-parse", "--short", name).decode().strip()
            version = commit_in_environment(commit, kept / f"environment of {commit}")
            timed.append(Timed(version, Path(scratch, commit)))
        before, after = timed
        row("command", before.version.name, after.version.name, "ratio")
        row(*["---"] * 4)
        compare_commands(before, after)
        compare_batch(before, after, Path(scratch, "throws"))


if __name__ == "__main__":
    main()
