"""Files become throws here; units, column names and separators end at this door."""

from curlfit.readers.load import FORMATS, load_throw, read
from curlfit.readers.objects import from_table

__all__ = ["FORMATS", "from_table", "load_throw", "read"]
