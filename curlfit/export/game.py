"""The table of accelerations as a C header and as a JavaScript module, without dependencies.

Both are templates beside this file, `curlfit_stone.h.in` and `curlfit_stone.mjs.in`.
"""

from __future__ import annotations

import math
from pathlib import Path
from string import Template

from curlfit.export.accelerations import (
    FASTEST,
    REST,
    SHARE,
    SLOWEST,
    STEP,
    AccelerationTable,
)
from curlfit.version import __version__

_HEAD = """Curling stone under the $law law, $load load, by curlfit $version.
$coefficients
stone: R = $R m, rho = $rho m, h = $h m
Accelerations by speed v (m/s) and spin omega (rad/s, counter-clockwise): to the right of the
motion and along it (m/s^2), counter-clockwise (rad/s^2). Errors of the interpolation: at most
$error_across and $error_along m/s^2, $error_angular rad/s^2; throws come to rest within
$resting_place m of where the law brings them. x is to the right of y; level ice, still air."""


def c_header(table: AccelerationTable) -> str:
    """The table with its interpolation and a time step, in C99 that is also valid C++."""
    return _filled("curlfit_stone.h.in", table, "{", "}")


def javascript_module(table: AccelerationTable) -> str:
    """The same as a JavaScript module."""
    return _filled("curlfit_stone.mjs.in", table, "[", "]")


def not_included(table: AccelerationTable) -> str:
    """A sentence on conditions of the fit that the table does not include; empty without any."""
    if not table.not_included:
        return ""
    named = ", ".join(f"{name} = {value:.4g}" for name, value in table.not_included.items())
    return f"Not included from the fit: {named}."


def _filled(template: str, table: AccelerationTable, left: str, right: str) -> str:
    n, k = table.shape
    across, along, angular = (f"{size:.1g}" for size in table.interpolation)
    named = ", ".join(f"{name} = {value:.6g}" for name, value in table.coefficients.items())
    values = {
        "law": table.law, "load": table.load, "version": __version__, "coefficients": named,
        "rho": f"{table.stone.rho!r}", "h": f"{table.stone.h!r}", "R": f"{table.stone.R!r}",
        "error_across": across, "error_along": along, "error_angular": angular,
        "resting_place": f"{table.resting_place:.1g}",
        "rows": str(n), "columns": str(k),
        "quarter": repr(math.pi / 4), "slowest": repr(SLOWEST), "rest": repr(REST),
        "span": repr(math.log(FASTEST / SLOWEST)), "step": repr(STEP), "share": repr(SHARE),
        "values": ",\n".join(
            left + ",\n".join(_wrapped(row, left, right) for row in part) + right
            for part in table.values.tolist()
        ),
    }  # fmt: skip
    head = "\n".join(filter(None, [Template(_HEAD).substitute(values), not_included(table)]))
    head = head.replace("*/", "* /")  # which would end the comment
    text = (Path(__file__).parent / template).read_text(encoding="utf-8")
    return Template(text).substitute(values, head=head)


def _wrapped(row: list[float], left: str, right: str) -> str:
    """Numbers with seven digits, eight per line."""
    texts = [f"{value:.7g}" for value in row]
    lines = [", ".join(texts[first : first + 8]) for first in range(0, len(texts), 8)]
    return left + ",\n ".join(lines) + right
