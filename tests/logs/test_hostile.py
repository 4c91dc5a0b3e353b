"""Hostile logs: none reads other files, ends the program, blocks it, or fills the memory."""

import numpy as np
import pytest

from fluxobs import FluxobsError
from fluxobs.logs import read_log

T = 1e-3 * np.arange(200)
COLUMNS = {
    "t": T,
    "u_alpha": np.cos(T),
    "u_beta": np.sin(T),
    "i_alpha": np.cos(T),
    "i_beta": np.sin(T),
}


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
