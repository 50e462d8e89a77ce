"""The site, built from the committed chapters: no warning, and nothing from another host."""

import re
from html.parser import HTMLParser

import pytest

from built import build_site
from ledger import CHAPTERS


class Resources(HTMLParser):
    """Collects the addresses that a browser loads by itself; links to follow do not count."""

    def __init__(self):
        super().__init__()
        self.found = []

    def handle_starttag(self, tag, attrs):
        attrs = dict(attrs)
        if tag == "link" and attrs.get("rel") in ("stylesheet", "preload", "icon", "preconnect"):
            self.found.append(attrs["href"])
        elif tag not in ("a", "link"):
            self.found += [attrs[name] for name in ("src", "srcset", "data") if attrs.get(name)]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The folder of the built pages."""
    folder = tmp_path_factory.mktemp("book")
    html, done = build_site(folder, "--fail-on-warning", "--keep-going")
    assert done.returncode == 0, done.stderr
    return html


def test_pages_load_nothing_from_another_host(site):
    outside = re.compile(r"(?:https?:)?//")
    for page in site.rglob("*.html"):
        resources = Resources()
        resources.feed(page.read_text(encoding="utf-8"))
        assert [r for r in resources.found if outside.match(r)] == [], page.name
    for sheet in site.rglob("*.css"):
        text = sheet.read_text(encoding="utf-8")
        assert not re.search(r"(?:@import|url\()\s*['\"]?(?:https?:)?//", text), sheet.name


def test_mathematics_is_rendered_locally(site):
    page = next(p for p in site.rglob("*.html") if 'class="math' in p.read_text(encoding="utf-8"))
    assert re.search(r'<script[^>]* src="[^"]*tex-svg-full\.js', page.read_text(encoding="utf-8"))
    assert (site / "_static" / "tex-svg-full.js").stat().st_size > 1_000_000


def test_front_page_lists_every_chapter(site):
    front = (site / "index.html").read_text(encoding="utf-8")
    assert CHAPTERS
    for chapter in CHAPTERS:
        assert f'href="chapters/{chapter.stem}.html"' in front


def test_a_figure_shows_and_its_digest_does_not(site):
    pages = [p.read_text(encoding="utf-8") for p in (site / "chapters").glob("*.html")]
    assert any('class="cell_output' in page and ".png" in page for page in pages)
    assert not any("figure+json" in page for page in pages)
