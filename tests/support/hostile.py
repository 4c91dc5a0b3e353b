"""Helpers for the tests of hostile logs."""

import zipfile
import zlib

import pytest

from fluxobs import FluxobsError
from fluxobs.logs import read_log

MEGABYTE = bytes(1 << 20)


def refused(path, message, **options):
    with pytest.raises(FluxobsError, match=message) as error:
        list(read_log(path, **options).aligned())
    assert path.name in str(error.value)
    assert len(str(error.value)) < 1000


def zeros(megabytes):
    packer = zlib.compressobj(1)
    return b"".join(packer.compress(MEGABYTE) for _ in range(megabytes)) + packer.flush()


def with_zeros(path, name, megabytes, head=b""):
    """Add a member of zeros to a zip file."""
    with (
        zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open(name, "w") as file,
    ):
        file.write(head)
        for _ in range(megabytes):
            file.write(MEGABYTE)
    return path
