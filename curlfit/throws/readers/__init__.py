"""Files become throws here; units, column names and separators end at this door."""

from curlfit.throws.readers.load import FORMATS, Part, check_how, load_throw, load_throws, read
from curlfit.throws.readers.objects import from_table

__all__ = [
    "FORMATS", "Part", "check_how", "from_table", "load_throw", "load_throws", "read",
]  # fmt: skip
