"""Damaged files, and what the command does with each.

`python damaged_files.py FOLDER SEED COUNT` lets the command have COUNT files (20000,
say), some of them under hostile names or with a configuration file, each in a process
of its own that is forked from this one, and prints a `Tally` as JSON. A forked process
needs what a fresh one would, but for the half second of its imports. With `grids` as
a fourth word, all files are workbooks.
"""

from __future__ import annotations

import gc
import json
import os
import random
import resource
import signal
import sys
import traceback
from collections.abc import Callable
from contextlib import redirect_stdout, suppress
from dataclasses import asdict, dataclass, field
from io import StringIO
from pathlib import Path
from typing import NamedTuple
from xml.sax.saxutils import escape

from sample_files import EXPORTS, SAMPLES, known_points, ods, xlsx, xlsx_rows

from curlfit.cli import main
from curlfit.throws.load import FORMATS

MOST_MB = 500
_SECONDS = 10  # of a processor that a file may take
_FIT_SECONDS = 120  # and a fit of one or a page, where the model must be compiled
_WAIT = 10  # times as long by the clock, on a busy machine

_PIECES = [
    "",
    ",",
    ";",
    "\t",
    " ",
    "\n",
    "\r",
    '"',
    "'",
    "#",
    "=",
    "nan",
    "inf",
    "-inf",
    "1e999",
    "-",
    "--",
    "1e308",
    "-1e308",
    "1e-320",
    "999999999999999999999",
    "1_0",
    "0x1p3",
    "١٢",
    "NaN",
    "null",
    "true",
    "{",
    "}",
    "[",
    "]",
    "{}",
    "[]",
    ":",
    "[" * 3000,
    "0" * 5000,
    "9" * 5000,
    "\x00",
    "\ufeff",
    "\u2028",
    "\x1c",
    "\x85",
    "é",
    "θ_{r}",
    "t",
    "x",
    "y",
    "u",
    "v",
    "phi",
    "t_phi",
    "# axes = 'x-along'\n",
    "# until = inf\n",
    "# stone = {R = 1}\n",
    "# sigma.x = 1\n",
    "# reference.law = 1\n",
    "# law = 'nothing'\n",
    "hog_to_hog = 1\n",
    "curl = 1e5 ft\n",
    '"trajectory": 1',
    '"team": 3',
    '"index": -1',
    '"index": true',
    '"time_history": [0, 0.1, 0.1]',
    '"stones": [{}]',
    '"color": 3',
    "0.25",
    "-0.25",
    "1e9",
    "DNF",
    "x",
    "\u22120,5",
    '"0,5"',
    "1,085",
    "1.085,3",
    "985",
    "59.9",
    "1:00.0",
    "00:12:86",
    "0:00:12:86",
    "7:05 pm",
    "99:99:99",
    "12/01/2026 19:05",
    "31.02.2026 25:61",
    "2026-01-12 19:05",
    "0000-00-00 00:00",
    "99/99/99 1:1",
    "sep=;\n",
    "# t x y phi\n",
    "(s),(m),(m),(rad)\n",
    "Mean,12.8,0.5\n",
    "=SUM(B2:B9)\n",
    "after the break\n",
    "# columns.hog_to_hog = 'x'\n",
    "speed,mu\n",
]


def damaged_text(chance: random.Random, text: str) -> str:
    """A text with some damage."""
    for _ in range(chance.choice([1, 1, 1, 2, 5])):
        a, b = sorted(chance.randrange(len(text) + 1) for _ in range(2))
        kind = chance.choice([0, 1, 2, 2, 2, 3, 3, 4, 4, 5, 6, 6, 8, 8, 8, 8, 7])
        if kind == 0:
            text = text[:a]
        elif kind == 1:
            text = text[:a] + text[min(b, a + 30) :]
        elif kind == 2:
            text = text[:a] + chance.choice(_PIECES) + text[a:]
        elif kind == 3:
            text = text[:a] + chance.choice(_PIECES) + text[min(b, a + 5) :]
        elif kind == 4:  # a line lost, doubled or moved
            lines = text.split("\n")
            k = chance.randrange(len(lines))
            line = lines.pop(k)
            lines[chance.randrange(len(lines) + 1) : 0] = [line] * chance.randrange(3)
            text = "\n".join(lines)
        elif kind == 5:
            mark, replacement = chance.sample(
                [",", ";", "\t", " ", ".", "\n", "0", "1", "-"], 2
            )
            text = text.replace(mark, replacement, chance.choice([1, 5, -1]))
        elif kind == 8:  # another digit
            text = text[:a] + chance.choice("0123456789") + text[a + 1 :]
        elif kind == 6:
            text = (
                text[:a]
                + chr(chance.choice([0, 9, 11, 34, 44, 59, 127, 160, 8722]))
                + text[a:]
            )
        else:
            text = text[a : a + 300] + text[b:]
        text = text[:1_000_000] or " "
    return text


def damaged(chance: random.Random) -> bytes:
    """A sample with some damage."""
    samples = [*SAMPLES.values(), *EXPORTS.values()]
    text = damaged_text(chance, chance.choice(samples))
    raw = text.encode(
        chance.choice(["utf-8"] * 6 + ["utf-8-sig", "utf-16", "utf-16-le"])
    )
    if chance.random() < 0.2:
        k = chance.randrange(len(raw))
        raw = raw[:k] + bytes([chance.randrange(256)]) + raw[k + 1 :]
    return raw


_PLACES = ["XFD1048576", "A1048576", "XFD1", "E9", "A2000000", "ZZZZZZ1", "a0", "1A"]
_PLACES += ["", "A99999999999", "$A$3", "AB", "A1:B2"]
_REPEATED = [2, 30, 900, 16384, 1048576, 10**9, 10**30, 0, -1]
_VALUES_OF_CELLS = [
    "<c><v>1e999</v></c>",
    '<c t="s"><v>7</v></c>',
    '<c t="s"><v>-1</v></c>',
    '<c t="d"><v>2026-01-05T19:05:00</v></c>',
    '<c t="e"><v>#DIV/0!</v></c>',
    '<c t="b"><v>1</v></c>',
    '<c t="q"><v>x</v></c>',
    '<c s="99"><v>44000.5</v></c>',
    "<c><f>1+1</f></c>",
    "<c/>",
    "<c><v/></c>",
    "<v>1</v>",
    "<row><c><v>1</v></c></row>",
    "<row",
    "</sheetData>",
    "&x;",
    "<!-- -->",
    "<![CDATA[<c>]]>",
]


def grid(chance: random.Random, file: Path) -> None:
    """A workbook whose cells are few, far apart, repeated or of no kind."""
    text = chance.choice([SAMPLES["table"], SAMPLES["timings"], "a,b\n1,2\n", ""])
    if chance.random() < 0.3:
        rows = [
            "".join(_repeated_cell(chance, cell) for cell in line.split(","))
            for line in text.splitlines()
        ]
        rows += _repeated_rows(chance)
        ods(file, rows)
    else:
        rows = xlsx_rows(text)
        for _ in range(chance.choice([0, 1, 1, 2, 4])):
            cut = chance.choice([len(rows), rows.find("<c>") if "<c>" in rows else 0])
            rows = rows[:cut] + _stray_cell(chance) + rows[cut:]
        xlsx(file, *[xlsx_rows("a,b\n"), rows][:: chance.choice([1, -1])])
    raw = file.read_bytes()
    if chance.random() < 0.1:
        k = chance.randrange(len(raw))
        file.write_bytes(raw[:k] + bytes([chance.randrange(256)]) + raw[k + 1 :])


def _stray_cell(chance: random.Random) -> str:
    if chance.random() < 0.5:
        return chance.choice(_VALUES_OF_CELLS)
    reference = chance.choice(_PLACES)
    row = chance.choice(["", ' r="5"', ' r="1048576"', ' r="-1"', ' r="x"'])
    return f'<row{row}><c r="{reference}"><v>1</v></c></row>'


def _repeated_cell(chance: random.Random, text: str) -> str:
    number = chance.choice(_REPEATED) if chance.random() < 0.005 else 1
    repeated = f' table:number-columns-repeated="{number}"' if number != 1 else ""
    if not text:
        return f"<table:table-cell{repeated}/>"
    return (
        f'<table:table-cell office:value-type="string"{repeated}><text:p>'
        f"{escape(text)}</text:p></table:table-cell>"
    )


def _repeated_rows(chance: random.Random) -> list[str]:
    """Rows within rows, as `ods` puts each text into one of its own."""
    if chance.random() < 0.5:
        return []
    rows = chance.choice(_REPEATED)
    empty = f'<table:table-row table:number-rows-repeated="{rows}"/>'
    return [f"</table:table-row>{empty}<table:table-row>", chance.choice(["", CELL_1])]


CELL_1 = '<table:table-cell office:value-type="float" office:value="1"/>'
_KEYS = [
    "law",
    "load",
    "since",
    "until",
    "exclude",
    "swept",
    "stone",
    "stone.R",
    "stone.m",
    "sigma.x",
    "fix",
    "fix.v0",
    "bound.mu1_xi",
    "bound",
    "start.v0",
    "unbounded",
    "free",
    "prior.rho",
    "systematic.slope_x",
    "loss",
    "noise",
    "seed",
    "derive",
    "format",
    "axes",
    "units",
    "reference",
    "stone_index",
    "shot",
    "handle",
    "as_given",
    "stone." + "a." * 300 + "a",
    '"\\u001b[31m"',
    "q",
]
_VALUES = [
    "1",
    "-1",
    "0",
    "0.054",
    "1e308",
    "-1e308",
    "nan",
    "inf",
    "-inf",
    "1e-320",
    "9" * 400,
    "true",
    "0x" + "f" * 900,
    "''",
    "'front-back'",
    "'coulomb'",
    "'x'",
    f"'{'x' * 900}'",
    "2026-01-05",
    "14:03:22",
    "[]",
    "[1]",
    "[2, 5]",
    "[5, 2]",
    "[[2, 5]]",
    "[[1, 'a']]",
    "['rho']",
    "{}",
    "{a = 1}",
    "{v0 = 2}",
    "{mu1_xi = [0, inf]}",
    "[" * 60000,
    "[\n" * 30000,
    '"\\u202e"',
    "'1+-0.1'",
    "'white'",
]
_NAMES = [
    "..csv",
    "...csv",
    "-x.csv",
    "--law.csv",
    "a$b_{.csv",
    "$$.csv",
    "=1+1.csv",
    "[red].csv",
    "~.csv",
    "\x1b]0;title\x07.csv",
    "\u202efdp.csv",
    "\u65e5\u672c.csv",
    "n\nl.csv",
    "end. .csv",
    "NUL.csv",
    "x" * 255,
    ":smile:.csv",
    "_u.csv",
    "a\udcffb.csv",
    "a row 3",
    "%s{0}.csv",
    "*?.csv",
    "'\".csv",
    " ",
]


def settings(chance: random.Random) -> bytes:
    """A configuration file, most of whose values have a wrong type."""
    lines = [
        f"{chance.choice(_KEYS)} = {chance.choice(_VALUES)}"
        for _ in range(chance.choice([1, 1, 2, 4]))
    ]
    lines *= chance.choice([1] * 30 + [3000])
    text = "\n".join(lines)
    if chance.random() < 0.2:
        k = chance.randrange(len(text))
        text = text[:k] + chance.choice(_PIECES) + text[k:]
    return text.encode()


def arguments(chance: random.Random, folder: Path) -> list[str]:
    """A damaged file written to the folder, and words that have the command read it."""
    file = folder / "damaged"
    points = folder / "points.csv"
    if chance.random() < 0.1:
        file = folder / chance.choice(_NAMES)
    raw = damaged(chance)
    words = [f"{file}"]
    if chance.random() < 0.15:
        words.append(f"--format={chance.choice(FORMATS)}")
    if chance.random() < 0.2:
        axes = ["x-along", "clockwise,x-left", "y-back,from-tee", "q", ""]
        words.append(f"--axes={chance.choice(axes)}")
    if chance.random() < 0.1:
        words.append(f"--stone-index={chance.choice([-1, 0, 1, 2, 9, 10**9])}")
    if chance.random() < 0.1:
        words.append(f"--shot={chance.choice([0, 1, 2, 99])}")
    if chance.random() < 0.1:
        units = ["x=cm", "angle=deg,t=ms", "x=px,y=px", "x=kg", "=", "length=ft"]
        units += ["t=10fps", "t=10fps,length=m"]
        words.append(f"--units={chance.choice(units)}")
    if chance.random() < 0.2:
        (folder / "settings.toml").write_bytes(settings(chance))
        words.append(f"--config={folder / 'settings.toml'}")
    if chance.random() < 0.2:
        spoiled = chance.random() < 0.5
        points.write_bytes(raw if spoiled else known_points().encode())
        words.append(f"--reference={points}")
        if spoiled:
            raw = SAMPLES["pixels"].encode()
    file.write_bytes(raw)
    verb = chance.random()
    if verb < 0.01:
        out = [
            "--no-sample",
            "--no-figures",
            "--law=coulomb",
            f"--out={folder / 'fit'}",
        ]
        return ["fit", *words, *out]
    return [
        "check",
        *words,
        *([f"--out={folder / 'check.png'}"] if verb < 0.02 else []),
    ]


class Outcome(NamedTuple):
    """How a process ended: exit status (minus the signal, if one ended it),
    and its needs."""

    status: int
    megabytes: float
    errors: str

    def fault(self) -> str | None:
        """What is wrong with it, if anything is."""
        if self.status not in (0, 1, 2):
            return f"exit status {self.status}"
        if self.megabytes > MOST_MB:
            return f"{self.megabytes:.0f} MB"
        lines = self.errors.splitlines()
        wanted = 0 if self.status == 0 else 1
        if len(lines) != wanted or not all(
            line.startswith("curlfit: ") for line in lines
        ):
            return "not one sentence on stderr"
        return None


def forked(words: list[str], errors: Path) -> Outcome:
    """The command in a copy of this process, which writes its stderr to `errors`."""
    child = os.fork()
    if not child:
        status = 70
        try:
            for name, stream in ((os.devnull, 1), (str(errors), 2)):
                os.dup2(
                    os.open(name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), stream
                )
            limit = _FIT_SECONDS if words[0] in ("fit", "report") else _SECONDS
            resource.setrlimit(resource.RLIMIT_CPU, (limit, limit + 1))
            signal.alarm(_WAIT * limit)
            sys.argv[1:] = words
            main()
            status = 0
        except SystemExit as end:
            status = (
                end.code if isinstance(end.code, int) else 0 if end.code is None else 70
            )
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(status)
    _, wait, usage = os.wait4(child, 0)
    message = errors.read_text(errors="replace")
    return Outcome(os.waitstatus_to_exitcode(wait), usage.ru_maxrss / 1024, message)


@dataclass
class Tally:
    """What became of many files: how many ended with each status, and
    what was wrong."""

    statuses: dict[str, int] = field(default_factory=dict)
    faults: list[str] = field(default_factory=list)

    def add(self, outcome: Outcome, what: str) -> None:
        """Count one more."""
        status = str(outcome.status)
        self.statuses[status] = self.statuses.get(status, 0) + 1
        fault = outcome.fault()
        if fault is not None:
            self.faults.append(f"{what}: {fault}: {outcome.errors[-2000:]}")


def of_grid(chance: random.Random, folder: Path) -> list[str]:
    """An odd workbook written to the folder, and words that have the command
    read it."""
    file = folder / "grid.xlsx"
    grid(chance, file)
    return ["check", f"{file}", *chance.choice([[], [], ["--worksheet=s1"]])]


def tally(
    folder: Path,
    seed: int,
    count: int,
    made: Callable[[random.Random, Path], list[str]] = arguments,
) -> Tally:
    """What becomes of `count` files of a seed."""
    chance = random.Random(seed)
    errors = folder / "errors"
    outcomes = Tally()
    for k in range(count):
        words = made(chance, folder)
        outcomes.add(forked(words, errors), f"seed {seed}, file {k}, {words}")
    return outcomes


def imported(folder: Path) -> None:
    """Import what the command imports on its way, once for all copies of
    this process."""
    points = folder / "points.csv"
    points.write_text(known_points())
    for sample, words in (("table", []), ("pixels", [f"--reference={points}"])):
        file = folder / sample
        file.write_text(SAMPLES[sample])
        with redirect_stdout(StringIO()), suppress(SystemExit):
            sys.argv[1:] = ["check", str(file), *words]
            main()


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    seed = int(sys.argv[2])
    count = int(sys.argv[3])
    made = of_grid if "grids" in sys.argv[4:] else arguments
    imported(folder)
    gc.freeze()  # pages that copies need not write to
    print(json.dumps(asdict(tally(folder, seed, count, made))))
