"""pandas tables, and optional packages."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any

from curlfit.errors import InputError


def optional(module: str, extra: str) -> Any:
    """A package installed by an extra of curlfit.

    Raises
    ------
    InputError : it is not installed.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        if error.name != module:
            raise
        raise InputError(
            f"{module} is not installed: pip install 'curlfit[{extra}]'"
        ) from None


def frame(columns: Mapping[str, Any], index: Any = None) -> Any:
    """A pandas DataFrame of columns.

    Raises
    ------
    InputError : pandas is not installed.
    """
    return optional("pandas", "notebook").DataFrame(dict(columns), index=index)
