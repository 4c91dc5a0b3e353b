"""Hostile MATLAB files must not overflow the stack or fill the memory."""

import struct
import zlib

import numpy as np
import pytest

from fluxobs.logs import read_log
from support.hostile import MEGABYTE, refused
from support.records import SMALL_LOG as COLUMNS

T = COLUMNS["t"]


def nested_cells(depth):
    """Return nested cells in the binary form of a MATLAB file."""
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
    refused(tmp_path / "deep.mat", "nested more than 200 levels deep")


@pytest.mark.parametrize("packed", [False, True])
def test_all_kinds_of_nested_arrays_are_followed(tmp_path, packed):
    """A file with structs, cells, texts, complex and sparse matrices is not refused as too deep."""
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
    """Return the head of an array in a MATLAB file."""
    shape = element(5, struct.pack("<2I", *sizes))
    return element(6, struct.pack("<2I", kind, 0)) + shape + element(1, b"notes")


def packed_array(path, head, content, times=1):
    """Write a MATLAB file with the channels and a compressed array of repeated content."""
    matlab = pytest.importorskip("scipy.io")
    matlab.savemat(path, COLUMNS)
    packer = zlib.compressobj(1)
    body = [struct.pack("<2I", 14, len(head) + len(content) * times) + head]
    packed = b"".join(packer.compress(block) for block in [*body, *[content] * times])
    with path.open("ab") as file:
        file.write(element(15, packed + packer.flush()))
    assert path.stat().st_size < 2 << 20
    return path


@pytest.mark.parametrize("packed", [False, True])
def test_a_matlab_object_is_skipped(tmp_path, packed):
    """The object is three texts and a numeric array, like a string or a datetime of MATLAB."""
    matlab = pytest.importorskip("scipy.io")
    matlab.savemat(tmp_path / "log.mat", COLUMNS)
    texts = b"".join(element(1, text) for text in (b"notes", b"MCOS", b"string"))
    numbers = element(14, array_head(13, 1, 6) + element(6, bytes(24)))
    array = element(14, element(6, struct.pack("<2I", 17, 0)) + texts + numbers)
    if packed:  # compressed elements are not padded
        content = zlib.compress(array)
        array = struct.pack("<2I", 15, len(content)) + content
    with (tmp_path / "log.mat").open("ab") as file:
        file.write(array)
    assert len(read_log(tmp_path / "log.mat")) == len(T)


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
