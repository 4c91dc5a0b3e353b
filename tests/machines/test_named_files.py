"""A file from someone else cannot name files outside its folder."""

import os
from pathlib import Path

import numpy as np
import pytest

from fluxobs.campaigns.specification import read_specification
from fluxobs.errors import FluxobsError
from fluxobs.logs.meaning.layout import read_fields
from fluxobs.machines import FluxPoints, SynchronousReluctance, read_machine
from fluxobs.machines.saving import write_machine

MOTOR = 'kind = "synchronous-reluctance"\nR_s = 0.63\nn_p = 2\nrated_current = 22.0\n'


def table(path):
    axis = np.linspace(-20, 20, 9)
    i = (axis[:, None] + 1j * axis[None, :]).ravel()
    rows = np.column_stack([i.real, i.imag, 0.03 * i.real, 0.01 * i.imag])
    path.parent.mkdir(exist_ok=True)
    np.savetxt(path, rows, delimiter=",", header="i_d,i_q,psi_d,psi_q", comments="")


def named(folder, name):
    """Write a machine file that names a table; return the reader, the path and the field."""
    path = folder / "motor.toml"
    path.write_text(f"{MOTOR}flux_map = {name}\n")
    return lambda: read_machine(path).flux_map, path, "flux_map"


def joined(folder, name):
    path = folder / "record.toml"
    path.write_text(f"join = [{name}]\n")
    return lambda: read_fields(path)["join"], path, "join"


def specified(folder, name):
    path = folder / "campaign.toml"
    path.write_text(f"machines = [{name}]\nscenarios = 1\nobservers = ['plain']\n")
    return lambda: read_specification(path).machines, path, "machines"


def limited(folder, name):
    path = folder / "campaign.toml"
    text = "machines = ['servo-400w']\nscenarios = 1\nobservers = ['plain']\n"
    path.write_text(f"{text}[[limits]]\ngood = 0.5\nmachine = {name}\n")
    return lambda: read_specification(path), path, "limits: machine"


FILES = [named, joined, specified, limited]


@pytest.fixture
def folder(tmp_path):
    """A folder with tables in, below and beside the folder."""
    inside = tmp_path / "inside"
    for place in (inside, inside / "below", tmp_path):
        table(place / "map.csv")
    if os.name == "posix":
        (inside / "link.csv").symlink_to("../map.csv")
        (inside / "up").symlink_to("..")
        (inside / "circle.csv").symlink_to("circle.csv")
    return inside


OUTSIDE = ['"../map.csv"', '"below/../../map.csv"', '"up/map.csv"', '"link.csv"', '"/etc/passwd"']


@pytest.mark.skipif(os.name != "posix", reason="links")
@pytest.mark.parametrize("name", OUTSIDE)
@pytest.mark.parametrize("kind", FILES)
def test_a_file_outside_the_folder_is_refused(folder, kind, name):
    read, path, field = kind(folder, name)
    with pytest.raises(FluxobsError) as refused:
        read()
    text = str(refused.value)
    assert text.startswith(f"{path}: {field}: {name.replace(chr(34), chr(39))} is outside")
    assert "copy the file there" in text


@pytest.mark.parametrize("kind", FILES)
def test_an_invalid_path_is_refused(folder, kind):
    read, path, _ = kind(folder, '"a\\u0000b"')
    with pytest.raises(FluxobsError, match="is not a valid path") as refused:
        read()
    assert str(refused.value).startswith(f"{path}: ")


@pytest.mark.skipif(os.name != "posix", reason="links")
def test_a_cycle_of_links_is_refused(folder):
    with pytest.raises(FluxobsError, match=r"circle\.csv"):
        named(folder, '"circle.csv"')[0]()


@pytest.mark.parametrize("name", ["map.csv", "below/map.csv", "below/../map.csv"])
def test_files_beside_and_below_are_read(folder, name, monkeypatch):
    target = (folder / name).resolve()
    for value in (f'"{name}"', f"'{target}'"):
        assert Path(named(folder, value)[0]().source).resolve() == target
        assert [Path(path).resolve() for path in joined(folder, value)[0]()] == [target]
        assert specified(folder, value)[0]() == [str(target)]
    monkeypatch.chdir(folder)  # a relative path refers to the current folder
    (folder / "motor.toml").write_text(f'{MOTOR}flux_map = "{name}"\n')
    assert read_machine("motor.toml").flux_map is not None


def test_a_machine_file_is_written_with_its_table(folder, tmp_path):
    named(folder, '"below/map.csv"')
    machine = read_machine(folder / "motor.toml")
    write_machine(folder / "found.toml", machine, [], {}, False)
    assert 'flux_map = "below/map.csv"' in (folder / "found.toml").read_text()

    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    write_machine(elsewhere / "found.toml", machine, [], {}, False)
    assert (elsewhere / "found-map.csv").exists()
    for place in (folder, elsewhere):
        reread = read_machine(place / "found.toml").flux_map
        np.testing.assert_array_equal(reread.current, machine.flux_map.current)
        np.testing.assert_array_equal(reread.flux, machine.flux_map.flux)
    (elsewhere / "found.toml").unlink()
    with pytest.raises(FluxobsError, match=r"found-map\.csv: exists"):
        write_machine(elsewhere / "found.toml", machine, [], {}, False)


def test_a_table_from_arrays_is_written_too(tmp_path):
    i = np.array([-5 - 5j, -5 + 5j, 5 - 5j, 5 + 5j, 0, 5, 5j, -5, -5j])
    points = FluxPoints(i, 0.03 * i.real + 0.01j * i.imag)
    machine = SynchronousReluctance(
        R_s=1.0, n_p=2, L_d=0.03, L_q=0.01, rated_current=5.0, flux_map=points
    )
    write_machine(tmp_path / "motor.toml", machine, [], {}, False)
    reread = read_machine(tmp_path / "motor.toml").flux_map
    np.testing.assert_array_equal(reread.flux, points.flux)


def test_a_hostile_log_name_cannot_add_a_field(tmp_path):
    named(tmp_path, "{ a_d0 = 17.4, a_q0 = 52.1 }")
    machine = read_machine(tmp_path / "motor.toml")
    heads = ["Learnt from x\nR_s = 9.csv", "x\rR_s = 9\u2028\x1b[31m"]
    write_machine(tmp_path / "found.toml", machine, heads, {}, False)
    assert read_machine(tmp_path / "found.toml").R_s == machine.R_s
