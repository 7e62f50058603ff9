"""Matplotlib figures as SVG that can be embedded in an HTML page beside other SVG."""

from __future__ import annotations

import re
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MAX_MARKERS = 1000  # of a line, above which it is rasterized
_MAX_PATHS = 200  # of a collection, likewise
_DPI = 200  # of rasterized artists
_COMMENTS = re.compile(r"<!--.*?-->", re.S)
_PROLOGUE = re.compile(r"^.*?(?=<svg)", re.S)
_METADATA = re.compile(r"<metadata>.*?</metadata>", re.S)
_STYLES = re.compile(r"<defs>\s*<style[^>]*>.*?</style>\s*</defs>", re.S)
_ID = re.compile(r'\sid="([^"]*)"')
_USED = re.compile(r'(?:xlink:href="#([^"]*)"|url\(#([^)]*)\))')
_DECIMALS = re.compile(r"(?<![\d.])([1-9]\d*\.\d{2})\d+")  # not those of a scale factor below 1
_HEAD = re.compile(r"<svg[^>]*>")
_VIEW = re.compile(r'viewBox="([^"]*)"')


def inline_svg(figure: Figure, prefix: str, title: str) -> Markup:
    """A figure as an `<svg>` element, with text as outlines.

    Parameters
    ----------
    prefix : of its ids, which are kept only if they are referenced.
    title : text for screen readers.
    """
    text = _PROLOGUE.sub("", _drawn(figure))
    for waste in (_COMMENTS, _METADATA, _STYLES):
        text = waste.sub("", text)
    view = _VIEW.search(text)
    assert view is not None
    used = {name for pair in _USED.findall(text) for name in pair if name}
    text = _ID.sub(lambda found: f' id="{prefix}{found[1]}"' if found[1] in used else "", text)
    text = text.replace('xlink:href="#', f'href="#{prefix}').replace("url(#", f"url(#{prefix}")
    text = text.replace("xlink:href", "href")
    images = re.split(r'("data:[^"]*")', text)  # whose digits are not coordinates
    images[::2] = [re.sub(r"\s+", " ", _DECIMALS.sub(r"\1", part)) for part in images[::2]]
    text = "".join(images).replace("> <", "><")
    label = Markup.escape(title)
    head = (
        f'<svg class="plot" role="img" aria-labelledby="{prefix}title" viewBox="{view[1]}">'
        f'<title id="{prefix}title">{label}</title>'
    )
    return Markup(_HEAD.sub(lambda _: head, text, count=1))


def _drawn(figure: Figure) -> str:
    """The figure as written by matplotlib, reproducibly."""
    import matplotlib as mpl

    for axes in figure.axes:
        for artist in (*axes.lines, *axes.collections):
            if _is_crowded(artist):
                artist.set_rasterized(True)
    file = BytesIO()
    with mpl.rc_context({"svg.hashsalt": "curlfit", "svg.fonttype": "path"}):
        figure.savefig(file, format="svg", dpi=_DPI, metadata={"Date": None})
    return file.getvalue().decode()


def _is_crowded(artist: Any) -> bool:
    """Whether an artist takes less space as an image than as points or cells."""
    from matplotlib.collections import Collection, PathCollection
    from matplotlib.lines import Line2D

    if isinstance(artist, PathCollection):
        return len(np.asarray(artist.get_offsets())) > _MAX_MARKERS
    if isinstance(artist, Collection):
        return len(artist.get_paths()) > _MAX_PATHS
    if not isinstance(artist, Line2D) or artist.get_marker() in (None, "None", "", " "):
        return False
    return len(np.asarray(artist.get_xydata())) > _MAX_MARKERS
