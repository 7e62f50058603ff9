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
_ID = re.compile(r'\sid="([^"]*)"')
_USED = re.compile(r'(?:xlink:href="#|url\(#)([^")]*)')
# not those of a scale factor below 1
_DECIMALS = re.compile(r"(?<![\d.])([1-9]\d*\.\d{2})\d+")
_HEAD = re.compile(r'<svg[^>]*(viewBox="[^"]*")[^>]*>')


def inline_svg(figure: Figure, prefix: str, title: str) -> Markup:
    """A figure as an `<svg>` element, with text as outlines.

    Parameters
    ----------
    prefix : of its ids, which are kept only if they are referenced.
    title : text for screen readers.
    """
    text = _WASTE.sub("", _drawn(figure))
    used = set(_USED.findall(text))
    text = _ID.sub(lambda id: f' id="{prefix}{id[1]}"' if id[1] in used else "", text)
    text = text.replace('xlink:href="#', f'href="#{prefix}')
    text = text.replace("url(#", f"url(#{prefix}")
    text = text.replace("xlink:href", "href")
    # every second part is an image, whose digits are no coordinates
    parts = re.split(r'("data:[^"]*")', text)
    parts[::2] = [
        re.sub(r"\s+", " ", _DECIMALS.sub(r"\1", part)) for part in parts[::2]
    ]
    text = "".join(parts).replace("> <", "><")
    tag = rf'<svg class="plot" role="img" aria-labelledby="{prefix}title" \1>'
    heading = f'<title id="{prefix}title">{Markup.escape(title)}</title>'
    # the title is not expanded, as it may contain backslashes
    return Markup(_HEAD.sub(lambda head: head.expand(tag) + heading, text, count=1))


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
