"""Results as records: frozen dataclasses in JSON, written and read by one rule.

What is written follows from the fields of a record, and what is read is checked against
their types: a file that somebody else made is a record of these types, or is refused.
"""

from curlfit.records.annotations import (
    Arrays,
    Axes,
    Kinds,
    Matrix,
    Names,
    OneOf,
    Pairs,
)
from curlfit.records.fields import (
    ADDED,
    SERIES,
    UNSAVED,
    Entry,
    require,
    require_rows,
    written_as,
)
from curlfit.records.json_file import read_json, write_json
from curlfit.records.plain import SCHEMA, plain
from curlfit.records.record import Record
from curlfit.records.structure import AGAIN, structured

__all__ = [
    "ADDED",
    "AGAIN",
    "SCHEMA",
    "SERIES",
    "UNSAVED",
    "Arrays",
    "Axes",
    "Entry",
    "Kinds",
    "Matrix",
    "Names",
    "OneOf",
    "Pairs",
    "Record",
    "plain",
    "read_json",
    "require",
    "require_rows",
    "structured",
    "write_json",
    "written_as",
]
