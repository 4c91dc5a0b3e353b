"""The arithmetic for processors without a floating-point unit, beside this computer's."""

import subprocess

import pytest

from support.firmware import COMPILERS, FIRMWARE, HARNESS, STRICT


@pytest.mark.parametrize("compiler", COMPILERS)
def test_every_result_has_the_same_bits(tmp_path, compiler):
    program = tmp_path / "soft_float"
    sources = [HARNESS / "soft_float.c", FIRMWARE / "soft_float" / "soft_float.c"]
    flags = [one for one in STRICT if one != "-Wconversion"]
    subprocess.run([*compiler, *flags, *sources, "-o", program], check=True)
    done = subprocess.run([program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
