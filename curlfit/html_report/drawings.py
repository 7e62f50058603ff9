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
    text = _ID.sub(
        lambda found: f' id="{prefix}{found[1]}"' if found[1] in used else "", text
    )
    text = text.replace('xlink:href="#', f'href="#{prefix}').replace(
        "url(#", f"url(#{prefix}"
    )
    text = text.replace("xlink:href", "href")
    images = re.split(r'("data:[^"]*")', text)  # whose digits are not coordinates
    images[::2] = [
        re.sub(r"\s+", " ", _DECIMALS.sub(r"\1", part)) for part in images[::2]
    ]
    text = "".join(images).replace("> <", "><")
    head = (
        rf'<svg class="plot" role="img" aria-labelledby="{prefix}title" \1>'
        f'<title id="{prefix}title">'
    )
    said = f"{Markup.escape(title)}</title>"
    return Markup(_HEAD.sub(lambda found: found.expand(head) + said, text, count=1))


def _drawn(figure: Figure) -> str:
    """The figure as written by matplotlib, many markers as an image, which
    takes less space."""
    for line in (line for axes in figure.axes for line in axes.lines):
        if (
            line.get_marker() not in (None, "None")
            and len(line.get_path()) > _MAX_MARKERS
        ):
            line.set_rasterized(True)
    file = BytesIO()
    with rc_context({"svg.fonttype": "path"}):
        figure.savefig(file, format="svg", dpi=_DPI)
    return file.getvalue().decode()
