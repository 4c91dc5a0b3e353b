"""Hostile files of recorders (MDF, TDMS, ULog): reading their blocks and counts must end."""

import struct

import numpy as np
import pytest

from fluxobs.logs import read_log
from fluxobs.logs.formats import open_tables
from support.hostile import refused, zeros
from support.records import SMALL_LOG as COLUMNS

T = COLUMNS["t"]


def test_counts_beyond_the_contents_of_a_tdms_file(tmp_path):
    nptdms = pytest.importorskip("nptdms")
    with nptdms.TdmsWriter(tmp_path / "log.tdms") as file:
        file.write_segment([nptdms.ChannelObject("g", k, v) for k, v in COLUMNS.items()])
    content = (tmp_path / "log.tdms").read_bytes()
    content = content.replace(struct.pack("<Q", 200), struct.pack("<Q", 1 << 50))
    (tmp_path / "log.tdms").write_bytes(content)
    refused(tmp_path / "log.tdms", "log.tdms: reading failed midway")


def mdf(path, version="4.10"):
    """Write an MDF file with the channels; tests find the file's blocks by their names."""
    asammdf = pytest.importorskip("asammdf")
    with asammdf.MDF(version=version) as file:
        file.append([asammdf.Signal(v, T, name=k) for k, v in COLUMNS.items() if k != "t"])
        return file.save(path)


@pytest.mark.parametrize("sorted_", [True, False])
def test_a_block_of_mdf_that_unpacks_to_more_than_it_has(tmp_path, sorted_):
    path = mdf(tmp_path / "log.mf4")
    content = path.read_bytes()
    content += bytes(-len(content) % 8)
    packed = zeros(300)
    header = struct.pack("<2s2BI2Q", b"DT", 0, 0, 0, 40 * len(T), len(packed))
    block = struct.pack("<4s4x2Q", b"##DZ", 24 + len(header + packed), 0) + header + packed
    with_links(path, content + block, {(b"##DG", 0, 2): len(content)})
    if not sorted_:
        with path.open("r+b") as file:
            file.seek(content.index(b"##DG") + 24 + 8 * 4)
            file.write(b"\x01")
    refused(path, "a block of data unpacks to more than the 8000 bytes")


def test_rows_beyond_the_contents_of_an_mdf_file(tmp_path):
    path = mdf(tmp_path / "log.mf4")
    content = bytearray(path.read_bytes())
    at = content.index(b"##CG")
    struct.pack_into("<Q", content, at + 24 + 8 * content[at + 16] + 8, 1 << 50)
    path.write_bytes(content)
    refused(path, "its rows have 45035996273704960 bytes, more than 268435456")


def conversion(*links):
    """Return an MDF 4 conversion that refers to the blocks `links` for value 0 and as default."""
    body = struct.pack(f"<{4 + len(links)}Q", 0, 0, 0, 0, *links)
    values = struct.pack("<2B3H3d", 7, 0, 0, len(links), 1, 0, 0, 0)
    return struct.pack("<4s4x2Q", b"##CC", 24 + len(body + values), 4 + len(links)) + body + values


def with_links(path, content, places):
    """Replace links of an MDF file: `places` is (kind of block, block, link) → address."""
    content = bytearray(content)
    for (kind, number, link), address in places.items():
        at = -1
        for _ in range(number + 1):
            at = content.index(kind, at + 1)
        struct.pack_into("<Q", content, at + 24 + 8 * link, address)
    path.write_bytes(content)


@pytest.mark.parametrize(
    ("depth", "message"), [(30, "conversions need more than 256 MB"), (5, None), (0, "circle")]
)
def test_conversions_that_refer_to_others_twice(tmp_path, depth, message):
    path = mdf(tmp_path / "log.mf4")
    content = path.read_bytes()
    content += bytes(-len(content) % 8)
    first = len(content)
    blocks = [conversion(0, 0)] if depth else [conversion(first, first)]
    for _ in range(depth):
        last = first + sum(map(len, blocks[:-1]))
        blocks.append(conversion(last, last))
    address = first + sum(map(len, blocks[:-1]))
    with_links(path, content + b"".join(blocks), {(b"##CN", 1, 4): address})
    if message:
        refused(path, message)
    else:
        open_tables(path)


def test_a_long_text_that_many_conversions_use(tmp_path):
    path = mdf(tmp_path / "log.mf4")
    content = path.read_bytes()
    content += bytes(-len(content) % 8)
    text = struct.pack("<4s4x2Q", b"##TX", 24 + (1 << 20), 0) + b"x" * (1 << 20)
    block = conversion(*[len(content)] * 1000)
    places = {(b"##CN", 1, 4): len(content + text)}
    with_links(path, content + text + block, places)
    refused(path, "its texts and conversions need more than 257 MB")


@pytest.mark.parametrize("kind", [b"##CN", b"##CG", b"##DG", b"##FH"])
def test_blocks_in_a_circle(tmp_path, kind):
    path = mdf(tmp_path / "log.mf4")
    content = path.read_bytes()
    with_links(path, content, {(kind, 0, 0): content.index(kind)})
    refused(path, "refer to one another in a circle")


@pytest.mark.parametrize("version", ["4.00", "4.20"])
@pytest.mark.parametrize("compression", [0, 2])
def test_all_kinds_of_nested_blocks_are_followed(tmp_path, version, compression):
    """A file with texts, conversions to texts, structures and arrays is not refused as circular."""
    asammdf = pytest.importorskip("asammdf")
    columns = [
        asammdf.Signal(
            np.array([b"x" * (n % 9) for n in range(len(T))]), T, name="notes", encoding="utf-8"
        ),
        asammdf.Signal(
            np.zeros(len(T), "u1"),
            T,
            name="mode",
            conversion={"val_0": 0, "text_0": b"off", "default": b"on"},
        ),
        asammdf.Signal(np.rec.fromarrays([T, T], names=["p", "q"]), T, name="pair"),
        asammdf.Signal(np.rec.fromarrays([np.ones((len(T), 3, 2))], names=["map"]), T, name="map"),
    ]
    with asammdf.MDF(version=version) as file:
        file.append([asammdf.Signal(v, T, name=k) for k, v in COLUMNS.items() if k != "t"])
        for signal in columns:
            file.append([signal])
        path = file.save(tmp_path / "log.mf4", compression=compression)
    assert len(read_log(path)) == len(T)


def test_the_values_of_texts_in_a_circle(tmp_path):
    path = mdf(tmp_path / "log.mf4")
    content = path.read_bytes()
    content += bytes(-len(content) % 8)
    block = struct.pack("<4s4x3QB3xIQ", b"##DL", 48, 1, len(content), 1, 0, 0)
    for channels in (1, 2):  # two channels may share one list
        places = {(b"##CN", n, 5): len(content) for n in range(channels)}
        with_links(path, content + block, places)
        refused(path, "refer to one another in a circle")


def test_channels_in_a_circle_in_an_old_mdf_file(tmp_path):
    path = mdf(tmp_path / "log.mdf", "3.30")
    content = bytearray(path.read_bytes())
    (group,) = struct.unpack_from("<I", content, 64 + 4)
    (first,) = struct.unpack_from("<I", content, group + 8)
    (channel,) = struct.unpack_from("<I", content, first + 8)
    struct.pack_into("<I", content, channel + 4, channel)
    path.write_bytes(content)
    refused(path, "refer to one another in a circle")


def test_a_text_that_many_ranges_use_in_an_old_mdf_file(tmp_path):
    path = mdf(tmp_path / "log.mdf", "3.30")
    content = bytearray(path.read_bytes())
    (group,) = struct.unpack_from("<I", content, 64 + 4)
    (first,) = struct.unpack_from("<I", content, group + 8)
    (channel,) = struct.unpack_from("<I", content, first + 8)
    struct.pack_into("<I", content, channel + 8, len(content))
    count = 60_000
    text = struct.pack("<2dI", 0, 0, len(content) + 46 + 20 * count)
    head = struct.pack("<2s2H2d20s2H", b"CC", 0xFFFF, 0, 0, 0, b"", 12, count)
    content += head + text * count + struct.pack("<2sH", b"TX", 0xFFFF) + b"x" * 0xFFFB
    path.write_bytes(content)
    refused(path, "its texts and conversions need more than 257 MB")


@pytest.mark.parametrize(
    "types",
    [
        ["a:b[60000] x;", "b:c[60000] x;", "c:float x;"],
        ["a:" + "float[60000] x;" * 4000],
        ["a:a x;"],
    ],
)
def test_fields_of_fields_in_a_flight_log(tmp_path, types):
    pytest.importorskip("pyulog")
    content = b"ULog\x01\x12\x35\x01" + bytes(8)
    for kind, body in [*((b"F", definition.encode()) for definition in types), (b"A", b"\0\0\0a")]:
        content += struct.pack("<H", len(body)) + kind + body
    (tmp_path / "log.ulg").write_bytes(content)
    refused(tmp_path / "log.ulg", "its topics have more than 262144 fields|levels deep")
