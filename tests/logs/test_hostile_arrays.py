"""Hostile HDF5, npz, npy, Parquet and Arrow files must not read other files or fill the memory."""

import io
import time
import zipfile

import numpy as np
import polars as pl
import pytest

from fluxobs import FluxobsError
from fluxobs.logs import read_log
from fluxobs.logs.formats import open_tables
from support.hostile import refused, with_zeros, zeros
from support.records import SMALL_LOG as COLUMNS

T = COLUMNS["t"]


@pytest.fixture(params=["log.h5", "log.mat"])
def hdf5(request, tmp_path):
    """Write an HDF5 or MATLAB 7.3 file that lacks the column i_beta."""
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


@pytest.mark.parametrize(
    ("nodes", "reason"), [("deep", "nested more than 32 deep"), ("many", "more than 10000 groups")]
)
def test_groups_without_end_are_refused(nodes, reason, tmp_path):
    """Their listing would take a time that grows faster than the file."""
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "log.h5"
    with h5py.File(path, "w") as file:
        if nodes == "deep":
            file.create_group("/".join(40 * "g"))
        else:
            for number in range(10_001):
                file.create_group(str(number))
    with pytest.raises(FluxobsError, match=reason):
        read_log(path)


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


def test_a_dataset_name_that_is_not_utf8(hdf5):
    import h5py

    with h5py.File(hdf5, "a") as file:
        file["i_beta"] = COLUMNS["i_beta"]
        file[b"x\xff\xfe"] = T
    assert len(read_log(hdf5)) == len(T)


def with_chunks(path, chunk, packed=None, rows=None, **options):
    """Add i_beta to the HDF5 file in chunks of `chunk` rows; the first chunk is `packed`."""
    import h5py

    with h5py.File(path, "a") as file:
        rows = len(T) if rows is None else rows
        data = file.create_dataset("i_beta", (rows,), "f8", chunks=(chunk,), **options)
        if packed is None:
            data[: len(T)] = COLUMNS["i_beta"]
        else:
            data.id.write_direct_chunk((0,), packed)


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
    (table,) = [candidate for candidate in open_tables(hdf5) if "i_beta" in candidate.columns]
    with pytest.raises(FluxobsError, match="i_beta unpacks to 8796093022208 bytes"):
        list(table.batches(["i_beta"], 0, 10))


def test_a_large_chunk_is_unpacked_once(tmp_path):
    h5py = pytest.importorskip("h5py")
    rows = 1 << 20
    values = np.sin(np.arange(rows))
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file.create_dataset("x", data=values, chunks=(rows,), compression="gzip")
    (table,) = open_tables(tmp_path / "log.h5")
    before = time.process_time()
    batches = list(table.batches(["x"], 0, rows, 10_000))
    assert time.process_time() - before < 1  # unpacking once for each of 100 batches takes 5 s
    np.testing.assert_array_equal(np.concatenate([batch["x"] for batch in batches]), values)


@pytest.mark.parametrize("ending", ["npy", "npz"])
@pytest.mark.parametrize("kind", [[("a", float), ("b", float)], (float, 3), complex, "V8", "S5"])
def test_a_field_without_numbers_is_not_a_column(tmp_path, ending, kind):
    rows = np.zeros(200, [*((name, float) for name in COLUMNS), ("note", kind)])
    for name, values in COLUMNS.items():
        rows[name] = values
    path = tmp_path / f"log.{ending}"
    np.save(path, rows) if ending == "npy" else np.savez(path, log=rows)
    (table,) = open_tables(path)
    assert [name.removeprefix("log/") for name in table.columns] == list(COLUMNS)


def test_an_unused_member_is_not_unpacked(tmp_path):
    np.savez_compressed(tmp_path / "log.npz", **COLUMNS)
    head = io.BytesIO()
    fields = {"descr": "<f8", "fortran_order": False, "shape": (1 << 29,)}
    np.lib.format.write_array_header_1_0(head, fields)
    with zipfile.ZipFile(tmp_path / "log.npz", "a") as archive:
        archive.writestr("notes.npy", head.getvalue())
    log = read_log(tmp_path / "log.npz")
    assert len(log) == len(T)
    (table,) = [
        candidate for candidate in open_tables(tmp_path / "log.npz") if "notes" in candidate.columns
    ]
    with pytest.raises(FluxobsError, match=r"log\.npz: reading failed midway: "):
        list(table.batches(["notes"], 0, 10))


@pytest.mark.filterwarnings("ignore:Stored array in format 3.0")
def test_fields_with_names_in_other_scripts(tmp_path):
    np.savez(tmp_path / "log.npz", **COLUMNS, notes=np.zeros(200, [("Ω", float)]))
    assert any("notes/Ω" in table.columns for table in open_tables(tmp_path / "log.npz"))


def test_an_array_larger_than_memory(tmp_path):
    head = io.BytesIO()
    fields = {"descr": "<f8", "fortran_order": False, "shape": (1 << 50,)}
    np.lib.format.write_array_header_1_0(head, fields)
    with zipfile.ZipFile(tmp_path / "log.npz", "w") as archive:
        archive.writestr("t.npy", head.getvalue())
    refused(tmp_path / "log.npz", "is too large for memory")


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
    rows = 1 << 20
    frame = pl.DataFrame({"t": np.arange(rows) * 1e-4, "x": np.sin(np.arange(rows))})
    frame.write_ipc(tmp_path / "log.arrow", compression="zstd", record_batch_size=rows)
    (table,) = open_tables(tmp_path / "log.arrow")
    before = time.process_time()
    batches = list(table.batches(["t", "x"], 0, rows, 10_000))
    assert time.process_time() - before < 1  # unpacking once for each of 100 batches took 3 s
    np.testing.assert_array_equal(np.concatenate([batch["x"] for batch in batches]), frame["x"])


def test_an_archive_that_unpacks_to_far_more_than_its_size(tmp_path):
    np.savez_compressed(tmp_path / "log.npz", **COLUMNS)
    head = io.BytesIO()
    fields = {"descr": "<f8", "fortran_order": False, "shape": (35 << 20,)}
    np.lib.format.write_array_header_1_0(head, fields)
    path = with_zeros(tmp_path / "log.npz", "notes.npy", 8 * 35, head.getvalue())
    refused(path, "it unpacks to 2936.* bytes, more than 268435456")
