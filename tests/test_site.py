"""The site, built once: no warning, nothing from another host; and as a browser shows it."""

import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser

import pypdf
import pytest
from paper import print_page

from ledger import CHAPTERS, NOTEBOOKS, WORKBOOK

SIZES = {"phone": (390, 844), "desk": (1400, 900)}
# Pages of each kind, and all that have players.
CHOSEN = ["index", "teach", "items", "glossary", "reference", "reference/verdict.stability"]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The folder of the pages, built from the committed notebooks as they are stored."""
    folder = tmp_path_factory.mktemp("site")
    source, html = folder / "source", folder / "html"
    shutil.copytree(WORKBOOK.parent / "book", source)
    shutil.copy(WORKBOOK / "inventory.toml", source)
    for notebook in NOTEBOOKS:
        place = source / "chapters" / notebook.relative_to(WORKBOOK)
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(notebook, place)
    options = ["-q", "--fail-on-warning", "--keep-going"]
    command = [sys.executable, "-m", "sphinx", *options, str(source), str(html)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder)
    assert done.returncode == 0, done.stderr
    return html


# ---- as files ----


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


def test_links_and_anchors_lead_somewhere(site):
    anchors, broken = {}, []

    def read(path):
        if path not in anchors:
            text = path.read_text(encoding="utf-8")
            anchors[path] = (text, set(re.findall(r'\bid="([^"]+)"', text)))
        return anchors[path]

    for page in site.rglob("*.html"):
        for link in re.findall(r'<a [^>]*?href="([^"]+)"', read(page)[0]):
            if re.match(r"\w+:", link) or link == "#":
                continue
            place, _, anchor = link.partition("#")
            target = (page.parent / place).resolve() if place else page
            if not target.exists():
                broken.append((page.name, link))
            elif anchor and target.suffix == ".html" and anchor not in read(target)[1]:
                broken.append((page.name, link))
    assert broken == []


# ---- in a browser ----


def open_page(browser, address, size="desk", scheme="light"):
    """Open a page; return it with what the console said and the addresses that it asked for."""
    width, height = SIZES[size]
    page = browser.new_page(viewport={"width": width, "height": height}, color_scheme=scheme)
    said, asked = [], []
    page.on("console", lambda m: said.append(m.text) if m.type == "error" else None)
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    go(page, address)
    return page, said, asked


def go(page, address):
    """Go to an address and wait until its mathematics is set."""
    page.goto(address)
    page.wait_for_function("!window.MathJax || MathJax.startup.promise", timeout=20_000)
    page.evaluate("window.MathJax && MathJax.startup.promise")


def addresses(site):
    """Yield the chosen pages and all notebooks' pages, by their names."""
    names = [
        *CHOSEN,
        *sorted(
            p.relative_to(site).with_suffix("").as_posix()
            for p in (site / "chapters").rglob("[0-9]*.html")
        ),
    ]
    return {name: (site / f"{name}.html").as_uri() for name in names}


FACTS = """() => ({
  wide: document.documentElement.scrollWidth - document.documentElement.clientWidth,
  raw: [...document.querySelectorAll(".math")].filter((m) => !m.querySelector("mjx-container"))
    .length,
  broken: document.querySelectorAll("mjx-merror").length,
  titles: document.querySelectorAll("h1").length,
  silent: [...document.querySelectorAll("article img")].filter(
    (i) => !i.alt || /^(_images|\\.\\.)/.test(i.alt)).length,
})"""


def test_pages_stand(browser, site):
    """No console error, no outside request, no sideways scroll, mathematics set, one h1, alts."""
    wanted = {"wide": 0, "raw": 0, "broken": 0, "titles": 1, "silent": 0}
    found = {}
    # One page for all: a new one for each takes as long again.
    page, said, asked = open_page(browser, addresses(site)["index"])
    for name, address in addresses(site).items():
        go(page, address)
        for size, (width, height) in SIZES.items():
            page.set_viewport_size({"width": width, "height": height})
            for scheme in ("light", "dark"):
                page.emulate_media(color_scheme=scheme)
                facts = page.evaluate(FACTS)
                if facts != wanted:
                    found[name, size, scheme] = {k: v for k, v in facts.items() if v != wanted[k]}
        outside = [a for a in asked if not a.startswith(("file:", "data:", "blob:"))]
        if said or outside:
            found[name] = said + outside
        said.clear()
        asked.clear()
    page.close()
    assert found == {}


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_pages_are_accessible(browser, site, scheme):
    """axe finds nothing serious, contrast included."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright")
    rules = {"resultTypes": ["violations"]}
    for name in ("index", "teach", "chapters/07_pendulum", "chapters/exercises/07_pendulum"):
        page, _, _ = open_page(browser, addresses(site)[name], "desk", scheme)
        found = axe.Axe().run(page, options=rules).response["violations"]
        page.close()
        grave = [
            (v["id"], v["nodes"][0]["html"][:120])
            for v in found
            if v["impact"] in ("serious", "critical")
        ]
        assert grave == [], name


def test_players_move(browser, site):
    page, _, _ = open_page(browser, addresses(site)["chapters/07_pendulum"])
    for player in page.query_selector_all(".sb-player"):
        before = player.query_selector(".sb-stage").inner_html()
        slider = player.query_selector("input[type=range]")
        slider.focus()
        for _ in range(3):
            slider.press("ArrowRight")
        slider.press("ArrowLeft")
        page.wait_for_timeout(100)
        assert player.query_selector(".sb-stage").inner_html() != before
    page.close()


def test_search_shows_a_line_of_context(browser, site):
    page, said, _ = open_page(browser, (site / "search.html").as_uri() + "?q=pendulum")
    page.wait_for_selector("p.context", timeout=10_000)
    assert "pendulum" in page.inner_text("p.context >> nth=0").lower()
    assert said == []
    page.close()


def test_code_is_folded_on_a_phone_and_one_switch_shows_it(browser, site):
    page, _, _ = open_page(browser, addresses(site)["chapters/exercises/07_pendulum"], "phone")
    assert page.locator(".cell_input").first.is_visible()  # there it is part of the task
    page.goto(addresses(site)["chapters/07_pendulum"])
    assert not page.locator(".cell_input").first.is_visible()
    folded = page.locator("details.hide").first
    folded.locator("summary").click()
    assert folded.locator(".cell_input").is_visible()
    page.click(".sb-code-switch")
    assert page.locator(".cell_input").first.is_visible()
    page.close()


def test_a_chapter_prints(chromium, site, tmp_path):
    print_page(chromium, site / "chapters" / "07_pendulum.html", tmp_path / "07.pdf")
    pages = [page.extract_text() for page in pypdf.PdfReader(tmp_path / "07.pdf").pages]
    text = "\n".join(pages)
    assert "07. The pendulum" in pages[0] and "In the book" in text
    assert "Skip to content" not in text and "Hide code" not in text
    assert all(len(page.strip()) > 40 for page in pages), "a page is almost empty"
