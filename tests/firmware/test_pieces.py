"""Parts of the adaptive observer in C, each against dense matrices."""

import subprocess

import pytest

from support.firmware import FIRMWARE, HARNESS


@pytest.mark.parametrize("precision", ["-DFO_SINGLE", "-UFO_SINGLE"])
def test_pieces_against_dense_matrices(tmp_path, precision):
    """Triangles, transition, random step, derivatives, effects, start, the projection's minimum."""
    program = tmp_path / "pieces"
    sources = [HARNESS / "pieces.c", FIRMWARE / "fluxobs.c", FIRMWARE / "fluxobs_map.c"]
    sources += [FIRMWARE / f"fluxobs_{part}.c" for part in ("triangle", "candidates")]
    command = ["gcc", "-std=c99", "-O1", "-Wall", "-Werror", precision, f"-I{FIRMWARE}"]
    subprocess.run([*command, *sources, "-lm", "-o", program], check=True)
    done = subprocess.run([program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
