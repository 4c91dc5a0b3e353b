"""The page returns the library's estimates for every log; drops, keys, phones, and mistakes."""

import importlib.util
import re
import tomllib
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import fluxobs
from fluxobs.errors import name_flags
from fluxobs.machines.files import example_text
from fluxobs.machines.new import new_machine
from fluxobs.page import built
from fluxobs.presentation.plot_data import signals
from support.browser import Window
from support.page_logs import written

_SPEC = importlib.util.spec_from_file_location(
    "write_corpus", Path(__file__).parents[1] / "logs" / "write_corpus.py"
)
corpus = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(corpus)

#: Formats that the page reads; for other formats, the page's message gives a remedy.
READ = (".csv", ".txt", ".lvm", ".dat", ".gz", ".npz", ".npy")
#: Columns for plots that are not columns of files.
DRAWN = {"innovation", "adapting", "raw", "truth"}
#: Rounding error of sums in another order, relative to the largest value of a column.
ROUNDING = 1e-6
#: Learning ends when no assumption moves by this share of its standard deviation, twice.
SETTLED = 0.1
#: The fit of a flux map uses eigenvectors, which amplify rounding.
MAPPED = {"ipm-5kw6": 1e-4, "synrm-6kw7-saturated": 1e-4, "synrm-6kw7": 1e-4}
MAPPED["induction-2kw2"] = 2e-2  # the rotor flux is learnt in more iterations


@pytest.fixture
def page(window):
    def opened(**options):
        opened_page = window("page.html", **options)
        opened_page.page.wait_for_selector("body[data-ready]")
        return opened_page

    return opened


def estimated(opened_page, files, machine=None, **options):
    """Open files in the page and wait for its estimates."""
    for name, value in options.items():
        opened_page.page.locator(f"#{name}").evaluate("(e, v) => { e.value = v }", value)
    if machine is not None:
        opened_page.page.locator("#machine").evaluate("(e, v) => { e.value = v }", machine)
    opened_page.js("() => { delete document.body.dataset.done }")
    opened_page.page.set_input_files("#files", files)
    opened_page.page.wait_for_selector("body[data-done]")


def equal(opened_page, expected, rounding=ROUNDING):
    """Check that the page has every column of the library, equal within rounding."""
    assert set(opened_page.columns()) - DRAWN >= set(expected.estimates.columns)
    for name in expected.estimates.columns:
        shown, wanted = opened_page.column(name).astype(float), expected[name].astype(float)
        assert shown.shape == wanted.shape, name
        error = shown - wanted
        if name.startswith("theta") and not name.endswith("_std"):
            error = np.angle(np.exp(1j * error))
        assert (np.isnan(shown) == np.isnan(wanted)).all(), name
        if np.isnan(wanted).all():
            continue
        size = np.nanmax(np.abs(wanted)) or 1.0
        # Where the position is not known, a standard deviation depends on when learning ends.
        share = 10 * rounding if name.endswith("_std") else rounding
        if rounding > ROUNDING and name.endswith("_std") and expected["valid"].any():
            error = error[expected["valid"]]
        allowed = share * size + 1e-15
        std = "drift_std" if name.startswith("drift_") else f"{name.removesuffix('_error')}_std"
        if rounding > ROUNDING and std in expected.estimates.columns:
            # The iterations end within a share of the standard deviation.
            allowed = max(allowed, SETTLED * float(np.nanmedian(expected[std])))
        assert np.nanmax(np.abs(error)) <= allowed, name
    explained = opened_page.js("() => fluxobs.state.explained")
    if rounding == ROUNDING:
        assert explained["summary"][1:] == [list(row) for row in expected.summary_rows[1:]]
        assert explained["warnings"] == expected.warnings
    else:  # the last digits may differ
        shown = [[label, re.sub(r"[\d.]", "", value)] for label, value in explained["summary"][1:]]
        assert shown == [
            [label, re.sub(r"[\d.]", "", value)] for label, value in expected.summary_rows[1:]
        ]


@contextmanager
def opened_once(browser, tmp_path_factory, **options):
    """A page for many tests: opening a page takes longer than estimating."""
    path = tmp_path_factory.mktemp("page") / "page.html"
    path.write_text(built("page.html"), encoding="utf-8")
    context = browser.new_context(offline=True, accept_downloads=True, **options)
    opened_page = Window(context.new_page(), path)
    opened_page.page.wait_for_selector("body[data-ready]")
    yield opened_page
    assert opened_page.silent()
    context.close()


@pytest.fixture(scope="module")
def shared(browser, tmp_path_factory):
    """One page for all logs of the corpus."""
    with opened_once(browser, tmp_path_factory) as opened_page:
        yield opened_page


@pytest.fixture(scope="module")
def plain(browser, tmp_path_factory):
    """A page with one log of the corpus."""
    with opened_once(browser, tmp_path_factory) as opened_page:
        estimated(opened_page, corpus.FOLDER / "plain.csv", example_text("servo-400w"))
        yield opened_page


@pytest.fixture(scope="module")
def demo(browser, tmp_path_factory):
    """A page with the demo log, opened without a mouse."""
    size = {"width": 1200, "height": 900}
    with opened_once(browser, tmp_path_factory, viewport=size) as opened_page:
        keys = opened_page.page.keyboard
        for _ in range(6):
            keys.press("Tab")
            if opened_page.js("() => document.activeElement.id") == "demo":
                break
        keys.press("Enter")
        opened_page.page.wait_for_selector("body[data-done]")
        yield opened_page


#: Text and arrays; another test shows plain.csv. Other logs are slow.
FEW_LOGS = {"german-excel.csv", "moteus.npz"}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name in FEW_LOGS else pytest.mark.slow)
        for name in corpus.LAYOUTS
        if name.endswith(READ)
    ],
)
def test_every_log_gives_what_the_library_gives(shared, name):
    options = {"preset": corpus.PRESETS.get(name, "")}
    arguments = {"preset": options["preset"]} if options["preset"] else {}
    arguments |= {"sample_time": corpus.SAMPLE_TIME} if name == "moteus.npz" else {}
    options["sample-time"] = str(arguments.get("sample_time", ""))
    machine = example_text(corpus.MACHINE)
    estimated(shared, corpus.FOLDER / name, machine, **options)
    assert shared.page.inner_text("#status").startswith("Estimated"), shared.page.inner_text(
        "#status"
    )
    expected = fluxobs.estimate(corpus.FOLDER / name, corpus.MACHINE, **arguments)
    equal(shared, expected)
    assert shared.js("() => fluxobs.state.found.notes") == list(expected.log.notes)


@pytest.mark.parametrize("name", [n for n in corpus.LAYOUTS if not n.endswith(READ)])
def test_other_formats_are_refused_with_a_remedy(shared, name):
    estimated(shared, corpus.FOLDER / name, example_text(corpus.MACHINE))
    message = shared.page.inner_text("#status")
    assert name in message
    assert "fluxobs estimate" in message


def test_the_demo_is_one_click(demo):
    assert "valid on" in demo.page.inner_text(".summary")
    assert demo.page.inner_text("#command") == "fluxobs demo"


def test_values_at_the_cursor_belong_to_one_row(demo):
    """This also holds where rows are thinned for drawing, and after a zoom."""
    opened_page = demo
    opened_page.page.set_viewport_size({"width": 1200, "height": 900})
    log = fluxobs.demo_log()
    true = np.degrees(np.concatenate([batch.truth for batch in log.aligned()]))
    panel = opened_page.page.locator("figure[data-panel=position]")
    panel.scroll_into_view_if_needed()
    box = panel.bounding_box()

    def check():
        opened_page.page.wait_for_timeout(100)
        t, _, shown = (value.inner_text() for value in panel.locator(".u-value").all())
        row = round(float(t.removesuffix(" s")) / 2e-4)
        assert float(shown) == pytest.approx(true[row], abs=6e-3), t
        return row

    def move(share):
        opened_page.page.mouse.move(box["x"] + share * box["width"], box["y"] + 60)

    rows = []
    for share in (0.3, 0.6):
        move(share)
        rows.append(check())
    opened_page.page.mouse.down()
    move(0.65)
    opened_page.page.mouse.up()
    rows.append(check())
    panel.focus()
    opened_page.page.keyboard.press("ArrowRight")
    rows.append(check())
    assert len(set(rows)) == 4


def test_a_log_and_a_machine_file_can_be_dropped(page):
    opened_page = page()
    text = (corpus.FOLDER / "plain.csv").read_text()
    machine = example_text(corpus.MACHINE)
    opened_page.js(
        """([text, machine]) => {
            const data = new DataTransfer();
            data.items.add(new File([machine], "motor.toml"));
            data.items.add(new File([text], "dropped.csv"));
            document.getElementById("drop").dispatchEvent(
                new DragEvent("drop", { dataTransfer: data, bubbles: true }));
        }""",
        [text, machine],
    )
    opened_page.page.wait_for_selector("body[data-done]")
    equal(opened_page, fluxobs.estimate(corpus.FOLDER / "plain.csv", corpus.MACHINE))
    opened_page.js(
        """(machine) => {
            delete document.body.dataset.done;
            const data = new DataTransfer();
            data.items.add(new File([machine.replace("R_s = 0.36", "R_s = 0.4")], "other.toml"));
            document.getElementById("drop").dispatchEvent(
                new DragEvent("drop", { dataTransfer: data, bubbles: true }));
        }""",
        machine,
    )
    opened_page.page.wait_for_selector("body[data-done]")
    assert opened_page.js("() => fluxobs.state.found.parameters.values.R_s") == 0.4
    assert opened_page.page.locator("#opened").inner_text() == "dropped.csv"


def test_currents_voltages_and_speed_are_drawn(plain):
    opened_page = plain
    result = fluxobs.estimate(corpus.FOLDER / "plain.csv", "servo-400w")
    lag = None if result.lag is None else result.lag.lag
    expected = signals(result.log, ("alpha", "beta"), lag, result["theta_e"], result["speed_e"])
    for name in ("i_d", "i_q", "u_d", "u_q"):
        np.testing.assert_allclose(opened_page.column(name), expected[name], rtol=1e-5, atol=1e-5)
    assert np.nanstd(expected["i_q"]) > 0
    titles = opened_page.js("() => fluxobs.results.panels.specs.map((s) => [s.title, s.unit])")
    for panel in (["Speed", "rpm"], ["Current", "A"], ["Voltage", "V"]):
        assert panel in titles


def test_messages_name_the_fields_of_the_page(page, tmp_path):
    opened_page = page()
    log = tmp_path / "short.csv"
    log.write_text("u_alpha,u_beta,i_alpha,i_beta\n" + "1,2,3,4\n2,3,4,5\n" * 40)
    estimated(opened_page, log, example_text("servo-400w"))
    text = opened_page.page.locator("#status").inner_text()
    assert "“Sample time”" in text
    assert "--" not in text


#: Machine and unknowns.
MACHINES = [
    ("servo-400w", "drift,resistance,inverter"),
    ("ipm-2kw2", "drift"),
    ("ipm-2kw2", "auto"),
    ("induction-2kw2", "drift"),
    ("synrm-6kw7", "drift"),
    ("synrm-6kw7-saturated", "drift"),
    ("ipm-5kw6", "drift"),
    ("synrm-6kw7", "drift,current-bias"),
    ("maglev-knospe", "drift"),
]


#: The others are slow.
FEW_MACHINES = {MACHINES[1], MACHINES[2]}


@pytest.mark.parametrize(
    ("name", "unknowns"),
    [
        pytest.param(*pair, marks=() if pair in FEW_MACHINES else pytest.mark.slow)
        for pair in MACHINES
    ],
)
def test_every_machine_and_observer_gives_what_the_library_gives(shared, tmp_path, name, unknowns):
    record = written(name, tmp_path)
    options = {"unknowns": unknowns, "preset": "", "sample-time": ""}
    estimated(shared, record, example_text(name), **options)
    status = shared.page.inner_text("#status")
    shared.page.locator("#unknowns").evaluate("e => { e.value = 'auto' }")
    assert status.startswith("Estimated"), status
    expected = fluxobs.estimate(record, name, unknowns=unknowns)
    equal(shared, expected, MAPPED.get(name, ROUNDING))


def test_a_malformed_file_gets_the_librarys_message(page, tmp_path):
    opened_page = page()
    path = tmp_path / "letter.csv"
    path.write_text("Dear Sir,\nthere is no log in here.\n")
    estimated(opened_page, path, example_text("servo-400w"))
    with pytest.raises(fluxobs.errors.RecordError) as error:
        fluxobs.estimate(path, "servo-400w")
    shown = opened_page.page.inner_text("#status")
    before = name_flags(True)
    expected = str(error.value).replace(str(path), path.name)
    name_flags(before)
    assert shown == expected.replace("--frame", "“Frame”").replace("--column", "“Columns”")


def test_an_invalid_machine_gets_the_librarys_message(page):
    opened_page = page()
    estimated(
        opened_page,
        corpus.FOLDER / "plain.csv",
        'kind = "surface-pmsm"\nR_s = -1.0\nn_p = 4\nL_q = 1.0',
    )
    message = opened_page.page.inner_text("#status")
    assert "R_s must be positive" in message
    assert "unknown field 'L_q'; did you mean 'L_s'?" in message


def test_a_data_sheet_becomes_a_machine_file(page):
    opened_page = page()
    fields = {"kv": 900.0, "poles": 14.0, "R_line": 0.07, "L_line": 6e-5, "rated_current_rms": 20.0}
    opened_page.js(
        """() => {
            const given = { kv: "900 rpm/V", poles: "14", R_line: "70 mΩ", L_line: "60 µH",
                            rated_current_rms: "20" };
            for (const input of document.querySelectorAll("#sheet input"))
                input.value = given[input.name] ?? "";
            document.getElementById("kind").value = "surface-pmsm";
            document.getElementById("sheet").requestSubmit();
        }"""
    )
    opened_page.until("() => document.getElementById('machine').value.includes('psi_f')")
    wanted = new_machine("surface-pmsm", fields | {"poles": 14}).machine.parameters()
    written_machine = tomllib.loads(
        opened_page.js("() => document.getElementById('machine').value")
    )
    written_machine.pop("kind")
    assert written_machine == pytest.approx({k: v for k, v in wanted.items() if v is not None})


def test_the_keyboard_alone_reaches_a_single_sample(demo):
    opened_page = demo
    opened_page.page.set_viewport_size({"width": 1000, "height": 800})
    keys = opened_page.page.keyboard
    for _ in range(60):
        keys.press("Tab")
        if opened_page.js("() => document.activeElement.dataset.panel === 'position'"):
            break
    assert opened_page.js("() => document.activeElement.dataset.panel") == "position"
    for _ in range(12):
        keys.press("+")
    rows = opened_page.js(
        "() => { const p = fluxobs.results.panels; return p.charts[0].data[0].length }"
    )
    assert rows < 20
    before = opened_page.js("() => fluxobs.results.panels.row")
    keys.press("Shift+ArrowRight")
    assert opened_page.js("() => fluxobs.results.panels.row") == (before or 0) + 1 or before is None
    assert "Arrow keys" in opened_page.js("() => document.activeElement.getAttribute('aria-label')")


@pytest.mark.parametrize("scheme", ["dark", "light"])
def test_the_page_fits_a_phone(demo, scheme):
    demo.page.set_viewport_size({"width": 400, "height": 800})
    demo.page.emulate_media(color_scheme=scheme)
    demo.until("() => document.documentElement.scrollWidth <= 400")
    paper = demo.js("() => getComputedStyle(document.body).backgroundColor")
    assert (paper == "rgb(255, 255, 255)") == (scheme == "light")


def test_files_can_be_saved(plain):
    opened_page = plain
    with opened_page.page.expect_download() as saved:
        opened_page.page.click("#save-csv")
    table = pl.read_csv(saved.value.path())
    wanted = fluxobs.estimate(corpus.FOLDER / "plain.csv", "servo-400w").estimates
    assert set(table.columns) == set(wanted.columns)
    for name in wanted.columns:
        np.testing.assert_allclose(
            table[name].cast(float), wanted[name].cast(float), rtol=1e-6, atol=1e-7, err_msg=name
        )
    with opened_page.page.expect_download() as saved:
        opened_page.page.click("#save-machine")
    assert 'kind = "surface-pmsm"' in Path(saved.value.path()).read_text()


def test_a_slider_gives_what_the_library_gives(plain):
    opened_page = plain
    opened_page.js(
        """() => { const s = document.getElementById("slider-R_s"); s.value = 0.5;
                  s.dispatchEvent(new Event("input")); }"""
    )
    opened_page.until("() => fluxobs.results.took > 0 && !fluxobs.results.running")
    machine = fluxobs.machines.example("servo-400w")
    unknowns = ",".join(opened_page.js("() => fluxobs.state.found.unknowns"))
    wanted = fluxobs.estimate(
        corpus.FOLDER / "plain.csv",
        machine.with_values(R_s=machine.R_s * 2**0.5),
        unknowns=unknowns,
        lag=opened_page.js("() => fluxobs.state.found.lag"),
    )
    for name in ("theta_e", "speed_e", "drift_alpha", "valid"):
        np.testing.assert_allclose(opened_page.column(name), wanted[name], rtol=1e-6, atol=1e-7)
    row = opened_page.page.locator("tr.changed")
    assert f"valid on {100 * wanted['valid'].mean():.1f} % of the rows" in row.inner_text()
    opened_page.page.click(".sliders button")
    assert not row.is_visible()
