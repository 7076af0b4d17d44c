"""Does everything in a built site lead somewhere?

    python notebooks/site/links.py build/site

Every link within the site must lead to a file of it, every anchor to an element with that id, and
nothing that a page loads (scripts, styles, pictures, fonts) may come from another host. Prints what
does not, a line each, and exits with status 1.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

LOADED = {"script": "src", "img": "src", "source": "src", "iframe": "src", "link": "href"}
_CSS = re.compile(r"url\(\s*['\"]?([^'\")]+)|@import\s+['\"]([^'\"]+)")


class Page(HTMLParser):
    """ids: that an anchor may name; links: of <a>; loaded: what the browser fetches by itself."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.ids: set[str] = set()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {name: value or "" for name, value in attrs}
        self.ids |= {values[name] for name in ("id", "name") if values.get(name)}
        if tag == "a" and "href" in values:
            self.links.append(values["href"])
        fetched = values.get(LOADED.get(tag, ""), "")
        if fetched and not (tag == "link" and _only_says(values.get("rel", ""))):
            self.loaded.append(fetched)


def _only_says(rel: str) -> bool:
    """Links of the head that name a page and load nothing."""
    return bool({"next", "prev", "canonical", "search", "index", "author"} & set(rel.split()))


def broken(site: Path) -> Iterator[str]:
    """A line for each link, anchor and resource that leads nowhere, or to another host."""
    files = [path for path in sorted(site.rglob("*.html")) if "_static" not in path.parts]
    pages = {path: Page(path.read_text(encoding="utf-8")) for path in files}
    if not pages:
        yield f"{site}: no page in it"
    for path, page in pages.items():
        where = path.relative_to(site)
        for link in page.links:
            yield from (f"{where}: {link}: {why}" for why in _wrong(link, path, site, pages))
        for link in page.loaded:
            yield from (f"{where} loads {link}: {why}" for why in _foreign(link, path, site))
    for path in sorted(site.rglob("*.css")):
        for found in _CSS.finditer(path.read_text(encoding="utf-8")):
            link = found[1] or found[2]
            why = _foreign(link, path, site)
            yield from (f"{path.relative_to(site)} loads {link}: {text}" for text in why)


def _wrong(link: str, path: Path, site: Path, pages: dict[Path, Page]) -> Iterator[str]:
    parts = urlsplit(link)
    if parts.scheme or parts.netloc:
        if parts.scheme not in ("https", "http", "mailto"):
            yield "an address of no known kind"
        return
    target = _target(parts.path, path, site)
    if not target.exists():
        yield "no such file"
    elif parts.fragment and target in pages and "=" not in parts.fragment:  # = holds a state
        yield from () if unquote(parts.fragment) in pages[target].ids else ("no such anchor",)


def _foreign(link: str, path: Path, site: Path) -> Iterator[str]:
    parts = urlsplit(link)
    if parts.scheme == "data" or link.startswith("#"):
        return
    if parts.scheme or parts.netloc:
        yield "it is on another host"
    elif not _target(parts.path, path, site).exists():
        yield "no such file"


def _target(link: str, path: Path, site: Path) -> Path:
    """The file that a relative address stands for; of a folder its index."""
    base = site if link.startswith("/") else path.parent
    target = (base / unquote(link).lstrip("/")).resolve() if link else path
    return target / "index.html" if target.is_dir() else target


def main(site: str) -> int:
    folder = Path(site).resolve()
    found = list(broken(folder))
    print("\n".join(found) if found else f"{site}: every link within it leads somewhere")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
