"""Where a stream comes from, and where it goes to."""

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
    """What a source brings, until `wanted` bytes have come; `send` is called once it listens."""
    got = b""
    end = time.monotonic() + 20
    with closing(source.chunks()) as chunks:
        for n, data in enumerate(chunks):
            if n == 0 and send is not None:
                threading.Thread(target=send).start()
            got += data
            assert time.monotonic() < end, len(got)
            if len(got) >= wanted:
                break
    return got


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


def test_nothing_new_is_asked_for_at_least_ten_times_a_second(tmp_path, monkeypatch):
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
        with sender() as out:
            for k in range(100):
                out.sendto(b"%04d\n" % k, ("127.0.0.1", port))

    assert until(source, 500, send) == b"".join(b"%04d\n" % k for k in range(100))


def test_datagrams_of_another_sender_are_left_out_and_counted(monkeypatch):
    now = [100.0]
    monkeypatch.setattr("fluxobs.live.sources.time.monotonic", lambda: now[0])
    port = free_port()
    source = open_source(f"udp:{port}", 0)
    chunks = source.chunks()
    with sender() as drive, sender() as stray, closing(chunks):

        def taken(seconds, *datagrams):
            """What is taken of datagrams of an address each; the last is one of the drive's."""
            now[0] += seconds
            for out, data in datagrams:
                out.sendto(data, ("127.0.0.1", port))
            return b"".join(next(chunks) for _ in range(4))

        stray.bind(("127.0.0.1", 0))
        assert taken(0, (stray, b""), (drive, b"t,u"), (drive, b"0,1")) == b"t,u\n0,1\n"
        assert source.ignored == 0, "an empty datagram is of nobody"
        assert taken(4, (stray, b"x,y,z"), (drive, b"1,1"), (stray, b"\xf1")) == b"1,1\n"
        assert source.ignored == 2
        # The drive is silent: another port of the same host is the drive that started again.
        assert taken(6, (stray, b"0,2"), (drive, b"2,1")) == b"0,2\n"
        assert source.ignored == 3


def test_another_host_never_takes_over(monkeypatch):
    from fluxobs.live.sources import Datagrams

    come = [(b"0,1", ("10.0.0.1", 5)), (b"x", ("10.0.0.2", 5)), (b"1,1", ("10.0.0.1", 6))]
    now = [100.0]
    monkeypatch.setattr("fluxobs.live.sources.time.monotonic", lambda: now[0])
    source = Datagrams("127.0.0.1", free_port())
    with source._socket:
        monkeypatch.setattr(source, "_socket", type("", (), {"recvfrom": lambda *_: come.pop(0)})())
        got = []
        while come:
            got.append(source._received())
            now[0] += 100
    assert got == [b"0,1\n", b"", b"1,1\n"]


@pytest.mark.parametrize(
    ("place", "address"),
    [("", "127.0.0.1"), (":", "127.0.0.1"), ("0.0.0.0:", "0.0.0.0"), ("//127.0.0.2:", "127.0.0.2")],
)
def test_datagrams_come_from_this_computer_unless_an_address_is_given(place, address):
    port = free_port()
    source = open_source(f"udp:{place}{port}", 0)
    with source._socket as own:
        assert own.getsockname() == (address, port)


def test_a_datagram_ends_a_line():
    from fluxobs.live.frames import SAMPLES, frame
    from fluxobs.live.sources import _ended

    assert _ended(b"1,2") == _ended(b"1,2\n") == b"1,2\n"
    sample = frame(SAMPLES, 0, b"1234")
    assert _ended(sample) == sample


def test_a_connection_ends_when_the_other_side_closes_it():
    with socket.create_server(("127.0.0.1", 0)) as server:
        source = open_source(f"socket://127.0.0.1:{server.getsockname()[1]}", 0)
        there, _ = server.accept()
        threading.Thread(target=lambda: (there.sendall(b"1,2\n" * 100_000), there.close())).start()
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
    got = b""
    for data in Demo().chunks():
        got += data
        if got.count(b"\n") > 1500:
            break
    assert 0.25 < time.monotonic() - began < 5  # 0.3 s, and the time to make the first cycle


@pytest.mark.parametrize(
    ("text", "words"),
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
def test_what_is_not_there(text, words):
    pytest.importorskip("serial")
    with pytest.raises(FluxobsError, match=words):
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
    made = []

    def make(patient=True, **settings):
        made.append(Server(0, settings, patient))
        return made[-1]

    yield make
    for one in made:
        one.end()


def connected(server, **options):
    from websockets.sync.client import connect

    address = server.url.replace("http", "ws") + "stream"
    options.setdefault("origin", server.url.rstrip("/"))
    return connect(address, compression=None, **options)


def test_the_page_is_served_with_its_settings_and_may_ask_for_the_stream_alone(server):
    one = server(name="</script><b>é")
    with urlopen(one.url) as answer:
        text = answer.read().decode("utf-8")
    host = one.url.removeprefix("http://").rstrip("/")
    assert f"connect-src ws://{host} " in text
    settings = '{"name": "\\u003c/script>\\u003cb>é"}'
    assert f'<script type="application/json" id="live">{settings}</script>' in text


def refused(one, path, **headers):
    with pytest.raises(HTTPError) as error:
        urlopen(Request(one.url + path, headers=headers))
    error.value.close()
    return error.value.code


def test_other_pages_cannot_read_it(server):
    from websockets.exceptions import InvalidStatus

    one = server()
    assert refused(one, "", Host="evil.example") == 403  # a name that was turned to 127.0.0.1
    assert refused(one, "secret") == 404
    for origin in ("http://evil.example", None, "null"):
        with pytest.raises(InvalidStatus, match="403"):
            connected(one, origin=origin)


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
def test_headers_that_no_browser_sends(monkeypatch, caplog, path, headers, status):
    pytest.importorskip("websockets")
    from fluxobs.live import serve

    monkeypatch.setattr(serve, "built", lambda name: "<html>")
    one = serve.Server(0, {}, patient=True)
    host = one.url.removeprefix("http://").rstrip("/")
    with socket.create_connection(("localhost", int(host.partition(":")[2]))) as client:
        lines = [f"GET {path} HTTP/1.1", *headers, "", ""]
        client.sendall("\r\n".join(lines).format(host=host).encode())
        answer = client.makefile("rb").read()
    one.end()
    assert answer.startswith(b"HTTP/1.1 %d " % status)
    assert not caplog.records


def test_the_stream_arrives_whole(server):
    one = server()
    pieces = [bytes([k % 256]) * 1000 for k in range(3000)]
    with connected(one) as page:
        assert one.watched.wait(5)
        threading.Thread(target=lambda: [*map(one.send, pieces), one.end()]).start()
        assert b"".join(page) == b"".join(pieces)


@pytest.mark.parametrize(
    ("pieces", "rest"),
    [
        ([b"# rig 3\nt,u\n1,2\n3,"], b"5,6\n"),
        ([b"# rig 3\n", b"t,", b"u\n1,2", b"\n3,"], b"5,6\n"),
        ([b"# rig 3\nt,u\n  1,2\n"], b"4\n5,6\n"),
    ],
)
def test_a_page_that_comes_late_gets_the_names_and_whole_lines(server, pieces, rest):
    one = server()
    for piece in pieces:
        one.send(piece)
    with connected(one) as page:
        time.sleep(0.2)
        one.send(b"4\n5,6\n")
        assert page.recv() == b"# rig 3\nt,u\n"
        assert page.recv() == rest


def test_a_page_that_is_too_slow_is_let_go_of_a_port(server, monkeypatch):
    from fluxobs.live import serve

    monkeypatch.setattr(serve, "_WAITING", 3)
    one = server(patient=False)
    with connected(one, max_queue=1) as page:
        assert one.watched.wait(5)
        for _ in range(3000):
            one.send(b"x" * 100_000)
        got = b"".join(page)
    assert 0 < len(got) < 3000 * 100_000


def test_a_page_that_stands_still_does_not_hold_up_a_stream_that_waits(server, monkeypatch):
    from fluxobs.live import serve

    monkeypatch.setattr(serve, "_WAITING", 3)
    monkeypatch.setattr(serve, "_PATIENCE", 0.2)
    one = server()
    with connected(one, max_queue=1, close_timeout=1):
        assert one.watched.wait(5)
        began = time.monotonic()
        for _ in range(300):
            one.send(b"x" * 100_000)
        one.end()
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
