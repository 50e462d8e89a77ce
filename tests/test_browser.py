"""The built site and JupyterLab in a real browser, where there is one; on loopback only.

Needs a Chromium, and the extra "browser" (`run.py test` installs it where it finds a Chromium).
"""

import json
import re
import secrets
import shutil
import socket
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import pytest

from built import build_site
from ledger import WORKBOOK

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "book"))
from paper import find_chromium, print_page  # noqa: E402

CHROMIUM = find_chromium()
if CHROMIUM is None:
    pytest.skip("no Chromium, Chrome or Edge is here", allow_module_level=True)
playwright = pytest.importorskip("playwright.sync_api", reason="the extra 'browser' is missing")
axe = pytest.importorskip("axe_playwright_python.sync_playwright")

SIZES = {"phone": (390, 844), "desk": (1400, 900)}
# Pages of each kind, and all that have players.
CHOSEN = ["index", "teach", "items", "glossary", "reference", "reference/verdict.stability"]


@pytest.fixture(scope="module")
def browser():
    with playwright.sync_playwright() as driver:
        try:
            found = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        except playwright.Error as error:
            pytest.skip(f"the browser does not start: {error}")
        yield found
        found.close()


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The folder of the built pages, from the committed outputs."""
    html, done = build_site(tmp_path_factory.mktemp("site"))
    assert done.returncode == 0, done.stderr
    return html


def open_page(browser, address, size="desk", scheme="light"):
    """Open a page; return it with what the console said and the addresses that it asked for."""
    width, height = SIZES[size]
    page = browser.new_page(viewport={"width": width, "height": height}, color_scheme=scheme)
    said, asked = [], []
    page.on("console", lambda m: said.append(m.text) if m.type == "error" else None)
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    page.goto(address)
    page.wait_for_function("!window.MathJax || MathJax.startup.promise", timeout=20_000)
    page.evaluate("window.MathJax && MathJax.startup.promise")
    return page, said, asked


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
    for name, address in addresses(site).items():
        page, said, asked = open_page(browser, address)
        for size, (width, height) in SIZES.items():
            page.set_viewport_size({"width": width, "height": height})
            for scheme in ("light", "dark"):
                page.emulate_media(color_scheme=scheme)
                facts = page.evaluate(FACTS)
                if facts != wanted:
                    found[name, size, scheme] = {k: v for k, v in facts.items() if v != wanted[k]}
        page.close()
        outside = [a for a in asked if not a.startswith(("file:", "data:", "blob:"))]
        if said or outside:
            found[name] = said + outside
    assert found == {}


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


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_pages_are_accessible(browser, site, scheme):
    """axe finds nothing serious, contrast included."""
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


def test_a_chapter_prints(site, tmp_path):
    pypdf = pytest.importorskip("pypdf")
    print_page(CHROMIUM, site / "chapters" / "07_pendulum.html", tmp_path / "07.pdf")
    pages = [page.extract_text() for page in pypdf.PdfReader(tmp_path / "07.pdf").pages]
    text = "\n".join(pages)
    assert "07. The pendulum" in pages[0] and "In the book" in text
    assert "Skip to content" not in text and "Hide code" not in text
    assert all(len(page.strip()) > 40 for page in pages), "a page is almost empty"


# ---- JupyterLab ----


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """JupyterLab on a copy of three chapters: its address and token."""
    folder = tmp_path_factory.mktemp("lab")
    for name in ("00_start_here", "07_pendulum", "11_linearization_and_eigenvalues"):
        shutil.copy(WORKBOOK / f"{name}.ipynb", folder)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    token = secrets.token_hex(8)
    options = [f"--port={port}", "--ip=127.0.0.1", "--no-browser", "--allow-root"]
    options += [f"--IdentityProvider.token={token}", "--LabApp.news_url=None"]
    command = [sys.executable, "-m", "jupyterlab", *options, f"--notebook-dir={folder}"]
    with (folder / "lab.log").open("w") as log:
        server = subprocess.Popen(command, stdout=log, stderr=log, cwd=folder)
    address = f"http://127.0.0.1:{port}"
    try:
        for _ in range(120):
            try:
                urllib.request.urlopen(f"{address}/api?token={token}", timeout=1).read()
                break
            except OSError:
                if server.poll() is not None:
                    pytest.skip("JupyterLab does not start here")
                time.sleep(0.25)
        yield address, token, folder
    finally:
        server.terminate()
        server.wait(timeout=20)


@pytest.mark.parametrize(
    "name", ["00_start_here", "07_pendulum", "11_linearization_and_eigenvalues"]
)
def test_a_chapter_runs_in_jupyterlab(browser, lab, name):
    address, token, folder = lab
    page = browser.new_page(viewport={"width": 1400, "height": 900})
    page.goto(f"{address}/lab/workspaces/{name}/tree/{name}.ipynb?token={token}")
    page.wait_for_selector(".jp-NotebookPanel .jp-Cell", timeout=60_000)
    page.wait_for_selector(".jp-Toolbar-kernelName:not(:has-text('No Kernel'))", timeout=60_000)
    page.wait_for_timeout(1500)  # until the kernel is ready: a dialog would block what follows
    page.click(".lm-MenuBar-item:has-text('Run')")
    page.click(".lm-Menu-item:has-text('Run All Cells')")
    page.keyboard.press("Control+s")
    saved = folder / f"{name}.ipynb"
    last = None
    for _ in range(240):
        page.wait_for_timeout(500)
        page.keyboard.press("Control+s")
        cells = json.loads(saved.read_text(encoding="utf-8"))["cells"]
        code = [c for c in cells if c["cell_type"] == "code" and "".join(c["source"]).strip()]
        last = code[-1]
        if last["execution_count"] and last["execution_count"] >= len(code) and last["outputs"]:
            break
    kinds = [o["output_type"] for cell in code for o in cell["outputs"]]
    said = [o for cell in code for o in cell["outputs"] if o.get("name") == "stderr"]
    assert "error" not in kinds and not said
    assert "".join(last["outputs"][0]["text"]).strip(), "summary() has said something"
    if name == "07_pendulum":
        move_a_slider(page)
    page.close()


def move_a_slider(page):
    """Move a player's slider in the live notebook, and see the picture change."""
    page.evaluate(
        "document.querySelectorAll('.jp-WindowedPanel-outer').forEach(p => p.scrollTop = 0)"
    )
    page.wait_for_selector(".sb-player input[type=range], .widget-slider", timeout=30_000)
    changed = page.evaluate(
        """async () => {
          const player = document.querySelector(".sb-player");
          const slider = player.querySelector("input[type=range]");
          const before = player.querySelector(".sb-stage").innerHTML;
          slider.value = Number(slider.max) === Number(slider.value) ? 0 : slider.max;
          slider.dispatchEvent(new Event("input", {bubbles: true}));
          await new Promise((done) => setTimeout(done, 300));
          return player.querySelector(".sb-stage").innerHTML !== before;
        }"""
    )
    assert changed
