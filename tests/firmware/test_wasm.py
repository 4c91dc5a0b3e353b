"""The exported sources as WebAssembly compute the same bits as the library, without imports."""

import subprocess

import pytest
import wasmtime

import fluxobs
from fluxobs.deployment.forms.build import zig
from support.firmware import HARNESS

COMMAND = [*zig("wasm32-wasi"), "-mexec-model=reactor", "-O3", "-ffp-contract=off"]
EXPORTS = {
    "servo-400w": {"unknowns": "drift"},
    "servo-400w, learning": {"unknowns": "drift,resistance,inverter,asymmetry"},
    "ipm-5kw6": {"unknowns": "drift"},  # with a flux map
    "induction-2kw2": {"unknowns": "drift"},
}


#: Each machine in one precision; the others are slow.
QUICK = dict(zip(EXPORTS, 2 * ("-DFO_SINGLE=1", "-DFO_SINGLE=0"), strict=True))


@pytest.mark.parametrize(
    ("name", "precision"),
    [
        pytest.param(name, precision, marks=() if QUICK[name] == precision else pytest.mark.slow)
        for name in EXPORTS
        for precision in ("-DFO_SINGLE=1", "-DFO_SINGLE=0")
    ],
)
def test_every_output_has_the_same_bits_in_webassembly(tmp_path, name, precision):
    folder = tmp_path / "motor"
    fluxobs.export(name.split(",")[0], 1e-4, folder, **EXPORTS[name])
    sources = [*folder.glob("*obs*.c"), folder / "test" / "check.c", HARNESS / "wasm.c"]
    includes = [f"-I{folder}", f"-I{folder / 'test'}"]
    made = tmp_path / "motor.wasm"
    command = [*COMMAND, precision, *includes, *sources, "-o", made]
    # Compile in the same folder as an export, so that both use one C library.
    subprocess.run(command, check=True, cwd=tmp_path)
    store = wasmtime.Store()
    module = wasmtime.Module.from_file(store.engine, str(made))
    assert not module.imports
    instance = wasmtime.Instance(store, module, [])
    assert instance.exports(store)["check"](store) == 0
