"""Hostile input files: pipes, devices and abusive TOML."""

import os

import pytest

from fluxobs import FluxobsError, MachineError, RecordError
from fluxobs.campaigns.specification import read_specification
from fluxobs.core.hashing import hash_file
from fluxobs.core.input_files import MAX_TOML_BYTES
from fluxobs.logs.formats import open_tables
from fluxobs.logs.meaning.layout import read_fields
from fluxobs.machines import FluxPoints, read_machine

READERS = [
    (read_machine, MachineError),
    (read_fields, RecordError),
    (read_specification, FluxobsError),
]
BINARY = [(FluxPoints.read, MachineError), (open_tables, RecordError), (hash_file, FluxobsError)]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
@pytest.mark.parametrize(("read", "kind"), READERS + BINARY)
@pytest.mark.parametrize("ending", ["csv", "npz", "mf4", "parquet", "xlsx", "json", "npy"])
def test_a_pipe_is_refused(tmp_path, read, kind, ending):
    """A read would block for ever, because nothing writes to the pipe."""
    os.mkfifo(tmp_path / f"pipe.{ending}")
    with pytest.raises(kind, match=f"pipe.{ending}: this is a pipe or a device; save"):
        read(tmp_path / f"pipe.{ending}")


@pytest.mark.skipif(not os.path.exists("/dev/zero"), reason="needs devices")
@pytest.mark.parametrize(("read", "kind"), READERS + BINARY)
def test_a_device_is_refused(tmp_path, read, kind):
    (tmp_path / "zero").symlink_to("/dev/zero")
    with pytest.raises(kind, match="zero: this is a pipe or a device"):
        read(tmp_path / "zero")


@pytest.mark.parametrize(("read", "kind"), READERS)
@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x = 1\n" * MAX_TOML_BYTES, f"larger than {MAX_TOML_BYTES} bytes"),
        ("x = " + "[" * 10_000, "not TOML: nested too deeply"),
        ("x" + ".a" * 2000 + " = 1", "not TOML: nested too deeply"),
        ("x = " + "[" * 60 + "]" * 60, "not TOML: nested too deeply"),
        ("x = " + "9" * 5000, "not TOML: Exceeds the limit"),
        ("x = 0x" + "f" * 5000, "not TOML: an integer has more than 64 bits"),
        ("x = \xff", "not TOML"),
    ],
)
def test_abusive_toml(tmp_path, read, kind, text, message):
    path = tmp_path / "input.toml"
    path.write_text(text, encoding="latin-1")
    with pytest.raises(kind, match=message) as error:
        read(path)
    assert "input.toml" in str(error.value)


def test_a_long_value_is_quoted_shortened(tmp_path):
    (tmp_path / "input.toml").write_text(f"sample_time = '{'x' * 30_000}'")
    with pytest.raises(RecordError, match="sample_time: input should be a valid number") as error:
        read_fields(tmp_path / "input.toml")
    assert len(str(error.value)) < 4000
