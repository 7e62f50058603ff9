"""Check a built site: all internal links and anchors exist, and nothing comes
from a network.

`python tests/documentation/check_site.py notebooks/_build/html`. Links to other sites
are allowed, and not followed; resources of other sites (scripts, styles, pictures,
fonts) are not.
"""

from __future__ import annotations

import re
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

LOADS = {
    "script": "src",
    "img": "src",
    "source": "src",
    "iframe": "src",
    "link": "href",
}
# of <link rel=...>
_NOT_LOADED = {"canonical", "index", "search", "next", "prev", "author"}
_STYLE = re.compile(r"(?:url\(|@import)\s*['\"]?((?:https?:)?//[^)'\"]+)")


class Page(HTMLParser):
    """Anchors, links and resources of a page."""

    def __init__(self, file: Path) -> None:
        super().__init__()
        self.ids: set[str] = set()
        self.links: list[str] = []
        self.resources: list[str] = []
        self.feed(file.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        attributes = {key: value or "" for key, value in attrs}
        self.ids.add(attributes.get("id", ""))
        if tag == "a" and "href" in attributes:
            self.links.append(attributes["href"])
        elif (
            attributes.get(LOADS.get(tag, ""))
            and attributes.get("rel") not in _NOT_LOADED
        ):
            self.resources.append(attributes[LOADS[tag]])


def faults(site: Path) -> list[str]:
    """What is wrong with a site, a sentence each."""
    pages = {file.resolve(): Page(file) for file in sorted(site.rglob("*.html"))}
    complaints = [] if pages else [f"{site}: no pages"]
    for file, page in pages.items():
        name = file.relative_to(site.resolve())
        for link in page.links + page.resources:
            parts = urlsplit(link)
            if parts.scheme == "data":
                continue
            if parts.scheme or parts.netloc:
                if link in page.resources:
                    complaints.append(f"{name}: {link} comes from a network")
                continue
            target = (
                (file.parent / unquote(parts.path)).resolve() if parts.path else file
            )
            target = target / "index.html" if target.is_dir() else target
            ids = pages[target].ids | {""} if target in pages else {""}
            if not target.is_file():
                complaints.append(f"{name}: no file {link}")
            elif (
                link in page.links
                and target in pages
                and unquote(parts.fragment) not in ids | {""}
            ):
                complaints.append(f"{name}: no anchor {link}")
    for file in sorted(site.rglob("*.css")):
        for match in _STYLE.finditer(file.read_text(encoding="utf-8")):
            complaints.append(
                f"{file.relative_to(site)}: {match[1]} comes from a network"
            )
    return complaints


if __name__ == "__main__":
    wrong = faults(Path(sys.argv[1]))
    print(
        "\n".join(wrong)
        or "All internal links lead somewhere; nothing comes from a network."
    )
    sys.exit(bool(wrong))
