"""The Rust form: its `cargo test` replays the record bit for bit."""

import shutil
import subprocess

import pytest

import fluxobs

CARGO = shutil.which("cargo")


@pytest.mark.skipif(CARGO is None, reason="no cross compiler: cargo")
@pytest.mark.parametrize(
    ("machine", "unknowns"),
    [
        pytest.param("servo-400w", "drift", marks=pytest.mark.slow),
        pytest.param("ipm-2kw2", "drift", marks=pytest.mark.slow),
        ("synrm-6kw7", "drift,resistance,inverter,asymmetry"),
    ],
)
def test_the_crate_replays_its_record(tmp_path, machine, unknowns):
    folder = fluxobs.export(
        machine, 1e-4, tmp_path / "crate", unknowns=unknowns, form="rust", prefix="M_1"
    ).folder
    done = subprocess.run(
        [CARGO, "test", "--offline"], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("2 passed") == 1  # tests/record.rs
    assert done.stdout.count("1 passed") == 1  # the example in the docs
    assert "warning" not in done.stderr


@pytest.mark.skipif(CARGO is None, reason="no cross compiler: cargo")
def test_a_changed_number_is_detected(tmp_path):
    folder = fluxobs.export(
        "servo-400w", 1e-4, tmp_path / "crate", form="rust", unknowns="drift"
    ).folder
    record = folder / "tests" / "record.csv"
    lines = record.read_text().splitlines()
    cells = lines[1000].split(",")
    cells[6] = repr(float(cells[6]) * (1 + 1e-6))
    lines[1000] = ",".join(cells)
    record.write_text("\n".join(lines) + "\n")
    done = subprocess.run(
        [CARGO, "test", "--offline"], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode != 0
    assert "row 999, output 2" in done.stdout
