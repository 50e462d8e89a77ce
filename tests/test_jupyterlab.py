"""Chapters in JupyterLab, in a real browser; on loopback only."""

import json
import secrets
import shutil
import socket
import subprocess
import sys
import time
import urllib.request

import pytest

from ledger import WORKBOOK


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
        for _ in range(480):
            try:
                urllib.request.urlopen(f"{address}/api?token={token}", timeout=1).read()
                break
            except OSError:
                if server.poll() is not None:
                    pytest.skip("JupyterLab does not start here")
                time.sleep(0.25)
        else:
            pytest.fail("JupyterLab does not answer within two minutes")
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
    # Before the kernel is ready a dialog would block what follows.
    ready = ".jp-Notebook-ExecutionIndicator[data-status=idle]"
    page.wait_for_selector(ready, state="attached", timeout=60_000)
    page.click(".lm-MenuBar-item:has-text('Run')")
    page.click(".lm-Menu-item:has-text('Run All Cells')")
    page.keyboard.press("Control+s")
    saved = folder / f"{name}.ipynb"
    last = None
    for _ in range(600):
        page.wait_for_timeout(500)
        page.keyboard.press("Control+s")
        try:
            cells = json.loads(saved.read_text(encoding="utf-8"))["cells"]
        except ValueError:  # it is being written
            continue
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
