"""The export for WebAssembly and its record, and properties of all forms."""

import csv
import hashlib
import json
import re
import shutil
import subprocess

import numpy as np
import pytest
import wasmtime

import fluxobs
from fluxobs.deployment.forms import FORMS, build
from support.cli import fluxobs as command

ADAPTIVE = "drift,resistance,inverter"
STEP = 1e-4


def record(folder):
    with (folder / "test" / "record.csv").open() as text:
        head, *rows = list(csv.reader(text))
    return head, np.array([[float(cell) for cell in row] for row in rows])


@pytest.fixture(scope="module", params=["drift", ADAPTIVE], ids=["plain", "adaptive"])
def module(request, tmp_path_factory):
    """The WebAssembly form."""
    folder = tmp_path_factory.mktemp("wasm") / "motor"
    fluxobs.export("servo-400w", STEP, folder, unknowns=request.param, form="wasm")
    return folder


def test_the_module_returns_the_numbers_of_the_library(module):
    """The module runs in a runtime without JavaScript."""
    store = wasmtime.Store()
    compiled = wasmtime.Module.from_file(store.engine, str(module / "motor.wasm"))
    assert not compiled.imports
    exports = wasmtime.Instance(store, compiled, []).exports(store)
    memory = exports["memory"]
    inputs, outputs = exports["inputs"](store), exports["outputs"](store)
    head, rows = record(module)
    exports["reset"](store)
    results = []
    for row in rows:
        memory.write(store, row[:4].astype("<f8").tobytes(), inputs)
        exports["step"](store)
        values = memory.read(store, outputs, outputs + 8 * (len(head) - 4))
        results.append(np.frombuffer(values, "<f8"))
    np.testing.assert_array_equal(np.array(results), rows[:, 4:])


def test_the_module_in_javascript(module, tmp_path):
    def check(folder):
        script = ["node", folder / "test" / "check.mjs"]
        return subprocess.run(script, capture_output=True, text=True, check=False)

    done = check(module)
    assert done.returncode == 0, done.stdout + done.stderr
    compared = json.loads((module / "certificate.json").read_text())["compared"]
    assert compared[0]["different"] == 0
    assert compared[0]["by"].startswith("Node.js")
    copy = tmp_path / "motor"
    shutil.copytree(module, copy)
    path = copy / "test" / "record.csv"
    path.write_text(path.read_text().replace("0.00", "0.01", 1))
    assert check(copy).returncode == 1


def test_a_state_of_another_module_is_refused(module, tmp_path):
    """A state of another machine with the same size, and a state of another size, are refused."""
    certificate = json.loads((module / "certificate.json").read_text())
    unknowns = ADAPTIVE if "resistance" in certificate["settings"]["unknowns"] else "drift"
    fluxobs.export("pmsm-2kw2", STEP, tmp_path / "other", unknowns=unknowns, form="wasm")
    script = tmp_path / "swap.mjs"
    script.write_text(
        f"import {{ load as load_this }} from {json.dumps((module / 'motor.mjs').as_uri())};\n"
        'import { load as load_other } from "./other/motor.mjs";\n'
        "const [mine, other] = [await load_this(), await load_other()];\n"
        "mine.restore(mine.save());\n"
        "for (const saved of [other.save(), new Uint8Array(3)]) {\n"
        "  try { mine.restore(saved); console.log('taken'); }\n"
        "  catch (error) { console.log(error.message); }\n"
        "}\n"
    )
    done = subprocess.run(["node", script], capture_output=True, text=True, check=True)
    first, second = done.stdout.splitlines()
    assert "a state of another observer" in first
    assert "a state of 3 bytes" in second


@pytest.mark.parametrize("form", FORMS)
def test_the_certificate_of_every_form(tmp_path, form, monkeypatch):
    """The hashes match the files, and the contents common to all forms agree."""
    if form != "wasm":  # the compiler of this computer is faster
        monkeypatch.setattr(build, "has_zig", lambda: False)
    fluxobs.export("servo-400w", STEP, tmp_path / "it", form=form, unknowns="drift")
    fluxobs.export("servo-400w", STEP, tmp_path / "c", unknowns="drift")
    certificate = json.loads((tmp_path / "it" / "certificate.json").read_text())
    other = json.loads((tmp_path / "c" / "certificate.json").read_text())
    assert certificate.pop("form") == form
    for key in ("content", "sources", "parameters", "record", "expected", "machine", "settings"):
        if (form, key) != ("fmu", "sources"):  # they choose double precision
            assert certificate[key] == other[key]
    assert certificate["check"]
    for name, digest in {**certificate["sources"], **certificate["parameters"]}.items():
        for path in (tmp_path / "it").rglob(name):
            assert hashlib.sha256(path.read_bytes()).hexdigest() == digest
    for path in (tmp_path / "it").rglob("*"):
        if path.is_file() and path.suffix not in (".fmu", ".wasm", ".bin"):
            assert not re.search(r"@\w+@|@when", path.read_text()), path


def test_the_help_names_every_form(tmp_path):
    text = " ".join(command("export", "--help", folder=tmp_path).stdout.replace("│", " ").split())
    assert all(f"{form}:" in text for form in FORMS)
