"""Hostile logs: none reads other files, ends the program, blocks it, or fills the memory."""

import contextlib
import gzip
import io
import struct
import sys
import time
import tracemalloc
import zipfile
import zlib

import numpy as np
import polars as pl
import pytest

from fluxobs import FluxobsError
from fluxobs.logs import read_log
from fluxobs.logs.formats import open_tables
from fluxobs.logs.formats.apart import read_apart
from fluxobs.logs.formats.excel import read_sheets
from support.biff import old_workbook
from support.records import SMALL_LOG as COLUMNS

T = COLUMNS["t"]
MEGABYTE = bytes(1 << 20)


def refused(path, words, **options):
    with pytest.raises(FluxobsError, match=words) as error:
        list(read_log(path, **options).aligned())
    assert path.name in str(error.value)
    assert len(str(error.value)) < 1000


@pytest.fixture(params=["log.h5", "log.mat"])
def hdf5(request, tmp_path):
    """An HDF5 file, and one of MATLAB 7.3, that lack a column."""
    h5py = pytest.importorskip("h5py")
    matlab = request.param.endswith(".mat")
    with h5py.File(tmp_path / request.param, "w", userblock_size=512 * matlab) as file:
        for name, values in COLUMNS.items():
            if name != "i_beta":
                file[name] = values
    if matlab:
        head = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"
        with open(tmp_path / request.param, "r+b") as file:
            file.write(head)
    return tmp_path / request.param


def test_a_dataset_in_another_file(hdf5, tmp_path):
    import h5py

    (tmp_path / "secret").write_bytes(b"secret" * 300)
    with h5py.File(hdf5, "a") as file:
        file.create_dataset("i_beta", (200,), "f8", external=[(tmp_path / "secret", 0, 1600)])
    refused(hdf5, "i_beta are kept in other files")


def test_a_virtual_dataset(hdf5, tmp_path):
    import h5py

    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["x"] = COLUMNS["i_beta"]
    layout = h5py.VirtualLayout((200,), "f8")
    layout[:] = h5py.VirtualSource(tmp_path / "other.h5", "x", (200,))
    with h5py.File(hdf5, "a") as file:
        file.create_virtual_dataset("i_beta", layout)
    refused(hdf5, "i_beta are kept in other files")


def test_a_dataset_whose_name_is_no_text(hdf5):
    import h5py

    with h5py.File(hdf5, "a") as file:
        file["i_beta"] = COLUMNS["i_beta"]
        file[b"x\xff\xfe"] = T
    assert len(read_log(hdf5)) == len(T)


def with_chunks(path, chunk, packed=None, rows=None, **options):
    """The HDF5 file with i_beta in chunks of so many rows, the first of them these bytes."""
    import h5py

    with h5py.File(path, "a") as file:
        rows = len(T) if rows is None else rows
        data = file.create_dataset("i_beta", (rows,), "f8", chunks=(chunk,), **options)
        if packed is None:
            data[: len(T)] = COLUMNS["i_beta"]
        else:
            data.id.write_direct_chunk((0,), packed)


def zeros(megabytes):
    packer = zlib.compressobj(1)
    return b"".join(packer.compress(MEGABYTE) for _ in range(megabytes)) + packer.flush()


def test_a_chunk_that_unpacks_to_more_than_it_has(hdf5):
    with_chunks(hdf5, 200, zeros(300), compression="gzip")
    refused(hdf5, "a chunk of /i_beta unpacks to more than the 1600 bytes")


def test_a_chunk_that_memory_does_not_hold(hdf5, monkeypatch):
    monkeypatch.setattr("fluxobs.logs.formats.hdf5.BLOCK", 1000)
    with_chunks(hdf5, 200, compression="gzip")
    refused(hdf5, "/i_beta has chunks of 1600 bytes")


def test_a_dataset_that_is_compressed_twice(hdf5):
    h5py = pytest.importorskip("h5py")
    twice = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    twice.set_chunk((len(T),))
    twice.set_deflate(9)
    twice.set_deflate(9)
    with h5py.File(hdf5, "a") as file:
        space = h5py.h5s.create_simple((len(T),))
        h5py.h5d.create(file.id, b"i_beta", h5py.h5t.IEEE_F64LE, space, twice)
        file["i_beta"][:] = COLUMNS["i_beta"]
    refused(hdf5, "/i_beta is compressed twice")


def test_rows_that_no_file_holds(hdf5):
    with_chunks(hdf5, 1000, rows=1 << 40)
    (table,) = [one for one in open_tables(hdf5) if "i_beta" in one.columns]
    with pytest.raises(FluxobsError, match="i_beta unpacks to 8796093022208 bytes"):
        list(table.batches(["i_beta"], 0, 10))


def test_a_large_chunk_is_unpacked_once(tmp_path):
    h5py = pytest.importorskip("h5py")
    rows = 1 << 21
    values = np.sin(np.arange(rows))
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file.create_dataset("x", data=values, chunks=(rows,), compression="gzip")
    (table,) = open_tables(tmp_path / "log.h5")
    before = time.process_time()
    parts = list(table.batches(["x"], 0, rows, 10_000))
    assert time.process_time() - before < 2  # once for each of 200 batches it is 20
    np.testing.assert_array_equal(np.concatenate([part["x"] for part in parts]), values)


def workbook(path, far=None, blank=False):
    xlsxwriter = pytest.importorskip("xlsxwriter")
    pytest.importorskip("fastexcel")
    with xlsxwriter.Workbook(path) as book:
        sheet = book.add_worksheet()
        for n, (name, values) in enumerate(COLUMNS.items()):
            sheet.write(0, n, name)
            sheet.write_column(1, n, values)
        if far and blank:
            sheet.write_blank(*far, None, book.add_format({"bold": True}))
        elif far:
            sheet.write(*far, 1.0)
    return path


def test_a_cell_far_from_the_table(tmp_path):
    refused(workbook(tmp_path / "log.xlsx", (99_999, 9_999)), "1000000000 cells up to the last")


def test_a_blank_cell_far_from_the_table_is_left_alone(tmp_path):
    path = workbook(tmp_path / "log.xlsx", (99_999, 9_999), blank=True)
    assert len(read_log(path)) == len(T)


def edited(path, change, texts=bytes):
    """A workbook whose first sheet is changed, and lies where no sheet is looked for; the texts of
    its cells may be changed too."""
    with zipfile.ZipFile(path) as book:
        parts = {name: book.read(name) for name in book.namelist()}
    sheet = change(parts.pop("xl/worksheets/sheet1.xml"))
    links = parts["xl/_rels/workbook.xml.rels"]
    parts["xl/sharedStrings.xml"] = texts(parts["xl/sharedStrings.xml"])
    parts["xl/_rels/workbook.xml.rels"] = links.replace(b"worksheets/sheet1.xml", b"image.png")
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as book:
        for name, content in {**parts, "xl/image.png": sheet}.items():
            book.writestr(name, content)


def test_far_cells_without_references(tmp_path):
    path = workbook(tmp_path / "log.xlsx")
    wide = b"<row>" + b"<c><v>1</v></c>" * 20_000 + b"</row>"
    long = b"<row><c><v>1</v></c></row>" * 2_000
    edited(path, lambda sheet: sheet.replace(b"</sheetData>", wide + long + b"</sheetData>"))
    refused(path, "cells up to the last")


def test_a_workbook_that_is_large_when_unpacked(tmp_path, monkeypatch):
    monkeypatch.setattr("fluxobs.logs.formats.workbook.BYTES", 1 << 20)
    path = workbook(tmp_path / "log.xlsx")
    value = b'<row><c t="str"><v>' + b"1" * (1 << 20) + b"</v></c></row></sheetData>"
    edited(path, lambda sheet: sheet.replace(b"</sheetData>", value))
    refused(path, "bytes, more than 1048576")


limited = pytest.mark.skipif(sys.platform != "linux", reason="only Linux limits memory")


@limited
def test_a_long_text_that_many_cells_share(tmp_path):
    path = workbook(tmp_path / "log.xlsx")
    cells = b"<row>" + b'<c t="s"><v>0</v></c>' * 5 + b"</row>"
    edited(
        path,
        lambda sheet: sheet.replace(b"</sheetData>", cells * 1000 + b"</sheetData>"),
        lambda texts: texts.replace(b">t<", b">" + b"t" * 1_000_000 + b"<"),
    )
    assert path.stat().st_size < 30_000
    refused(path, "reading it ended with .* more than 10.. MB of memory")


@limited
def test_cells_far_apart_in_an_old_workbook(tmp_path):
    pytest.importorskip("fastexcel")
    content = old_workbook(40, [(0, 0, 1.0), (65535, 255, 1.0)])
    (tmp_path / "log.xls").write_bytes(content)
    assert len(content) < 6_000
    refused(tmp_path / "log.xls", "reading it ended with .* more than 1024 MB of memory")


def test_a_workbook_that_takes_too_long(tmp_path):
    path = workbook(tmp_path / "log.xlsx")
    with pytest.raises(FluxobsError, match=r"log\.xlsx: reading it took more than 0.01 s"):
        read_apart(read_sheets, path, None, 1 << 30, 0.01)


def test_entities_in_a_workbook(tmp_path):
    path = workbook(tmp_path / "log.xlsx")
    head = b'?><!DOCTYPE x [<!ENTITY a "1">]>'
    edited(path, lambda sheet: sheet.replace(b"?>", head, 1))
    refused(path, "not a readable workbook: a sheet has no document type")


@pytest.mark.parametrize("cells", [(1 << 40, 1), (1, 1 << 40)])
def test_repeated_cells_of_an_open_document(tmp_path, cells):
    pytest.importorskip("fastexcel")
    rows, columns = cells
    with zipfile.ZipFile(tmp_path / "log.ods", "w") as book:
        book.writestr(
            "content.xml",
            f'<x><table:table><table:table-row table:number-rows-repeated="{rows}">'
            f'<table:table-cell office:value="1" table:number-columns-repeated="{columns}"/>'
            f"</table:table-row></table:table></x>",
        )
    refused(tmp_path / "log.ods", "1099511627776 cells up to the last")


def nested_cells(depth):
    """A MATLAB array of cells within each other, as in a file."""
    head = struct.pack("<2I", 6, 8), struct.pack("<6I", 5, 8, 1, 1, 1, 0)
    inner = head[0] + struct.pack("<2I", 6, 0) + head[1] + struct.pack("<2I2d", 9, 8, 1.0, 0)[:16]
    for _ in range(depth):
        inner = struct.pack("<2I", 14, len(inner)) + inner
        inner = head[0] + struct.pack("<2I", 1, 0) + head[1] + inner
    return struct.pack("<2I", 14, len(inner)) + inner


@pytest.mark.parametrize("packed", [False, True])
def test_deeply_nested_cells_of_matlab(tmp_path, packed):
    matlab = pytest.importorskip("scipy.io")
    for name, depth in (("flat.mat", 100), ("deep.mat", 1000)):
        matlab.savemat(tmp_path / name, COLUMNS, do_compression=packed)
        element = nested_cells(depth)
        if packed:
            element = zlib.compress(element)
            element = struct.pack("<2I", 15, len(element)) + element
        with open(tmp_path / name, "ab") as file:
            file.write(element)
    assert len(read_log(tmp_path / "flat.mat")) == len(T)
    refused(tmp_path / "deep.mat", "nested more than 200 times")


@pytest.mark.parametrize("packed", [False, True])
def test_all_that_matlab_nests_is_followed(tmp_path, packed):
    """Structs, cells, texts, complex and sparse matrices; the depth of none is mistaken."""
    matlab = pytest.importorskip("scipy.io")
    sparse = pytest.importorskip("scipy.sparse")
    cells = np.empty((2, 3), dtype=object)
    cells[:] = [["text", np.eye(3), {"a": 1.0, "name": "x"}], [1j, sparse.eye(4), np.zeros(0)]]
    notes = {"cells": cells, "struct": {"deeper": {"cells": cells, "empty": {}}}}
    matlab.savemat(tmp_path / "log.mat", {"notes": notes, **COLUMNS}, do_compression=packed)
    assert len(read_log(tmp_path / "log.mat")) == len(T)


def element(kind, content):
    return struct.pack("<2I", kind, len(content)) + content + bytes(-len(content) % 8)


def array_head(kind, *sizes):
    """The head of an array of a MATLAB file."""
    shape = element(5, struct.pack("<2I", *sizes))
    return element(6, struct.pack("<2I", kind, 0)) + shape + element(1, b"notes")


def packed_array(path, head, content, times=1):
    """A MATLAB file with the channels, and a packed array whose content is so many times this."""
    matlab = pytest.importorskip("scipy.io")
    matlab.savemat(path, COLUMNS)
    packer = zlib.compressobj(1)
    body = [struct.pack("<2I", 14, len(head) + len(content) * times) + head]
    packed = b"".join(packer.compress(one) for one in [*body, *[content] * times])
    with path.open("ab") as file:
        file.write(element(15, packed + packer.flush()))
    assert path.stat().st_size < 2 << 20
    return path


EMPTY = struct.pack("<2I", 14, 0)
NO_FIELDS = element(5, struct.pack("<I", 8)) + element(1, b"")


@pytest.mark.parametrize(
    ("head", "content", "times"),
    [
        (array_head(6, 1 << 25, 1) + struct.pack("<2I", 9, 1 << 28), MEGABYTE, 256),
        (array_head(4, 1, 1 << 25) + struct.pack("<2I", 16, 1 << 25), MEGABYTE, 32),
        (array_head(6 | 0x800, 1, 1 << 24), element(2, MEGABYTE * 16), 2),
        (array_head(1, 1, 1 << 18), EMPTY * (1 << 10), 1 << 8),
        (array_head(2, 1 << 16, 1 << 16), NO_FIELDS, 1),
    ],
    ids=["numbers", "text", "complex", "cells", "structs"],
)
def test_a_small_matlab_file_that_is_large_in_memory(tmp_path, head, content, times):
    path = packed_array(tmp_path / "log.mat", head, content, times)
    refused(path, "it unpacks to more than 256 MB")


HEAD = "t,u_alpha,u_beta,i_alpha,i_beta\n"
ROWS = "".join(f"{n * 1e-3:.3f},1,2,3,4\n" for n in range(300))


@pytest.mark.parametrize(
    "above",
    [
        HEAD.replace("u_beta", "(" * 100_000),
        HEAD.replace("u_beta", "[" * 100_000),
        "Sample Interval,1" + " " * 100_000 + "!\n" + HEAD,
        "Sample Interval" + "(" * 100_000 + ",1 ms\n" + HEAD,
        "a" + " " * 100_000 + "b\n" + HEAD,
        HEAD + "1" * 100_000 + "x,1,2,3,4\n",
    ],
)
def test_text_is_looked_at_in_a_time_that_grows_with_its_length(tmp_path, above):
    (tmp_path / "log.csv").write_text(above + ROWS)
    before = time.process_time()
    with contextlib.suppress(FluxobsError):
        read_log(tmp_path / "log.csv")
    assert time.process_time() - before < 3  # it was a minute


def test_a_log_of_too_many_columns(tmp_path):
    names = ",".join(f"c{n}" for n in range(50_000))
    (tmp_path / "log.csv").write_text(names + ("\n" + ",".join(["1"] * 50_000)) * 3)
    refused(tmp_path / "log.csv", "a row has 50000 cells, more than 10000")


def test_many_columns_of_one_name_are_numbered(tmp_path):
    names = ",".join(["x"] * 9_000)
    (tmp_path / "log.csv").write_text(names + ("\n" + ",".join(["1"] * 9_000)) * 3)
    (table,) = open_tables(tmp_path / "log.csv")
    assert table.columns[-1] == "x (column 9000)"


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("at", [0, 100, len(ROWS)])
def test_a_line_without_end(tmp_path, encoding, packed, at):
    text = (HEAD + ROWS[:at] + "1" * (9 << 20) + "\n" + ROWS[at:]).encode(encoding)
    path = tmp_path / ("log.csv.gz" if packed else "log.csv")
    path.write_bytes(gzip.compress(text, 1) if packed else text)
    refused(path, "more than 1048576 characters|no header|is not a number")


def packed_rows(path, row, megabytes):
    """A compressed log of one row many times, of so many unpacked megabytes."""
    block = gzip.compress(row * ((1 << 20) // len(row)))
    path.write_bytes(gzip.compress((HEAD + ROWS).encode()) + block * megabytes)
    return path


def test_a_small_file_that_unpacks_to_a_gigabyte(tmp_path):
    path = packed_rows(tmp_path / "log.csv.gz", b"0,1,2,3,4\n", 1024)
    refused(path, "unpacks to more than 4........ bytes, and to more than 200 times its size")


def test_short_rows_are_read_in_little_memory(tmp_path):
    (table,) = open_tables(packed_rows(tmp_path / "log.csv.gz", b"0,1,2,3,4\n", 80))
    tracemalloc.start()
    rows = sum(len(part["t"]) for part in table.batches(table.columns, 0, table.rows))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert rows == table.rows > 8_000_000
    assert peak < 100 << 20  # kept as numbers they are 335 MB, and were 670


def test_lines_without_rows_are_not_kept_in_memory(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(HEAD + ROWS + "\n" * 500_000 + ROWS)
    tracemalloc.start()
    (table,) = open_tables(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 10 << 20  # a number for each of them are 20 MB
    assert table.place(299) == "line 301"
    assert table.place(300) == "line 500302"


@pytest.mark.parametrize("ending", ["npy", "npz"])
@pytest.mark.parametrize("kind", [[("a", float), ("b", float)], (float, 3), complex, "V8", "S5"])
def test_a_field_that_is_no_number_is_no_column(tmp_path, ending, kind):
    rows = np.zeros(200, [*((name, float) for name in COLUMNS), ("note", kind)])
    for name, values in COLUMNS.items():
        rows[name] = values
    path = tmp_path / f"log.{ending}"
    np.save(path, rows) if ending == "npy" else np.savez(path, log=rows)
    (table,) = open_tables(path)
    assert [name.removeprefix("log/") for name in table.columns] == list(COLUMNS)


def test_a_member_that_nobody_asks_for_is_not_unpacked(tmp_path):
    np.savez_compressed(tmp_path / "log.npz", **COLUMNS)
    head = io.BytesIO()
    fields = {"descr": "<f8", "fortran_order": False, "shape": (1 << 29,)}
    np.lib.format.write_array_header_1_0(head, fields)
    with zipfile.ZipFile(tmp_path / "log.npz", "a") as archive:
        archive.writestr("notes.npy", head.getvalue())
    log = read_log(tmp_path / "log.npz")
    assert len(log) == len(T)
    (table,) = [one for one in open_tables(tmp_path / "log.npz") if "notes" in one.columns]
    with pytest.raises(FluxobsError, match=r"log\.npz: reading failed midway: "):
        list(table.batches(["notes"], 0, 10))


@pytest.mark.filterwarnings("ignore:Stored array in format 3.0")
def test_fields_with_names_in_other_scripts(tmp_path):
    np.savez(tmp_path / "log.npz", **COLUMNS, notes=np.zeros(200, [("Ω", float)]))
    assert any("notes/Ω" in one.columns for one in open_tables(tmp_path / "log.npz"))


def test_an_array_larger_than_memory(tmp_path):
    head = io.BytesIO()
    fields = {"descr": "<f8", "fortran_order": False, "shape": (1 << 50,)}
    np.lib.format.write_array_header_1_0(head, fields)
    with zipfile.ZipFile(tmp_path / "log.npz", "w") as archive:
        archive.writestr("t.npy", head.getvalue())
    refused(tmp_path / "log.npz", "is larger than memory may be")


@pytest.mark.parametrize("name", ["log.parquet", "log.arrow"])
def test_columns_that_unpack_to_far_more_than_their_file(tmp_path, name):
    write = "write_parquet" if name.endswith("parquet") else "write_ipc"
    rows = 7 << 20
    frame = pl.DataFrame({name: np.zeros(rows, np.float32) for name in COLUMNS})
    getattr(frame, write)(tmp_path / name, compression="zstd")
    assert (tmp_path / name).stat().st_size < 1 << 18
    (table,) = open_tables(tmp_path / name)
    with pytest.raises(FluxobsError, match=rf"{name}: columns .* unpack to 29.* bytes"):
        list(table.batches(table.columns, 0, rows))
    assert len(next(table.batches(["t"], 0, rows))["t"])  # it fits
    frame = frame.select(pl.from_epoch(pl.col(name).cast(pl.Int64)) for name in COLUMNS)
    getattr(frame, write)(tmp_path / name, compression="zstd")
    refused(tmp_path / name, "columns .* unpack to 29.* bytes")


def test_a_large_compressed_batch_is_unpacked_once(tmp_path):
    rows = 1 << 21
    frame = pl.DataFrame({"t": np.arange(rows) * 1e-4, "x": np.sin(np.arange(rows))})
    frame.write_ipc(tmp_path / "log.arrow", compression="zstd", record_batch_size=rows)
    (table,) = open_tables(tmp_path / "log.arrow")
    before = time.process_time()
    parts = list(table.batches(["t", "x"], 0, rows, 10_000))
    assert time.process_time() - before < 2  # it was 10: once for each of 200 batches
    np.testing.assert_array_equal(np.concatenate([part["x"] for part in parts]), frame["x"])


def with_zeros(path, name, megabytes, head=b""):
    """A zip file with one more member, of zeros."""
    with (
        zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open(name, "w") as file,
    ):
        file.write(head)
        for _ in range(megabytes):
            file.write(MEGABYTE)
    return path


def test_an_archive_that_unpacks_to_far_more_than_its_size(tmp_path):
    np.savez_compressed(tmp_path / "log.npz", **COLUMNS)
    head = io.BytesIO()
    fields = {"descr": "<f8", "fortran_order": False, "shape": (35 << 20,)}
    np.lib.format.write_array_header_1_0(head, fields)
    path = with_zeros(tmp_path / "log.npz", "notes.npy", 8 * 35, head.getvalue())
    refused(path, "it unpacks to 2936.* bytes, more than 268435456")


def test_a_workbook_that_unpacks_to_far_more_than_its_size(tmp_path):
    path = with_zeros(workbook(tmp_path / "log.xlsx"), "xl/worksheets/sheet2.xml", 8 * 35)
    refused(path, "it has 2936.* bytes, more than 268435456")


def test_counts_that_a_tdms_file_does_not_hold(tmp_path):
    nptdms = pytest.importorskip("nptdms")
    with nptdms.TdmsWriter(tmp_path / "log.tdms") as file:
        file.write_segment([nptdms.ChannelObject("g", k, v) for k, v in COLUMNS.items()])
    content = (tmp_path / "log.tdms").read_bytes()
    content = content.replace(struct.pack("<Q", 200), struct.pack("<Q", 1 << 50))
    (tmp_path / "log.tdms").write_bytes(content)
    refused(tmp_path / "log.tdms", "log.tdms: reading failed midway")


def mdf(path, version="4.10"):
    """An MDF file with the channels; whoever changes it finds its blocks by their names."""
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
    about = struct.pack("<2s2BI2Q", b"DT", 0, 0, 0, 40 * len(T), len(packed))
    block = struct.pack("<4s4x2Q", b"##DZ", 24 + len(about + packed), 0) + about + packed
    with_links(path, content + block, {(b"##DG", 0, 2): len(content)})
    if not sorted_:
        with path.open("r+b") as file:
            file.seek(content.index(b"##DG") + 24 + 8 * 4)
            file.write(b"\x01")
    refused(path, "a block of data unpacks to more than the 8000 bytes")


def test_rows_that_an_mdf_file_does_not_hold(tmp_path):
    path = mdf(tmp_path / "log.mf4")
    content = bytearray(path.read_bytes())
    at = content.index(b"##CG")
    struct.pack_into("<Q", content, at + 24 + 8 * content[at + 16] + 8, 1 << 50)
    path.write_bytes(content)
    refused(path, "its rows have 45035996273704960 bytes, more than 268435456")


def conversion(*links):
    """A conversion of MDF 4 that refers to these blocks, where the value is 0 and elsewhere."""
    body = struct.pack(f"<{4 + len(links)}Q", 0, 0, 0, 0, *links)
    values = struct.pack("<2B3H3d", 7, 0, 0, len(links), 1, 0, 0, 0)
    return struct.pack("<4s4x2Q", b"##CC", 24 + len(body + values), 4 + len(links)) + body + values


def with_links(path, content, places):
    """Replace links of an MDF file: number of its block, of the link → address."""
    content = bytearray(content)
    for (kind, number, link), address in places.items():
        at = -1
        for _ in range(number + 1):
            at = content.index(kind, at + 1)
        struct.pack_into("<Q", content, at + 24 + 8 * link, address)
    path.write_bytes(content)


@pytest.mark.parametrize(
    ("depth", "words"), [(30, "conversions take more than 256 MB"), (5, None), (0, "circle")]
)
def test_conversions_that_refer_to_others_twice(tmp_path, depth, words):
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
    if words:
        refused(path, words)
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
    refused(path, "its texts and conversions take more than 257 MB")


@pytest.mark.parametrize("kind", [b"##CN", b"##CG", b"##DG", b"##FH"])
def test_blocks_in_a_circle(tmp_path, kind):
    path = mdf(tmp_path / "log.mf4")
    content = path.read_bytes()
    with_links(path, content, {(kind, 0, 0): content.index(kind)})
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
    refused(path, "its texts and conversions take more than 257 MB")


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
    for kind, body in [*((b"F", one.encode()) for one in types), (b"A", b"\0\0\0a")]:
        content += struct.pack("<H", len(body)) + kind + body
    (tmp_path / "log.ulg").write_bytes(content)
    refused(tmp_path / "log.ulg", "its topics have more than 262144 fields|recursion")
