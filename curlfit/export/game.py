"""The table of accelerations as a C header and as a JavaScript module, without dependencies."""

from __future__ import annotations

import math
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

_C = """/*
$head

  curlfit_accelerations(v, omega, a)   a[3]: across, along, angular
  curlfit_step(&stone, dt, friction)   the stone dt seconds later; 1 while it moves, 0 at rest
friction is a factor, 1 where the stone is not swept. C99 and C++; link with -lm.
*/
#ifndef CURLFIT_STONE_H
#define CURLFIT_STONE_H

#include <math.h>

typedef struct {
    double x, y, vx, vy, phi, omega;
} curlfit_stone;

#define CURLFIT_R $R
#define CURLFIT_ROWS $rows
#define CURLFIT_COLUMNS $columns

static const double curlfit_table[3][CURLFIT_ROWS + 3][CURLFIT_COLUMNS + 3] = {
$values
};

static inline void curlfit_weights(double f, double w[4])
{
    w[0] = f * (-0.5 + f * (1.0 - 0.5 * f));
    w[1] = 1.0 + f * f * (-2.5 + 1.5 * f);
    w[2] = f * (0.5 + f * (2.0 - 1.5 * f));
    w[3] = f * f * (-0.5 + 0.5 * f);
}

static inline void curlfit_accelerations(double v, double omega, double a[3])
{
    const double u = CURLFIT_R * omega, s = hypot(v, u), theta = atan2(u, v);
    const double side = theta >= 0.0 ? 1.0 : -1.0;
    const double g = side * theta / $quarter - 1.0;
    const double p = cbrt(g) * (14.0 + g * g) / 15.0;
    const double column = CURLFIT_COLUMNS * (2.0 + side * (1.0 + p)) / 4.0;
    double row, wi[4], wj[4];
    int i, j, c, m, n;
    a[0] = a[1] = a[2] = 0.0;
    if (!(s > 0.0)) return;
    row = CURLFIT_ROWS * log(s / $slowest) / $span;
    row = row < 0.0 ? 0.0 : row > CURLFIT_ROWS ? CURLFIT_ROWS : row;
    i = (int)row < CURLFIT_ROWS ? (int)row : CURLFIT_ROWS - 1;
    j = (int)column < CURLFIT_COLUMNS ? (int)column : CURLFIT_COLUMNS - 1;
    curlfit_weights(row - i, wi);
    curlfit_weights(column - j, wj);
    for (c = 0; c < 3; c++)
        for (m = 0; m < 4; m++)
            for (n = 0; n < 4; n++) a[c] += wi[m] * wj[n] * curlfit_table[c][i + m][j + n];
}

static inline void curlfit_rates(const double q[6], double friction, double r[6])
{
    const double v = hypot(q[2], q[3]);
    const double ex = v > 0.0 ? q[2] / v : 0.0, ey = v > 0.0 ? q[3] / v : 0.0;
    double a[3];
    curlfit_accelerations(v, q[5], a);
    r[0] = q[2];
    r[1] = q[3];
    r[2] = friction * (a[1] * ex + a[0] * ey);
    r[3] = friction * (a[1] * ey - a[0] * ex);
    r[4] = q[5];
    r[5] = friction * a[2];
}

static inline int curlfit_step(curlfit_stone *stone, double dt, double friction)
{
    double q[6], left = dt;
    int moves = 1, k;
    q[0] = stone->x, q[1] = stone->y, q[2] = stone->vx;
    q[3] = stone->vy, q[4] = stone->phi, q[5] = stone->omega;
    while (left > 0.0) {
        double r[4][6], z[6], s, size, h = left;
        s = hypot(hypot(q[2], q[3]), CURLFIT_R * q[5]);
        if (s < $rest) {
            q[2] = q[3] = q[5] = 0.0;
            moves = 0;
            break;
        }
        curlfit_rates(q, friction, r[0]);
        size = hypot(hypot(r[0][2], r[0][3]), CURLFIT_R * r[0][5]);
        h = h < $step ? h : $step;
        if (size > 0.0 && $share * s / size < h) h = $share * s / size;
        for (k = 0; k < 6; k++) z[k] = q[k] + h / 2.0 * r[0][k];
        curlfit_rates(z, friction, r[1]);
        for (k = 0; k < 6; k++) z[k] = q[k] + h / 2.0 * r[1][k];
        curlfit_rates(z, friction, r[2]);
        for (k = 0; k < 6; k++) z[k] = q[k] + h * r[2][k];
        curlfit_rates(z, friction, r[3]);
        for (k = 0; k < 6; k++)
            q[k] += h / 6.0 * (r[0][k] + 2.0 * r[1][k] + 2.0 * r[2][k] + r[3][k]);
        left -= h;
    }
    stone->x = q[0], stone->y = q[1], stone->vx = q[2];
    stone->vy = q[3], stone->phi = q[4], stone->omega = q[5];
    return moves;
}

#endif
"""

_JS = """/*
$head

  accelerations(v, omega)          [across, along, angular]
  step(stone, dt, friction = 1)    moves {x, y, vx, vy, phi, omega} dt seconds on; false at rest
friction is a factor, 1 where the stone is not swept.
*/

export const R = $R;
const ROWS = $rows, COLUMNS = $columns;
const TABLE = [
$values
];

function weights(f) {
  return [
    f * (-0.5 + f * (1 - 0.5 * f)),
    1 + f * f * (-2.5 + 1.5 * f),
    f * (0.5 + f * (2 - 1.5 * f)),
    f * f * (-0.5 + 0.5 * f),
  ];
}

export function accelerations(v, omega) {
  const u = R * omega, s = Math.hypot(v, u), theta = Math.atan2(u, v);
  const found = [0, 0, 0];
  if (!(s > 0)) return found;
  const side = theta >= 0 ? 1 : -1;
  const g = side * theta / $quarter - 1;
  const p = Math.cbrt(g) * (14 + g * g) / 15;
  const column = COLUMNS * (2 + side * (1 + p)) / 4;
  const row = Math.min(Math.max(ROWS * Math.log(s / $slowest) / $span, 0), ROWS);
  const i = Math.min(Math.trunc(row), ROWS - 1), j = Math.min(Math.trunc(column), COLUMNS - 1);
  const wi = weights(row - i), wj = weights(column - j);
  for (let c = 0; c < 3; c++)
    for (let m = 0; m < 4; m++)
      for (let n = 0; n < 4; n++) found[c] += wi[m] * wj[n] * TABLE[c][i + m][j + n];
  return found;
}

function rates(q, friction) {
  const v = Math.hypot(q[2], q[3]);
  const ex = v > 0 ? q[2] / v : 0, ey = v > 0 ? q[3] / v : 0;
  const [across, along, angular] = accelerations(v, q[5]);
  return [
    q[2], q[3], friction * (along * ex + across * ey), friction * (along * ey - across * ex),
    q[5], friction * angular,
  ];
}

export function step(stone, dt, friction = 1) {
  let q = [stone.x, stone.y, stone.vx, stone.vy, stone.phi, stone.omega];
  let left = dt, moves = true;
  const moved = (r, h) => q.map((value, k) => value + h * r[k]);
  while (left > 0) {
    const s = Math.hypot(q[2], q[3], R * q[5]);
    if (s < $rest) {
      q[2] = q[3] = q[5] = 0;
      moves = false;
      break;
    }
    const a = rates(q, friction);
    const size = Math.hypot(a[2], a[3], R * a[5]);
    const h = Math.min(left, $step, size > 0 ? $share * s / size : left);
    const b = rates(moved(a, h / 2), friction);
    const c = rates(moved(b, h / 2), friction);
    const d = rates(moved(c, h), friction);
    q = moved(a.map((value, k) => (value + 2 * b[k] + 2 * c[k] + d[k]) / 6), h);
    left -= h;
  }
  [stone.x, stone.y, stone.vx, stone.vy, stone.phi, stone.omega] = q;
  return moves;
}
"""


def c_header(table: AccelerationTable) -> str:
    """The table with its interpolation and a time step, in C99 that is also valid C++."""
    return _filled(_C, table, "{", "}")


def javascript_module(table: AccelerationTable) -> str:
    """The same as a JavaScript module."""
    return _filled(_JS, table, "[", "]")


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
    return Template(template).substitute(values, head=head)


def _wrapped(row: list[float], left: str, right: str) -> str:
    """Numbers with seven digits, eight per line."""
    texts = [f"{value:.7g}" for value in row]
    lines = [", ".join(texts[first : first + 8]) for first in range(0, len(texts), 8)]
    return left + ",\n ".join(lines) + right
