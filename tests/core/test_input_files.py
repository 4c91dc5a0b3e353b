"""Files that people give: pipes, devices and TOML that no person writes."""

import os

import pytest

from fluxobs import FluxobsError, MachineError, RecordError
from fluxobs.campaigns.specification import read_specification
from fluxobs.core.hashing import content_of
from fluxobs.core.input_files import MOST
from fluxobs.logs.formats import open_tables
from fluxobs.logs.layout import read_fields
from fluxobs.machines import FluxPoints, read_machine

READERS = [
    (read_machine, MachineError),
    (read_fields, RecordError),
    (read_specification, FluxobsError),
]
BINARY = [(FluxPoints.read, MachineError), (open_tables, RecordError), (content_of, FluxobsError)]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes with names")
@pytest.mark.parametrize(("read", "kind"), READERS + BINARY)
@pytest.mark.parametrize("ending", ["csv", "npz", "mf4", "parquet", "xlsx", "json", "npy"])
def test_a_pipe_is_no_file(tmp_path, read, kind, ending):
    """It would block for ever: nobody writes to it."""
    os.mkfifo(tmp_path / f"pipe.{ending}")
    with pytest.raises(kind, match=f"pipe.{ending}: this is a pipe or a device; save"):
        read(tmp_path / f"pipe.{ending}")


@pytest.mark.skipif(not os.path.exists("/dev/zero"), reason="needs devices")
@pytest.mark.parametrize(("read", "kind"), READERS + BINARY)
def test_a_device_is_no_file(tmp_path, read, kind):
    (tmp_path / "zero").symlink_to("/dev/zero")
    with pytest.raises(kind, match="zero: this is a pipe or a device"):
        read(tmp_path / "zero")


@pytest.mark.parametrize(("read", "kind"), READERS)
@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x = 1\n" * MOST, f"larger than {MOST} bytes"),
        ("x = " + "[" * 10_000, "not TOML: nested too deeply"),
        ("x" + ".a" * 2000 + " = 1", "not TOML: nested too deeply"),
        ("x = " + "[" * 60 + "]" * 60, "not TOML: nested too deeply"),
        ("x = " + "9" * 5000, "not TOML: Exceeds the limit"),
        ("x = 0x" + "f" * 5000, "not TOML: an integer has more than 64 bits"),
        ("x = \xff", "not TOML"),
    ],
)
def test_toml_that_no_person_writes(tmp_path, read, kind, text, words):
    path = tmp_path / "given.toml"
    path.write_text(text, encoding="latin-1")
    with pytest.raises(kind, match=words) as error:
        read(path)
    assert "given.toml" in str(error.value)


def test_a_long_value_is_not_quoted_as_a_whole(tmp_path):
    (tmp_path / "given.toml").write_text(f"sample_time = '{'x' * 30_000}'")
    with pytest.raises(RecordError, match="sample_time: input should be a valid number") as error:
        read_fields(tmp_path / "given.toml")
    assert len(str(error.value)) < 4000
