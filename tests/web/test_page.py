"""The page: every log through the browser equals the library; drops, keys, phones, and mistakes."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

import fluxobs
from fluxobs.machines.files import example_text
from support.browser import Window, template

_SPEC = importlib.util.spec_from_file_location(
    "write_corpus", Path(__file__).parents[1] / "logs" / "write_corpus.py"
)
corpus = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(corpus)

#: Formats that the page reads; of the others it says what to do.
READ = (".csv", ".txt", ".lvm", ".dat", ".gz", ".npz", ".npy")
#: Columns of pictures that are not columns of files.
DRAWN = {"innovation", "adapting", "raw", "truth"}
#: What rounding makes of sums that are taken in another order, over the size of a column.
ROUNDING = 1e-9


@pytest.fixture
def page(window):
    def opened(**options):
        one = window("page.html", **options)
        one.page.wait_for_selector("body[data-ready]")
        return one

    return opened


def estimated(one, files, machine=None, **options):
    """Give the page files and wait for its estimates."""
    for name, value in options.items():
        one.page.locator(f"#{name}").evaluate("(e, v) => { e.value = v }", value)
    if machine is not None:
        one.page.locator("#machine").evaluate("(e, v) => { e.value = v }", machine)
    one.js("() => { delete document.body.dataset.done }")
    one.page.set_input_files("#files", files)
    one.page.wait_for_selector("body[data-done]")


def equal(one, expected, but=()):
    """Every column that the library writes is the page's, to rounding."""
    assert set(one.columns()) - DRAWN >= set(expected.estimates.columns)
    for name in expected.estimates.columns:
        given, wanted = one.column(name).astype(float), expected[name].astype(float)
        assert given.shape == wanted.shape, name
        if name in but:
            continue
        off = given - wanted
        if name.startswith("theta") and not name.endswith("_std"):
            off = np.angle(np.exp(1j * off))
        size = np.nanmax(np.abs(wanted)) or 1.0
        assert (np.isnan(given) == np.isnan(wanted)).all(), name
        assert np.nanmax(np.abs(off)) <= ROUNDING * size, name
    words = one.js("() => fluxobs.state.explained")
    assert words["summary"] == expected.summary
    assert words["warnings"] == expected.warnings


@pytest.fixture(scope="module")
def shared(browser, tmp_path_factory):
    """One page for all logs of the corpus: to open it takes longer than to estimate."""
    path = tmp_path_factory.mktemp("page") / "page.html"
    path.write_text(template("page.html"), encoding="utf-8")
    context = browser.new_context(offline=True)
    one = Window(context.new_page(), path)
    one.page.wait_for_selector("body[data-ready]")
    yield one
    assert one.silent()
    context.close()


@pytest.mark.parametrize("name", [n for n in corpus.LAYOUTS if n.endswith(READ)])
def test_every_log_gives_what_the_library_gives(shared, name):
    options = {"preset": corpus.PRESETS.get(name, "")}
    own = {"preset": options["preset"]} if options["preset"] else {}
    own |= {"sample_time": corpus.SAMPLE_TIME} if name == "moteus.npz" else {}
    options["sample-time"] = str(own.get("sample_time", ""))
    machine = example_text(corpus.MACHINE)
    estimated(shared, corpus.FOLDER / name, machine, **options)
    assert shared.page.inner_text("#status").startswith("Estimated"), shared.page.inner_text(
        "#status"
    )
    expected = fluxobs.estimate(corpus.FOLDER / name, corpus.MACHINE, **own)
    equal(shared, expected)
    assert shared.js("() => fluxobs.state.found.notes") == list(expected.log.notes)


@pytest.mark.parametrize("name", [n for n in corpus.LAYOUTS if not n.endswith(READ)])
def test_other_formats_are_refused_with_a_remedy(shared, name):
    estimated(shared, corpus.FOLDER / name, example_text(corpus.MACHINE))
    said = shared.page.inner_text("#status")
    assert name in said
    assert "fluxobs estimate" in said
