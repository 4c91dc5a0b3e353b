"""A browser without network access."""

import shutil

import pytest

from fluxobs.page import built
from support.browser import Window

playwright = pytest.importorskip("playwright.sync_api")


@pytest.fixture(scope="session")
def browser():
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        pytest.skip("no browser: chromium")
    with playwright.sync_playwright() as started:
        options = ["--no-sandbox", "--disable-gpu"]
        launched = started.chromium.launch(executable_path=chromium, args=options)
        yield launched
        launched.close()


@pytest.fixture
def window(browser, tmp_path):
    """Return a function that opens a page offline; check at the end that it sent no requests."""
    opened = []

    def make(name_or_text, **options):
        path = tmp_path / "opened.html"
        if "<" in str(name_or_text):
            path.write_text(name_or_text, encoding="utf-8")
        else:
            path.write_text(built(name_or_text), encoding="utf-8")
        context = browser.new_context(offline=True, accept_downloads=True, **options)
        opened.append((context, Window(context.new_page(), path)))
        return opened[-1][1]

    yield make
    for context, opened_window in opened:
        assert opened_window.silent()
        context.close()
