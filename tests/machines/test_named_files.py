"""A file that somebody sends names no file outside of its own folder."""

import os
from pathlib import Path

import numpy as np
import pytest

from fluxobs.campaigns.specification import read_specification
from fluxobs.errors import FluxobsError
from fluxobs.logs.layout import read_fields
from fluxobs.machines import FluxPoints, SynchronousReluctance, read_machine
from fluxobs.machines.saving import write_machine

MOTOR = 'kind = "synchronous-reluctance"\nR_s = 0.63\nn_p = 2\nrated_current = 22.0\n'


def table(path):
    at = np.linspace(-20, 20, 9)
    i = (at[:, None] + 1j * at[None, :]).ravel()
    rows = np.column_stack([i.real, i.imag, 0.03 * i.real, 0.01 * i.imag])
    path.parent.mkdir(exist_ok=True)
    np.savetxt(path, rows, delimiter=",", header="i_d,i_q,psi_d,psi_q", comments="")


def named(folder, name):
    """A machine file that names a table, what reads it, and the field."""
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
    """A folder, with tables in it, below it and beside it."""
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
def test_what_lies_elsewhere_is_refused(folder, kind, name):
    read, path, field = kind(folder, name)
    with pytest.raises(FluxobsError) as refused:
        read()
    text = str(refused.value)
    assert text.startswith(f"{path}: {field}: {name.replace(chr(34), chr(39))} is outside")
    assert "copy it there" in text


@pytest.mark.parametrize("kind", FILES)
def test_what_is_no_path_is_refused(folder, kind):
    read, path, _ = kind(folder, '"a\\u0000b"')
    with pytest.raises(FluxobsError, match="is not a valid path") as refused:
        read()
    assert str(refused.value).startswith(f"{path}: ")


@pytest.mark.skipif(os.name != "posix", reason="links")
def test_a_circle_of_links_is_refused(folder):
    with pytest.raises(FluxobsError, match=r"circle\.csv"):
        named(folder, '"circle.csv"')[0]()


@pytest.mark.parametrize("name", ["map.csv", "below/map.csv", "below/../map.csv"])
def test_beside_and_below_is_read(folder, name, monkeypatch):
    wanted = (folder / name).resolve()
    for one in (f'"{name}"', f"'{wanted}'"):
        assert Path(named(folder, one)[0]().source).resolve() == wanted
        assert [Path(path).resolve() for path in joined(folder, one)[0]()] == [wanted]
        assert specified(folder, one)[0]() == [str(wanted)]
    monkeypatch.chdir(folder)  # a file without a folder is in the present one
    (folder / "motor.toml").write_text(f'{MOTOR}flux_map = "{name}"\n')
    assert read_machine("motor.toml").flux_map is not None


def test_a_machine_file_takes_its_table_along(folder, tmp_path):
    named(folder, '"below/map.csv"')
    machine = read_machine(folder / "motor.toml")
    write_machine(folder / "found.toml", machine, [], {}, False)
    assert 'flux_map = "below/map.csv"' in (folder / "found.toml").read_text()

    away = tmp_path / "away"
    away.mkdir()
    write_machine(away / "found.toml", machine, [], {}, False)
    assert (away / "found-map.csv").exists()
    for place in (folder, away):
        again = read_machine(place / "found.toml").flux_map
        np.testing.assert_array_equal(again.current, machine.flux_map.current)
        np.testing.assert_array_equal(again.flux, machine.flux_map.flux)
    (away / "found.toml").unlink()
    with pytest.raises(FluxobsError, match=r"found-map\.csv: exists"):
        write_machine(away / "found.toml", machine, [], {}, False)


def test_a_table_from_memory_is_written_too(tmp_path):
    i = np.array([-5 - 5j, -5 + 5j, 5 - 5j, 5 + 5j, 0, 5, 5j, -5, -5j])
    points = FluxPoints(i, 0.03 * i.real + 0.01j * i.imag)
    machine = SynchronousReluctance(
        R_s=1.0, n_p=2, L_d=0.03, L_q=0.01, rated_current=5.0, flux_map=points
    )
    write_machine(tmp_path / "motor.toml", machine, [], {}, False)
    again = read_machine(tmp_path / "motor.toml").flux_map
    np.testing.assert_array_equal(again.flux, points.flux)


def test_a_log_with_a_hostile_name_writes_no_field(tmp_path):
    named(tmp_path, "{ a_d0 = 17.4, a_q0 = 52.1 }")
    machine = read_machine(tmp_path / "motor.toml")
    heads = ["Learnt from x\nR_s = 9.csv", "x\rR_s = 9\u2028\x1b[31m"]
    write_machine(tmp_path / "found.toml", machine, heads, {}, False)
    assert read_machine(tmp_path / "found.toml").R_s == machine.R_s
