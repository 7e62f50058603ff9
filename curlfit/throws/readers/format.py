"""What a format of data files says: which files it is, and the throws in one."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import NamedTuple

from curlfit.errors import DataError, InputError, Option
from curlfit.findings import Finding
from curlfit.settings.choices import Reading, given
from curlfit.throws.odd_row import OddRow
from curlfit.throws.readers.parsed_file import ParsedFile
from curlfit.throws.readers.text import TextFile

_NOTHING = {
    "worksheet": "no worksheets",
    "shot": "no shots",
    "stone_index": "one stone",
    "handle": "no objects",
    "keep": "no throws in rows",
    "columns": "no columns to be named",
}
_MOST_LISTED = 20


class Contents(NamedTuple):
    """The throws in a file.

    Attributes
    ----------
    labels : their names; one name without meaning where the file has only one.
    parse : reads the one of an index.
    among : indices of those that are throws by themselves; all, if None.
    note : makes the note on the one of several that is taken, from their number and
        its own; None for none.
    left_out : indices of those that a joint fit leaves out.
    odd_rows : those of a stopwatch table that contradict the others.
    """

    labels: Sequence[str]
    parse: Callable[[int], ParsedFile]
    among: Sequence[int] | None = None
    note: Callable[[int, int], Finding] | None = None
    left_out: Collection[int] = ()
    odd_rows: Sequence[OddRow] = ()


class Format(NamedTuple):
    """A format of data files.

    Attributes
    ----------
    name : as in `--format`.
    recognizes : whether a file is of this format, from its first lines without
        comments and blanks.
    contents : the throws in a file.
    what, selected_by : what a throw is called there, and the choice that selects it.
    usual : index of the one taken if none is selected; None if one must be selected.
    selections : all choices that select something in such a file.
    columns : quantities of its columns that no other format has.
    jointly : whether a joint fit takes all throws of such a file.
    """

    name: str
    recognizes: Callable[[list[str]], bool]
    contents: Callable[[TextFile, Reading], Contents]
    what: str
    selected_by: str
    usual: int | None
    selections: tuple[str, ...]
    columns: Collection[str] = ()
    jointly: bool = False

    def check(
        self, source: Path | str, reading: Reading, besides: Collection[str] = ()
    ) -> None:
        """Raise `InputError` for a choice of something that such files do not hold.

        Parameters
        ----------
        besides : choices that are checked elsewhere.
        """
        for name, what in _NOTHING.items():
            if name in self.selections or name in besides:
                continue
            if given(getattr(reading, name)):
                flag = name.replace("_", "-")
                raise InputError(
                    f"--{flag}: {source} is a {self.name} file and holds {what}"
                )

    def selected(
        self, source: Path | str, contents: Contents, number: int | None
    ) -> ParsedFile:
        """The throw of a number, counting from 1, or the usual one.

        Raises
        ------
        DataError : several throws, of which one must be selected, or one that
            determines nothing by itself. InputError : no such throw.
        """
        labels = contents.labels
        count = len(labels)
        flag = f"--{self.selected_by.replace('_', '-')}"
        if list(labels) == [""] and number is not None:
            raise InputError(
                f"{flag}: {source} is a {self.name} file and holds one stone"
            )
        if number is None and count > 1 and self.usual is None:
            listed = "; ".join(
                f"{k} {label}" for k, label in enumerate(labels[:_MOST_LISTED], 1)
            )
            more = f"; and {count - _MOST_LISTED} more" if count > _MOST_LISTED else ""
            select = Option(flag.removeprefix("--"), "N")
            fault = f"{count} {self.what}s; choose one with {select}: {listed}{more}"
            raise DataError(fault, file=source, options=(select,))
        index = choose(self.what, flag, number, labels, self.usual or 0)
        parsed = contents.parse(index)
        if parsed.alone is not None:
            raise parsed.alone
        if count > 1 and contents.note is not None:
            parsed.notes.insert(0, contents.note(count, index + 1))
        return parsed


def choose(
    what: str, flag: str, number: int | None, options: Sequence[str], default: int
) -> int:
    """Index of option `number` (counting from 1), or the default.

    Raises
    ------
    InputError : there is no such option; the message lists them.
    """
    if number is None:
        return default
    if not 1 <= number <= len(options):
        listed = "; ".join(f"{index} {name}" for index, name in enumerate(options, 1))
        raise InputError(
            f"{flag} {number}: there is no such {what}; expected one of {listed}"
        )
    return number - 1
