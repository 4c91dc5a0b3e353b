"""User input reaches an export only as a number, a checked name, or inert text."""

import io
import json
import math
import shutil
import subprocess
import zipfile
from xml.etree import ElementTree

import numpy as np
import pytest

import fluxobs
from fluxobs import FluxobsError
from fluxobs.deployment.c_source import inert
from fluxobs.deployment.forms import FORMS, build
from fluxobs.machines import read_machine

#: This name would end a comment, string, element or table cell, define a macro, or look like a
#: placeholder.
HOSTILE = (
    "a*\\\n#define fo_step fo_evil\n??\\\r\n\" ' @prefix@ @content@ @unknown@ <b> & ]]> --> "
    "| `rm` ${x} %{ %s\u2028 \u202e é\x1b[0m \\u002a .csv"
)
TAME = "map.csv"
STEP = 1e-4


def machine(folder, name):
    """Return an interior machine whose flux map has this file name."""
    at = np.linspace(-20, 20, 9)
    i = (at[:, None] + 1j * at[None, :]).ravel()
    rows = np.column_stack([i.real, i.imag, 0.5 + 0.01 * i.real, 0.02 * i.imag])
    np.savetxt(folder / name, rows, delimiter=",", header="i_d,i_q,psi_d,psi_q", comments="")
    text = 'kind = "interior-pmsm"\nR_s = 0.5\nn_p = 3\nrated_current = 15.0\n'
    (folder / "motor.toml").write_text(f"{text}flux_map = {json.dumps(name)}\n")
    return read_machine(folder / "motor.toml")


def contents(folder):
    """Return the contents of the files, also of files in units, by relative path."""
    files = {}
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        name, data = path.relative_to(folder).as_posix(), path.read_bytes()
        files[name] = data
        if path.suffix == ".fmu":
            with zipfile.ZipFile(io.BytesIO(data)) as unit:
                files |= {f"{name}/{entry}": unit.read(entry) for entry in unit.namelist()}
    return {name: data for name, data in files.items() if not name.endswith(".fmu")}


@pytest.mark.parametrize(
    ("form", "unknowns"),
    [
        pytest.param(form, unknowns, marks=() if k % 2 == m else pytest.mark.slow)
        for k, form in enumerate(FORMS)
        for m, unknowns in enumerate(("drift", "drift,resistance"))
    ],
)
def test_the_name_of_a_table_is_inert(tmp_path, monkeypatch, form, unknowns):
    """Except for the name and its hashes, the export equals an export with another name."""
    monkeypatch.setattr(build, "compile_shared", lambda *arguments: b"")
    monkeypatch.setattr(build, "compile_wasm", lambda *arguments: b"")
    monkeypatch.setattr(build, "compared", lambda *arguments: [])
    exports = {}
    for name in (TAME, HOSTILE):
        folder = tmp_path / ("tame" if name == TAME else "hostile")
        folder.mkdir()
        try:
            mapped = machine(folder, name)
        except OSError:
            pytest.skip("no file can have such a name here")
        done = fluxobs.export(mapped, STEP, folder / "out", unknowns=unknowns, form=form)
        exports[name] = done.content, contents(done.folder)
    (tame_hash, tame), (hash_, hostile) = exports[TAME], exports[HOSTILE]
    assert tame.keys() == hostile.keys()
    occurrences = 0
    for path, data in hostile.items():
        if path.endswith(".json"):
            json.loads(data)
        if path.endswith(".xml"):
            ElementTree.fromstring(data)
        if path.endswith(".bin"):  # numbers only
            assert data == tame[path]
            continue
        text = data.decode()
        occurrences += text.count(inert(HOSTILE))
        if path == "MANIFEST" or path.endswith("certificate.json"):
            continue  # these files hold hashes of the other files
        text = text.replace(inert(HOSTILE), TAME).replace(hash_, tame_hash)
        token = "instantiationToken" if "fmi3" in path else "guid"
        if not path.endswith(("modelDescription.xml", "unit.c", "fmi2.c", "fmi3.c")):
            assert text == tame[path].decode(), path
        else:  # these files hold an identifier computed from the content
            assert len(text) == len(tame[path].decode()), (path, token)
    assert occurrences >= 2  # in the parameters' header and in the certificate
    if form == "c" and (gcc := shutil.which("gcc")):
        flags = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-fsyntax-only"]
        command = [gcc, *flags, "motor_observer.c"]
        subprocess.run(command, cwd=tmp_path / "hostile" / "out", check=True)


@pytest.mark.parametrize(
    "options",
    [
        *[{"prefix": prefix} for prefix in (5, "", "a b", "a\n", "é", "*/", "@prefix@", "a" * 41)],
        *[{"update_every": every} for every in (1.5, "2", True, math.nan, 10**9)],
        *[{"sample_time": time} for time in (math.nan, math.inf, "1e-4", -1e-4)],
        *[{"memory": time} for time in (math.nan, math.inf, "0.03;")],
        *[{"current_noise": noise} for noise in (math.nan, math.inf, "1")],
        *[{"drift_prior": prior} for prior in (math.nan, math.inf, "1")],
        *[{"priors": {"resistance": std}} for std in (math.nan, math.inf, "1*/")],
        {"priors": {"*/": 1.0}},
        {"unknowns": "*/"},
        *[{"form": form} for form in ("../c", "__init__", "build", 3)],
    ],
    ids=str,
)
def test_invalid_names_and_numbers_are_refused(tmp_path, options):
    defaults = {"sample_time": STEP, "unknowns": "drift,resistance"}
    with pytest.raises(FluxobsError):
        fluxobs.export("servo-400w", **(defaults | options), out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("field", ["R_s", "L_d", "psi_f", "rated_current"])
@pytest.mark.parametrize("value", ["nan", "inf", '"1 */ evil"', "[1]", "true"])
def test_a_machine_file_has_numbers_only(tmp_path, field, value):
    lines = {"kind": '"interior-pmsm"', "R_s": "0.5", "n_p": "3", "rated_current": "15.0"}
    lines |= {"L_d": "1e-3", "L_q": "2e-3", "psi_f": "0.1"} | {field: value}
    path = tmp_path / "motor.toml"
    path.write_text("".join(f"{name} = {text}\n" for name, text in lines.items()))
    with pytest.raises(FluxobsError, match=field):
        read_machine(path)


@pytest.mark.parametrize("kind", ["*/", "interior-pmsm\n", "../interior-pmsm"])
def test_a_kind_is_one_of_the_known(tmp_path, kind):
    (tmp_path / "motor.toml").write_text(f"kind = {json.dumps(kind)}\nR_s = 1.0\n")
    with pytest.raises(FluxobsError, match="unknown kind"):
        read_machine(tmp_path / "motor.toml")
