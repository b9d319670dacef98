"""A report page in a browser: drawn and printed without a word on its console, which is where a request would be."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest
from made_result import arm, identification, identified_model, page_of, validation

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
PATIENCE_S = 300.0
"""For a browser to come up on a machine that is busy."""

pytestmark = pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine: apt-get install chromium")


@pytest.fixture(scope="module")
def page() -> str:
    known = identification(identified_model(arm()))
    return page_of(known, validation(known.model.model.arm.joint_names))


def browse(page: Path, *words: str) -> list[str]:
    """What a headless browser that does something with a page says on its console."""
    command = [BROWSER, "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-background-networking"]
    command += [f"--user-data-dir={page.with_suffix('.profile')}", "--enable-logging=stderr", *words, page.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=True)
    return [line for line in done.stderr.splitlines() if "CONSOLE" in line]


def test_a_page_is_printed_without_complaint(tmp_path, page):
    file, paper = tmp_path / "page.html", tmp_path / "page.pdf"
    file.write_text(page)
    assert browse(file, "--no-pdf-header-footer", f"--print-to-pdf={paper}") == []
    assert paper.read_bytes().startswith(b"%PDF") and paper.stat().st_size > 20_000


def test_a_page_that_asked_for_something_would_be_heard(tmp_path, page):
    file = tmp_path / "page.html"
    file.write_text(page.replace("</main>", '<img src="http://127.0.0.1:9/a.png"></main>'))
    said = browse(file, "--dump-dom")
    assert len(said) == 1 and "Content Security Policy" in said[0]
