"""The words that files are read by, from `words.toml`."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

WORDS: dict[str, Any] = tomllib.loads(
    Path(__file__).with_name("words.toml").read_text("utf-8")
)


def by_word(table: Mapping[str, str]) -> dict[str, str]:
    """Each of the words of a table with its meaning."""
    return {word: meaning for meaning, words in table.items() for word in words.split()}
