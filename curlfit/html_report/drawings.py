"""Matplotlib figures as SVG that can be embedded in an HTML page beside other SVG."""

from __future__ import annotations

import re
from io import BytesIO

from markupsafe import Markup
from matplotlib import rc_context
from matplotlib.figure import Figure

_MAX_MARKERS = 1000  # of a line, above which they are an image
_DPI = 200  # of images
_WASTE = re.compile(
    r"^.*?(?=<svg)|<!--.*?-->|<metadata>.*?</metadata>|<defs>"
    r"\s*<style.*?</style>\s*</defs>",
    re.S,
)
"""What a page does not need: what precedes the drawing, comments, metadata, styles."""
_ID = re.compile(r'\sid="([^"]*)"')
_USED = re.compile(r'(?:xlink:href="#|url\(#)([^")]*)')
"""Ids that are referenced."""
_DECIMALS = re.compile(r"(?<![\d.])([1-9]\d*\.\d{2})\d+")
"""Digits after the second decimal, not those of a scale factor below 1."""
_IMAGES = re.compile(r'("data:[^"]*")')
_HEAD = re.compile(r'<svg[^>]*(viewBox="[^"]*")[^>]*>')


def inline_svg(figure: Figure, prefix: str, title: str) -> Markup:
    """A figure as an `<svg>` element, with text as outlines.

    Parameters
    ----------
    prefix : of its ids, which are kept only if they are referenced.
    title : text for screen readers.
    """
    text = _shortened(_with_prefix(_WASTE.sub("", _drawn(figure)), prefix))
    tag = rf'<svg class="plot" role="img" aria-labelledby="{prefix}title" \1>'
    heading = f'<title id="{prefix}title">{Markup.escape(title)}</title>'
    # the title is not expanded, as it may contain backslashes
    return Markup(_HEAD.sub(lambda head: head.expand(tag) + heading, text, count=1))


def _with_prefix(svg: str, prefix: str) -> str:
    """SVG whose ids begin with a prefix, so that drawings in one page have different
    ones; ids that are not referenced are left out."""
    used = set(_USED.findall(svg))
    svg = _ID.sub(
        lambda match: f' id="{prefix}{match[1]}"' if match[1] in used else "", svg
    )
    svg = svg.replace('xlink:href="#', f'href="#{prefix}')
    svg = svg.replace("url(#", f"url(#{prefix}")
    return svg.replace("xlink:href", "href")


def _shortened(svg: str) -> str:
    """SVG without needless spaces, with two decimals of coordinates."""
    # every second part is an image, whose digits are no coordinates
    parts = _IMAGES.split(svg)
    parts[::2] = [
        re.sub(r"\s+", " ", _DECIMALS.sub(r"\1", part)) for part in parts[::2]
    ]
    return "".join(parts).replace("> <", "><")


def _drawn(figure: Figure) -> str:
    """The figure as written by matplotlib, many markers as an image, which
    takes less space."""
    for axes in figure.axes:
        for line in axes.lines:
            has_markers = line.get_marker() not in (None, "None")
            if has_markers and len(line.get_path()) > _MAX_MARKERS:
                line.set_rasterized(True)
    file = BytesIO()
    with rc_context({"svg.fonttype": "path"}):
        figure.savefig(file, format="svg", dpi=_DPI)
    return file.getvalue().decode()
