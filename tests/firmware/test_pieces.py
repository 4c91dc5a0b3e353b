"""Compares parts of the adaptive observer in C with dense matrices."""

import subprocess

import pytest

from support.firmware import COMPILERS, FIRMWARE, HARNESS


@pytest.mark.parametrize("precision", ["-DFO_SINGLE=1", "-DFO_SINGLE=0"])
def test_pieces_against_dense_matrices(tmp_path, precision):
    """Test factors, transition, process noise, derivatives, rows of a block, start, projection."""
    program = tmp_path / "pieces"
    sources = [HARNESS / "pieces.c", FIRMWARE / "fluxobs.c", FIRMWARE / "fluxobs_map.c"]
    sources += [FIRMWARE / f"fluxobs_{part}.c" for part in ("triangle", "candidates", "relation")]
    command = ["gcc", "-std=c99", "-O1", "-Wall", "-Werror", precision, f"-I{FIRMWARE}"]
    subprocess.run([*command, *sources, "-lm", "-o", program], check=True)
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
            subprocess.run(
                [*compiler.values[0], *flags, *sources, "-lm", "-o", program], check=True
            )
            done = subprocess.run([program], capture_output=True, text=True, check=False)
            assert done.returncode == 0, done.stdout
            bits.add(done.stdout)
    assert len(bits) == 1
