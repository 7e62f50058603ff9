"""Numbers and lists as words."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence

_LEAST_P = 0.001
_HUGE = 1e9  # numbers from this size on are written with a power of ten


def two_digits(value: float) -> str:
    """A number with two digits, without an exponent up to a million."""
    return f"{float(f'{value:.2g}'):g}"


def format_estimate(value: float, stderr: float | None) -> tuple[str, str]:
    """A value and its error as text, to two digits of the error."""
    if stderr is None:
        return f"{value:.6g}", "-"
    if not stderr > 0:
        return f"{value:.10g}", "0"
    if _HUGE <= max(abs(value), stderr) < math.inf:
        digits = 1 + max(math.floor(math.log10(max(abs(value), stderr) / stderr)), 0)
        return f"{value:.{digits}e}", f"{stderr:.1e}"
    digits = decimals(stderr)
    return f"{value:.{digits}f}", f"{stderr:.{digits}f}"


def compact(value: float, stderr: float | None) -> str:
    """A value with the error of its last two digits, as 0.0556(12); the value alone
    without one."""
    shown, error = format_estimate(value, stderr)
    if "e" in error:
        return f"{shown} +- {error}"
    digits = error.replace(".", "").lstrip("0")
    return shown if error == "-" or not digits else f"{shown}({digits})"


def rounded_ends(
    low: float, high: float, scale: float | None = None
) -> tuple[str, str]:
    """Ends of an interval, rounded to two digits of a scale, by default a third
    of its width."""
    if scale is None:
        scale = (high - low) / 3
    return format_estimate(low, scale)[0], format_estimate(high, scale)[0]


def from_to(low: float, high: float, scale: float | None = None) -> str:
    """An interval as "0.12 .. 0.34", rounded as by `rounded_ends`."""
    return " .. ".join(rounded_ends(low, high, scale))


def decimals(size: float) -> int:
    """Decimal places that show two digits of `size`."""
    if not (size > 0 and math.isfinite(size)):
        return 6
    return min(max(1 - math.floor(math.log10(size)), 0), 12)


def p_text(p_value: float) -> str:
    """A p-value as text, such as "p = 0.031" or "p < 0.001"."""
    return f"p < {_LEAST_P:g}" if p_value < _LEAST_P else f"p = {p_value:.2g}"


def join_words(words: Sequence[str], last: str = "and") -> str:
    """Words as in "a, b and c"."""
    return (
        words[0] if len(words) == 1 else f"{', '.join(words[:-1])} {last} {words[-1]}"
    )


def capital(text: str) -> str:
    """A text with its first letter as a capital."""
    return text[:1].upper() + text[1:]


def lower(text: str) -> str:
    """A text with a lower-case initial."""
    return text[:1].lower() + text[1:]


def hanging(head: str, text: str, width: int) -> list[str]:
    """Lines of a text after a head, with a hanging indent."""
    return textwrap.wrap(
        text,
        width,
        initial_indent=head,
        subsequent_indent=" " * len(head),
        break_long_words=False,
        break_on_hyphens=False,
    )


def listed(texts: Mapping[str, str], width: int, indent: str = "") -> list[str]:
    """Lines of texts beside their names."""
    longest = max(map(len, texts), default=0)
    lines = []
    for name, text in texts.items():
        lines += hanging(f"{indent}{name:<{longest}}  ", text, width)
    return lines
