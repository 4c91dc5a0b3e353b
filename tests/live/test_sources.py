"""Sources of a stream, and the server of the live page."""

import os
import socket
import sys
import threading
import time
from contextlib import closing
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import pytest

from fluxobs.errors import FluxobsError
from fluxobs.live.sources import Demo, open_source


def until(source, wanted, send=None):
    """Return at least `wanted` bytes of a source; call `send` once the source listens."""
    received = b""
    end = time.monotonic() + 20
    with closing(source.chunks()) as chunks:
        for n, data in enumerate(chunks):
            if n == 0 and send is not None:
                threading.Thread(target=send).start()
            received += data
            assert time.monotonic() < end, len(received)
            if len(received) >= wanted:
                break
    return received


def test_a_file_that_grows(tmp_path):
    path = tmp_path / "log.csv"
    path.write_bytes(b"first\n")

    def write():
        for k in range(5):
            time.sleep(0.03)
            with path.open("ab") as file:
                file.write(b"%d\n" % k)

    source = open_source(str(path), 0)
    assert source.patient
    assert until(source, 16, write) == b"first\n0\n1\n2\n3\n4\n"


def test_an_idle_source_returns_at_least_twice_a_second(tmp_path, monkeypatch):
    path = tmp_path / "log.csv"
    path.write_bytes(b"first\n")
    pauses = []
    monkeypatch.setattr("fluxobs.live.sources.time.sleep", pauses.append)
    chunks = open_source(str(path), 0).chunks()
    for _ in range(4):
        next(chunks)
    assert len(pauses) == 2
    with closing(open_source(f"udp:{free_port()}", 0).chunks()) as chunks:
        begin = time.monotonic()
        assert next(chunks) == b""
        pauses.append(time.monotonic() - begin)
    assert all(0.001 < pause < 0.5 for pause in pauses)


def test_a_file_that_becomes_shorter_is_refused(tmp_path):
    path = tmp_path / "log.csv"
    path.write_bytes(b"first\n")
    chunks = open_source(str(path), 0).chunks()
    assert next(chunks) == b"first\n"
    path.write_bytes(b"")
    with pytest.raises(FluxobsError, match="became shorter"):
        list(chunks)


def test_a_pipe_ends_when_it_is_closed(tmp_path):
    path = tmp_path / "pipe"
    os.mkfifo(path)
    threading.Thread(target=lambda: path.write_bytes(b"a,b\n" * 50_000)).start()
    assert b"".join(open_source(str(path), 0).chunks()) == b"a,b\n" * 50_000


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


def sender():
    return socket.socket(socket.AF_INET, socket.SOCK_DGRAM)


def test_datagrams():
    port = free_port()
    source = open_source(f"udp:{port}", 0)

    def send():
        with sender() as drive:
            for k in range(100):
                drive.sendto(b"%04d\n" % k, ("127.0.0.1", port))

    assert until(source, 500, send) == b"".join(b"%04d\n" % k for k in range(100))


def test_datagrams_of_another_sender_are_left_out_and_counted(monkeypatch):
    now = [100.0]
    monkeypatch.setattr("fluxobs.live.sources.time.monotonic", lambda: now[0])
    port = free_port()
    source = open_source(f"udp:{port}", 0)
    chunks = source.chunks()
    with sender() as drive, sender() as stray, closing(chunks):

        def received(seconds, *datagrams):
            """Send datagrams (sender, data) `seconds` later; return what the source reads."""
            now[0] += seconds
            for origin, data in datagrams:
                origin.sendto(data, ("127.0.0.1", port))
            return b"".join(next(chunks) for _ in range(4))

        stray.bind(("127.0.0.1", 0))
        assert received(0, (stray, b""), (drive, b"t,u"), (drive, b"0,1")) == b"t,u\n0,1\n"
        assert source.ignored == 0, "an empty datagram has no sender"
        assert received(4, (stray, b"x,y,z"), (drive, b"1,1"), (stray, b"\xf1")) == b"1,1\n"
        assert source.ignored == 2
        # After a silence, another port of the same host counts as the restarted drive.
        assert received(6, (stray, b"0,2"), (drive, b"2,1")) == b"0,2\n"
        assert source.ignored == 3


def test_another_host_never_takes_over(monkeypatch):
    from fluxobs.live.sources import Datagrams

    datagrams = [(b"0,1", ("10.0.0.1", 5)), (b"x", ("10.0.0.2", 5)), (b"1,1", ("10.0.0.1", 6))]
    now = [100.0]
    monkeypatch.setattr("fluxobs.live.sources.time.monotonic", lambda: now[0])
    source = Datagrams("127.0.0.1", free_port())
    with source._socket:
        monkeypatch.setattr(
            source, "_socket", type("", (), {"recvfrom": lambda *_: datagrams.pop(0)})()
        )
        received = []
        while datagrams:
            received.append(source._receive())
            now[0] += 100
    assert received == [b"0,1\n", b"", b"1,1\n"]


@pytest.mark.parametrize(
    ("place", "address"),
    [("", "127.0.0.1"), (":", "127.0.0.1"), ("0.0.0.0:", "0.0.0.0"), ("//127.0.0.2:", "127.0.0.2")],
)
def test_datagrams_come_from_this_computer_unless_an_address_is_given(place, address):
    port = free_port()
    source = open_source(f"udp:{place}{port}", 0)
    with source._socket as opened:
        assert opened.getsockname() == (address, port)


def test_a_datagram_ends_a_line():
    from fluxobs.live.frames import SAMPLES, frame
    from fluxobs.live.sources import _end_line

    assert _end_line(b"1,2") == _end_line(b"1,2\n") == b"1,2\n"
    sample = frame(SAMPLES, 0, b"1234")
    assert _end_line(sample) == sample


def test_a_connection_ends_when_the_other_side_closes_it():
    with socket.create_server(("127.0.0.1", 0)) as server:
        source = open_source(f"socket://127.0.0.1:{server.getsockname()[1]}", 0)
        peer, _ = server.accept()
        threading.Thread(target=lambda: (peer.sendall(b"1,2\n" * 100_000), peer.close())).start()
        began = time.monotonic()
        assert b"".join(source.chunks()) == b"1,2\n" * 100_000
    assert time.monotonic() - began < 5


@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo terminals")
def test_a_serial_port():
    pytest.importorskip("serial")
    import tty

    here, there = os.openpty()
    tty.setraw(here)
    source = open_source(os.ttyname(there), 115200)
    data = bytes(range(256)) * 4
    assert until(source, len(data), lambda: os.write(here, data)) == data
    os.close(here)
    os.close(there)


def test_the_demo_runs_in_real_time():
    began = time.monotonic()
    received = b""
    for data in Demo().chunks():
        received += data
        if received.count(b"\n") > 1500:
            break
    assert 0.25 < time.monotonic() - began < 5  # 0.3 s, and the time to simulate the first cycle


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("nowhere.csv", "no such file or port"),
        (".", "folder"),
        ("udp:99999", "between 1 and 65535"),
        ("udp:a..b:5000", "cannot be opened"),
        ("udp:192.0.2.1:5000", "udp:192.0.2.1:5000: cannot be opened"),
        ("socket://localhost:99999", "between 1 and 65535"),
        ("socket://a..b:5000", "cannot be opened"),
        ("COM77", "cannot be opened"),
        ("socket://localhost:1", "cannot be opened"),
    ],
)
def test_sources_that_cannot_be_opened(text, message):
    pytest.importorskip("serial")
    with pytest.raises(FluxobsError, match=message):
        open_source(text, 115200)


# ---- the server ------------------------------------------------------------------------------


@pytest.fixture
def server():
    pytest.importorskip("websockets")
    from fluxobs.live.serve import Server
    from fluxobs.page import built

    try:
        built("page.html")
    except FluxobsError as error:
        pytest.skip(str(error))
    servers = []

    def make(patient=True, **settings):
        servers.append(Server(0, settings, patient))
        return servers[-1]

    yield make
    for started in servers:
        started.end()


def connected(server, **options):
    from websockets.sync.client import connect

    address = server.url.replace("http", "ws") + "stream"
    options.setdefault("origin", server.url.rstrip("/"))
    return connect(address, compression=None, **options)


def test_the_page_is_served_with_its_settings_and_may_ask_for_the_stream_alone(server):
    site = server(name="</script><b>é")
    with urlopen(site.url) as answer:
        text = answer.read().decode("utf-8")
    host = site.url.removeprefix("http://").rstrip("/")
    assert f"connect-src ws://{host} " in text
    settings = '{"name": "\\u003c/script>\\u003cb>é"}'
    assert f'<script type="application/json" id="live">{settings}</script>' in text


def refusal(site, path, **headers):
    with pytest.raises(HTTPError) as error:
        urlopen(Request(site.url + path, headers=headers))
    error.value.close()
    return error.value.code


def test_other_pages_cannot_read_it(server):
    from websockets.exceptions import InvalidStatus

    site = server()
    assert refusal(site, "", Host="evil.example") == 403  # a name that resolves to 127.0.0.1
    assert refusal(site, "secret") == 404
    for origin in ("http://evil.example", None, "null"):
        with pytest.raises(InvalidStatus, match="403"):
            connected(site, origin=origin)


@pytest.mark.parametrize(
    ("path", "headers", "status"),
    [
        ("/", ["Host: {host}"], 200),
        ("/", [], 400),
        ("/", ["Host: {host}", "Host: {host}"], 400),
        ("/", ["Host: {host}", "Host: evil.example"], 400),
        ("/stream", ["Host: {host}", "Origin: http://{host}", "Origin: http://evil.example"], 400),
        ("/stream", ["Host: {host}"], 403),
    ],
)
def test_malformed_headers(monkeypatch, caplog, path, headers, status):
    pytest.importorskip("websockets")
    from fluxobs.live import serve

    monkeypatch.setattr(serve, "built", lambda name: "<html>")
    site = serve.Server(0, {}, patient=True)
    host = site.url.removeprefix("http://").rstrip("/")
    with socket.create_connection(("localhost", int(host.partition(":")[2]))) as client:
        lines = [f"GET {path} HTTP/1.1", *headers, "", ""]
        client.sendall("\r\n".join(lines).format(host=host).encode())
        answer = client.makefile("rb").read()
    site.end()
    assert answer.startswith(b"HTTP/1.1 %d " % status)
    assert not caplog.records


def test_the_stream_arrives_whole(server):
    site = server()
    pieces = [bytes([k % 256]) * 1000 for k in range(3000)]
    with connected(site) as page:
        assert site.watched.wait(5)
        threading.Thread(target=lambda: [*map(site.send, pieces), site.end()]).start()
        assert b"".join(page) == b"".join(pieces)


@pytest.mark.parametrize(
    ("pieces", "rest"),
    [
        ([b"# rig 3\nt,u\n1,2\n3,"], b"5,6\n"),
        ([b"# rig 3\n", b"t,", b"u\n1,2", b"\n3,"], b"5,6\n"),
        ([b"# rig 3\nt,u\n  1,2\n"], b"4\n5,6\n"),
    ],
)
def test_a_page_that_connects_late_gets_the_names_and_whole_lines(server, pieces, rest):
    site = server()
    for piece in pieces:
        site.send(piece)
    with connected(site) as page:
        time.sleep(0.2)
        site.send(b"4\n5,6\n")
        assert page.recv() == b"# rig 3\nt,u\n"
        assert page.recv() == rest


def test_a_page_too_slow_for_a_port_is_disconnected(server, monkeypatch):
    from fluxobs.live import serve

    monkeypatch.setattr(serve, "_WAITING", 3)
    site = server(patient=False)
    with connected(site, max_queue=1) as page:
        assert site.watched.wait(5)
        for _ in range(3000):
            site.send(b"x" * 100_000)
        received = b"".join(page)
    assert 0 < len(received) < 3000 * 100_000


def test_a_stalled_page_does_not_block_a_patient_stream(server, monkeypatch):
    from fluxobs.live import serve

    monkeypatch.setattr(serve, "_WAITING", 3)
    monkeypatch.setattr(serve, "_PATIENCE", 0.2)
    site = server()
    with connected(site, max_queue=1, close_timeout=1):
        assert site.watched.wait(5)
        began = time.monotonic()
        for _ in range(300):
            site.send(b"x" * 100_000)
        site.end()
        assert time.monotonic() - began < 5


@pytest.mark.parametrize("moves", [False, True])
def test_a_page_is_waited_for_while_it_moves(server, monkeypatch, moves):
    from fluxobs.live import serve

    monkeypatch.setattr(serve, "_PATIENCE", 0.3)
    page = serve._Browser(None, late=False)
    began = time.monotonic()

    def enough():
        page.taken += moves
        return time.monotonic() - began > 0.8

    assert page.moves_on(enough) == moves
    assert 0.3 < time.monotonic() - began < 2.0
