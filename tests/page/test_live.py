"""The live page with a stream from `fluxobs live` or from a serial port."""

import threading
import time

import numpy as np
import pytest

from fluxobs.live import Watch
from fluxobs.machines import example, example_text
from fluxobs.page import built
from fluxobs.simulation.closed_form.demo import LOG
from support.browser import Window

DEMO = LOG.read_bytes()
MACHINE = "servo-400w"

#: A serial port that sends the bytes that a test writes to window.port.
PORT = """
    window.port = { pieces: [], closed: false };
    const port = {
      open: async (options) => { window.port.options = options; },
      close: async () => { window.port.closed = true; },
      readable: { getReader: () => ({
        read: async () => {
          for (;;) {
            if (window.port.closed) return { done: true };
            const next = window.port.pieces.shift();
            if (next) return { done: false, value: new Uint8Array(next) };
            await new Promise((wake) => setTimeout(wake, 5));
          }
        },
        cancel: async () => { window.port.closed = true; },
        releaseLock() {},
      }) },
    };
    Object.defineProperty(navigator, "serial", { value: { requestPort: async () => port } });
"""


@pytest.fixture
def served(browser):
    """Return a function that opens the page of `fluxobs live`; check that it requests no others."""
    from fluxobs.live.serve import Server

    opened = []

    def make(**settings):
        facts = {"machine": example_text(MACHINE), "options": {}, "name": "test", **settings}
        server = Server(0, facts, True)
        context = browser.new_context()
        page = Window(context.new_page(), server.url)
        sockets = []
        page.page.on("websocket", lambda opened_socket: sockets.append(opened_socket.url))
        opened.append((server, context, page))
        return server, page

    yield make
    for server, context, page in opened:
        assert not page.complaints
        requested = [url for url in page.asked if not url.startswith(("blob:", "data:"))]
        assert set(requested) <= {server.url}
        context.close()
        server.end()


def send(server, data, piece=7000):
    def run():
        server.watched.wait(20)
        for k in range(0, len(data), piece):
            server.send(data[k : k + piece])
            time.sleep(0.002)
        server.end()

    threading.Thread(target=run).start()


def column(page, name):
    return np.array(
        page.js(
            "(name) => { const v = fluxobs.live.view;"
            " return Array.from(v.columns[name].subarray(0, v.rows)); }",
            name,
        )
    )


ENDED = "() => document.querySelector('#live-view p')?.textContent.includes('has ended')"


def test_the_page_shows_what_the_library_estimates(served, tmp_path):
    server, page = served(unknowns="drift,resistance,inverter", memory=0.04)
    send(server, DEMO)
    page.until(ENDED)
    watch = Watch(
        example(MACHINE), tmp_path / "s", unknowns="drift,resistance,inverter", memory=0.04
    )
    rows = list(watch.feed(DEMO))
    for name in ("t", "theta_e", "speed_e", "drift_alpha", "resistance", "psi_f", "valid"):
        expected = np.concatenate([r.columns[name] for r in rows])
        assert np.array_equal(column(page, name), expected.astype(float), equal_nan=True), name
    text = page.js("() => document.querySelector('#live-view').textContent")
    assert "10000 rows" in text
    assert "5000 rows a second" in text


def test_it_can_be_held_and_zoomed(served):
    server, page = served()
    send(server, DEMO)
    page.until("() => window.fluxobs?.live.view?.rows > 3000")
    page.page.get_by_role("button", name="Hold").click()
    page.page.locator("#live-view [data-panel=speed]").press("+")
    first, last = page.js("() => fluxobs.live.panels.window")
    page.until(ENDED)
    assert page.js("() => fluxobs.live.panels.window") == [first, last]
    page.page.get_by_role("button", name="Go on").click()
    assert page.js("() => fluxobs.live.held") is False


def test_a_malformed_stream_is_reported(served):
    server, page = served()
    send(server, DEMO.replace(b"u_alpha", b"foo", 1))
    page.until("() => document.getElementById('status').className === 'error'")
    assert "u_alpha" in page.js("() => document.getElementById('status').textContent")


def test_the_oldest_rows_are_dropped(window):
    page = window("page.html")
    page.until("() => document.body.dataset.ready")
    states = page.js(
        """() => {
            const view = new fluxobs.Recent(["t", "valid"], new Set(["valid"]), 1024);
            const states = [];
            let k = 0;
            for (const count of [100, 500, 300, 200, 700, 64, 1]) {
                const t = Float64Array.from({ length: count }, () => k++);
                view.append({ t, valid: new Uint8Array(count).fill(1) });
                const [low, high] = view.range("t", 0, view.rows);
                states.push([view.rows, low, high, view.t[0], view.t[view.rows - 1]]);
            }
            return states;
        }"""
    )
    last = -1
    for (rows, low, high, first, end), count in zip(
        states, [100, 500, 300, 200, 700, 64, 1], strict=True
    ):
        last += count
        assert (low, high) == (first, end)
        assert end == last
        assert min(last + 1, 448) <= rows <= 1024


def test_a_serial_port(browser, tmp_path):
    path = tmp_path / "page.html"
    path.write_text(built("page.html"), encoding="utf-8")
    context = browser.new_context(accept_downloads=True)
    context.add_init_script(PORT)
    page = Window(context.new_page(), path)
    page.until("() => document.body.dataset.ready")
    page.page.click("#serial")
    assert "Choose the machine" in page.js("() => document.getElementById('status').textContent")
    page.page.select_option("#example", MACHINE)
    page.page.fill("#baud", "2000000")
    page.page.click("#serial")
    page.until("() => window.port.options")
    assert page.js("() => window.port.options.baudRate") == 2_000_000

    def put(data):
        page.js("(piece) => void window.port.pieces.push(piece)", list(data))

    stream = DEMO[: DEMO.index(b"\n", 300_000) + 1]
    rows_sent = stream.count(b"\n") - 1
    put(stream[:200_000])
    page.until("() => fluxobs.live.view?.rows > 3000 && !fluxobs.live.waiting.length")
    page.page.get_by_role("button", name="Record").click()
    page.until("() => fluxobs.live.tape !== null")
    before = page.js("() => fluxobs.live.status.rows")
    put(stream[200_000:])
    page.until(f"() => fluxobs.live.status.rows === {rows_sent}")
    with page.page.expect_download() as download:
        page.page.get_by_role("button", name="Save the recording").click()
    download.value.save_as(tmp_path / "saved.csv")
    header, *rows = (tmp_path / "saved.csv").read_bytes().splitlines()
    assert header == DEMO.splitlines()[0]
    assert rows == stream.splitlines()[1 + before :]
    page.page.get_by_role("button", name="Stop").click()
    page.until(ENDED)
    assert page.js("() => window.port.closed")
    assert page.silent()
    context.close()
