"""How a record is written as plain values, which JSON has."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from curlfit.findings import Finding
from curlfit.records.fields import LEVELS, key_of, saved_fields

SCHEMA = 1
"""The version mark of records."""


def plain(value: Any, *, series: bool = True) -> Any:
    """A value as JSON has it: records as objects, arrays as lists, NaN as null,
    infinities as text.

    `series` is False for records without their series.
    """
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(float(value))
    if isinstance(value, Finding):
        return str(value)
    if isinstance(value, Mapping):
        entries = {key: plain(entry, series=series) for key, entry in value.items()}
        return entries | _findings_of(value)
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(entry, series=series) for entry in value]
    if isinstance(value, StrEnum):
        return value.value
    if not is_dataclass(value):
        return value
    value_by_key = {
        key_of(field): getattr(value, field.name)
        for field in saved_fields(type(value))
        if series or "series" not in field.metadata
    }
    for name in getattr(value, "written", ()):  # properties, for other programs
        value_by_key[name] = getattr(value, name)
    entries = {key: plain(entry, series=series) for key, entry in value_by_key.items()}
    entries |= _findings_of(value_by_key)
    marks = getattr(value, "marks", None)  # of a `Record`
    if marks is not None:
        return {"schema": SCHEMA, **marks, **entries}
    return entries


def _findings_of(entries: Mapping[str, Any]) -> dict[str, Any]:
    """The key `findings` of an object that has warnings or notes."""
    findings = [finding for key in LEVELS for finding in entries.get(key) or ()]
    has_key = any(key in entries for key in LEVELS)
    if not has_key or not all(isinstance(finding, Finding) for finding in findings):
        return {}
    names = [field.name for field in fields(Finding)]
    return {
        "findings": [
            {name: plain(getattr(finding, name)) for name in names}
            for finding in findings
        ]
    }
