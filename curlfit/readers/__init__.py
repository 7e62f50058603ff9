"""Files become throws here; units, column names and separators end at this door."""

from curlfit.readers.table import load_throw

__all__ = ["load_throw"]
