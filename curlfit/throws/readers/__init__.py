"""Readers: from data files of any format, units and axes to throws in SI units."""

from curlfit.throws.readers.load import (
    FORMATS,
    Part,
    check_reader_options,
    format_of,
    from_table,
    holds_timed_rows,
    load_throw,
    load_throws,
    read,
    states_sweeping,
)

__all__ = [
    "FORMATS", "Part", "check_reader_options", "format_of", "from_table", "holds_timed_rows",
    "load_throw", "load_throws", "read", "states_sweeping",
]  # fmt: skip
