"""Friction round the ring under each law, drawn from the law itself: `law_NAME.svg`.

`python notebooks/pictures/draw_laws.py` draws all again. Colours are of medium
brightness, to be read on white and on black.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import curlfit
from curlfit.friction import LocalLaw, Motion, NetLaw, RingPoint

FOLDER = Path(__file__).parent
SPEED, EPSILON, TURNED = 1.0, 0.3, math.pi / 4  # m/s, R omega/v, rad
STONE = curlfit.Stone()
GREY, BLUE, ORANGE = "#7b7b7b", "#3f7fc4", "#c8641e"
ARROWS, POINTS = 24, 720
LOADED = ("pressure", "stribeck")  # laws that are drawn under the consistent load


def ring(law: LocalLaw, alpha: np.ndarray, load: Any) -> tuple[np.ndarray, np.ndarray]:
    """Friction at polar angles over the uniform load, to the right and forward
    (eq. 16, 21)."""
    xi, eta = np.cos(alpha), np.sin(alpha)
    u = EPSILON * SPEED
    right, forward = -u * eta, SPEED + u * xi
    speed = np.hypot(right, forward)
    point = RingPoint(
        xi=xi,
        eta=eta,
        angle=alpha,
        front=1.0 * (eta > 0),
        slide_xi=right,
        slide_eta=forward,
        speed=speed,
        e_xi=right / speed,
        e_eta=forward / speed,
        load=load,
        v=SPEED,
        u=u,
        turned=TURNED,
        time=0.0,
    )
    t_xi, t_eta = law.traction(point)
    return load * t_xi * np.ones_like(alpha), load * t_eta * np.ones_like(alpha)


def load_on(law: LocalLaw, alpha: np.ndarray, tilt: np.ndarray) -> np.ndarray:
    """n/n0 at polar angles, for the coefficients of xi/R and eta/R (eq. 9)."""
    return 1 + tilt[0] * np.cos(alpha) + tilt[1] * np.sin(alpha)


def balanced(law: LocalLaw) -> np.ndarray:
    """The coefficients of the consistent load (eq. 8-9), by repetition."""
    alpha = (np.arange(POINTS) + 0.5) * 2 * np.pi / POINTS
    tilt = np.zeros(2)
    for _ in range(50):
        force = [part.mean() for part in ring(law, alpha, load_on(law, alpha, tilt))]
        tilt = -2 * STONE.h / STONE.R * np.array(force)
    return tilt


def arrow(x: float, y: float, dx: float, dy: float, colour: str) -> str:
    """A line with a head, in pixels."""
    size = math.hypot(dx, dy)
    if size < 2:
        return ""
    ux, uy = dx / size, dy / size
    tip, head = (x + dx, y + dy), min(5.0, 0.6 * size)
    wings = [
        (
            tip[0] - head * ux + side * 0.5 * head * uy,
            tip[1] - head * uy - side * 0.5 * head * ux,
        )
        for side in (1, -1)
    ]
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in (tip, *wings))
    return (
        f'<path d="M{x:.1f} {y:.1f}L{tip[0]:.1f} {tip[1]:.1f}" stroke="{colour}" '
        f'stroke-width="1.6"/><polygon points="{points}" fill="{colour}"/>'
    )


def text(
    x: float, y: float, words: str, colour: str = GREY, anchor: str = "middle"
) -> str:
    """Words at a place, in pixels."""
    return (
        f'<text x="{x:g}" y="{y:g}" fill="{colour}" '
        f'text-anchor="{anchor}">{words}</text>'
    )


def panel_of_arrows(law: LocalLaw, tilt: np.ndarray) -> list[str]:
    """The ring from above, moving up and turning counter-clockwise."""
    x0, y0, radius = 125.0, 128.0, 72.0
    alpha = (np.arange(ARROWS) + 0.5) * 2 * np.pi / ARROWS - np.pi
    t_xi, t_eta = ring(law, alpha, load_on(law, alpha, tilt))
    scale = 44 / np.hypot(t_xi, t_eta).max()
    found = [
        f'<circle cx="{x0:g}" cy="{y0:g}" r="{radius:g}" fill="none" stroke="{GREY}"/>',
        arrow(x0, y0 + 14, 0, -40, GREY),
        text(x0 + 8, y0 - 16, "v", anchor="start"),
        f'<path d="M{x0 + 30:g} {y0 + 4:g}a30 30 0 0 0 -12 -20" fill="none" '
        f'stroke="{GREY}" stroke-width="1.2"/>',
        f'<polygon points="{x0 + 14:g},{y0 - 20:g} {x0 + 22:g},{y0 - 18:g} {x0 + 17:g},'
        f'{y0 - 12:g}" fill="{GREY}"/>',
        text(x0 + 34, y0 - 8, "ω", anchor="start"),
    ]
    for angle, right, forward in zip(alpha, t_xi, t_eta, strict=True):
        x, y = x0 + radius * math.cos(angle), y0 - radius * math.sin(angle)
        colour = BLUE if angle > 0 else ORANGE
        found.append(arrow(x, y, scale * right, -scale * forward, colour))
    return found


def axis_top(largest: float) -> float:
    """A round number just above."""
    power = 10.0 ** math.floor(math.log10(largest))
    return next(
        step * power
        for step in (1, 1.5, 2, 3, 4, 5, 6, 8, 10)
        if step * power >= largest
    )


def panel_of_curves(
    horizontal: tuple[float, float, Sequence[tuple[float, str]], str],
    curves: Sequence[tuple[np.ndarray, np.ndarray, str, str]],
    title: str,
    halves: bool,
) -> list[str]:
    """Curves over an axis, which is given as its ends, its ticks and its name."""
    left, right, top, bottom = 322.0, 626.0, 34.0, 200.0
    # names of the halves stand below the curves
    foot = bottom - 20 if halves else bottom
    low, high, ticks, name = horizontal
    values = np.concatenate([y for _, y, _, _ in curves])
    upper = (
        axis_top(float(max(values.max(), 0.0)) or 1e-12) if values.max() > 0 else 0.0
    )
    lower = -axis_top(float(-values.min())) if values.min() < 0 else 0.0
    if upper < -0.1 * lower:
        upper = -0.1 * lower

    def place(x: Any, y: Any) -> tuple[Any, Any]:
        return (
            left + (x - low) / (high - low) * (right - left),
            foot - (y - lower) / (upper - lower) * (foot - top),
        )

    found = []
    if halves:
        middle = place(0.0, 0.0)[0]
        found += [
            f'<rect x="{middle:.1f}" y="{top:g}" width="{right - middle:.1f}" '
            f'height="{bottom - top:g}" fill="{BLUE}" opacity="0.10"/>',
            text((left + middle) / 2, bottom - 6, "back half", ORANGE),
            text((right + middle) / 2, bottom - 6, "front half", BLUE),
        ]
    zero = place(low, 0.0)[1]
    found += [
        f'<path d="M{left:g} {top:g}V{bottom:g}H{right:g}M{left:g} '
        f'{zero:.1f}H{right:g}" fill="none" stroke="{GREY}" stroke-width="0.8"/>',
        text(left, top - 12, title, anchor="start"),
        text((left + right) / 2, bottom + 36, name),
    ]
    for value, label in ticks:
        found.append(text(round(place(value, 0.0)[0], 1), bottom + 16, label))
    for value in sorted({lower, 0.0, upper if upper > -0.2 * lower else 0.0}):
        label = f"{value:.3g}".replace("-", "−")
        found.append(
            text(left - 5, round(place(low, value)[1] + 4, 1), label, anchor="end")
        )
    for column, (x, y, label, dashes) in enumerate(curves):
        px, py = place(x, y)
        path = "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(px, py, strict=True))
        style = f' stroke-dasharray="{dashes}"' if dashes else ""
        found.append(
            f'<path d="M{path}" fill="none" stroke="{GREY}" stroke-width="2"{style}/>'
        )
        x1 = right - 210 + 120 * column
        found.append(
            f'<path d="M{x1:g} {top - 16:g}h22" stroke="{GREY}" '
            f'stroke-width="2"{style}/>'
        )
        found.append(text(x1 + 28, top - 12, label, anchor="start"))
    return found


def local_law(name: str) -> list[str]:
    """Both panels of a law of friction at a point."""
    law = curlfit.law_with(name, {})
    tilt = balanced(law) if name in LOADED else np.zeros(2)
    # a point in either half next to each place where friction may jump
    edges = [0.0, *(float(edge) for half in law.edges(TURNED) for edge in half)]
    alpha = np.sort(
        np.concatenate(
            [
                np.linspace(-np.pi, np.pi, 73)[1:-1],
                *([e - 1e-6, e + 1e-6] for e in edges),
            ]
        )
    )
    t_xi, t_eta = ring(law, alpha, load_on(law, alpha, tilt))
    horizontal = (
        -180.0,
        180.0,
        [(float(a), f"{a}°".replace("-", "−")) for a in range(-180, 181, 90)],
        "polar angle α",
    )
    degrees = np.degrees(alpha)
    curves = [(degrees, t_xi, "to the right", "5 4"), (degrees, t_eta, "forward", "")]
    title = "t/n₀"
    return panel_of_arrows(law, tilt) + panel_of_curves(horizontal, curves, title, True)


def net_law(name: str) -> list[str]:
    """Accelerations by speed of a law of the whole stone, at 1 rad/s, 10 s
    after release."""
    law = curlfit.law_with(name, {})
    assert isinstance(law, NetLaw)
    speed = np.linspace(0.3, 2.2, 60)
    across, along, _ = law.accelerations(Motion(speed, 1.0, 0.0, 10.0), STONE)
    flat = np.ones_like(speed)
    horizontal = (
        0.3,
        2.2,
        [(v, f"{v:g}") for v in (0.5, 1.0, 1.5, 2.0)],
        "speed (m/s)",
    )
    curves = [
        (speed, across * flat, "to the right", "5 4"),
        (speed, along * flat, "forward", ""),
    ]
    return [
        text(125, 120, "acceleration"),
        text(125, 138, "of the whole stone"),
        *panel_of_curves(horizontal, curves, "m/s²", False),
    ]


def picture(name: str) -> str:
    """The picture of a law, as SVG."""
    kind = curlfit.LAWS[name]
    parts = local_law(name) if issubclass(kind, LocalLaw) else net_law(name)
    return "\n".join(
        [
            '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 640 250" role="img" '
            'font-family="sans-serif" font-size="13">',
            f"<title>Friction under the law {name}</title>",
            *filter(None, parts),
            "</svg>\n",
        ]
    )


def main() -> None:
    """Draw the laws that are part of curlfit."""
    for name, kind in curlfit.LAWS.items():
        if kind.shipped():
            (FOLDER / f"law_{name}.svg").write_text(picture(name), encoding="utf-8")


if __name__ == "__main__":
    main()
