"""The exported sources as WebAssembly: the same bits as the library, without any import."""

import shutil
import subprocess

import pytest

import fluxobs
from support.firmware import HARNESS

wasmtime = pytest.importorskip("wasmtime")
CLANG = ["clang", "--target=wasm32-wasi", "-O3", "-ffp-contract=off", "-nostartfiles"]
CLANG += ["-Wl,--no-entry", "-Wl,--strip-all"]
EXPORTS = {
    "servo-400w": {"unknowns": "drift"},
    "servo-400w, learning": {"unknowns": "drift,resistance,inverter,asymmetry"},
    "ipm-5kw6": {"unknowns": "drift"},  # with a flux map
    "induction-2kw2": {"unknowns": "drift"},
}


def can_link(tmp_path):
    """Whether clang, lld and the C library for WebAssembly are here."""
    if shutil.which("clang") is None:
        return False
    (tmp_path / "none.c").write_text("#include <math.h>\ndouble f(double x) { return sqrt(x); }\n")
    command = [*CLANG, tmp_path / "none.c", "-o", tmp_path / "none.wasm"]
    return subprocess.run(command, capture_output=True, check=False).returncode == 0


@pytest.mark.parametrize("precision", ["-DFO_SINGLE=1", "-DFO_SINGLE=0"])
@pytest.mark.parametrize("name", EXPORTS)
def test_every_output_has_the_same_bits_in_webassembly(tmp_path, name, precision):
    if not can_link(tmp_path):
        pytest.skip("no clang, lld and wasi-libc here")
    folder = tmp_path / "motor"
    fluxobs.export(name.split(",")[0], 1e-4, folder, **EXPORTS[name])
    sources = [*folder.glob("*obs*.c"), folder / "test" / "check.c", HARNESS / "wasm.c"]
    includes = [f"-I{folder}", f"-I{folder / 'test'}"]
    made = tmp_path / "motor.wasm"
    subprocess.run([*CLANG, precision, *includes, *sources, "-o", made], check=True)
    store = wasmtime.Store()
    module = wasmtime.Module.from_file(store.engine, str(made))
    assert not module.imports
    instance = wasmtime.Instance(store, module, [])
    assert instance.exports(store)["check"](store) == 0
