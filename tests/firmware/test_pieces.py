"""Compares parts of the adaptive observer in C with dense matrices."""

import subprocess

import pytest

from support.compiling import build_program
from support.firmware import COMPILERS, FIRMWARE, HARNESS, firmware_objects


@pytest.mark.parametrize("precision", ["-DFO_SINGLE=1", "-DFO_SINGLE=0"])
def test_pieces_against_dense_matrices(tmp_path, precision):
    """Test factors, transition, process noise, derivatives, rows of a block, start, projection."""
    program = tmp_path / "pieces"
    parts = ("", "_map", "_triangle", "_candidates", "_relation")
    objects = firmware_objects((FIRMWARE / f"fluxobs{part}.c" for part in parts), precision)
    sources = [HARNESS / "pieces.c", *objects]
    options = ["-std=c99", "-O1", "-Wall", "-Werror", precision, f"-I{FIRMWARE}"]
    build_program(["gcc"], options, sources, program)
    done = subprocess.run([program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("precision", ["-DFO_SINGLE=1", "-DFO_SINGLE=0"])
def test_the_angle_has_the_same_bits_from_every_compiler(tmp_path, precision):
    bits = set()
    for compiler in COMPILERS:
        for level in ("-O1", "-O3"):
            program = tmp_path / f"{compiler.id}{level}"
            sources = [HARNESS / "angle.c", *(FIRMWARE / f for f in ("fluxobs.c", "fluxobs_map.c"))]
            flags = ["-std=c99", level, "-ffp-contract=off", "-Werror", precision, f"-I{FIRMWARE}"]
            build_program(compiler.values[0], flags, sources, program)
            done = subprocess.run([program], capture_output=True, text=True, check=False)
            assert done.returncode == 0, done.stdout
            bits.add(done.stdout)
    assert len(bits) == 1
