"""What is released: nothing but what belongs there, equal for equal sources, and it works alone."""

import json
import os
import subprocess
import sys
import sysconfig
import tarfile
import time
import tomllib
import venv
import zipfile
from importlib import machinery, resources
from pathlib import Path

import pytest

from support.distributions import EPOCH, build, unpacked

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
NAMED = f"fluxobs-{PROJECT['project']['version']}"
#: Built in a clone, and not in git.
PAGE = {
    "src/fluxobs/page/page.html",
    "src/fluxobs/page/report.html",
    "src/fluxobs/page/libraries.json",
}


def test_firmware_sources_are_package_data():
    folder = resources.files("fluxobs") / "firmware"
    for source in (ROOT / "firmware").rglob("*.*"):
        assert (folder / source.relative_to(ROOT / "firmware")).read_bytes() == source.read_bytes()


def in_sdist(sdist):
    with tarfile.open(sdist) as archive:
        assert all(member.isfile() for member in archive.getmembers())
        names = archive.getnames()
    assert {name.split("/")[0] for name in names} == {NAMED}
    return {name.partition("/")[2] for name in names}


def test_a_clone_builds_the_page_with_the_tools_of_its_group():
    """An sdist asks for none of them."""
    (override,) = PROJECT["tool"]["scikit-build"]["overrides"]
    assert override["build"]["requires"] == PROJECT["dependency-groups"]["page"]
    assert override["if"]["from-sdist"] is False
    assert not {one.split(">")[0] for one in PROJECT["build-system"]["requires"]} & {
        one.split(">")[0] for one in PROJECT["dependency-groups"]["page"]
    }


@pytest.mark.slow
def test_an_sdist_holds_what_git_holds(built):
    """And the page, and its own metadata."""
    git = ["git", "-C", ROOT, "ls-files", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(git, capture_output=True, text=True)
    if listed.returncode != 0:
        pytest.skip("no repository here")
    kept = {
        name
        for name in listed.stdout.splitlines()
        if (ROOT / name).exists()
        and not name.startswith(tuple(PROJECT["tool"]["scikit-build"]["sdist"]["exclude"]))
    }
    assert in_sdist(built.sdist) == kept | PAGE | {"PKG-INFO"}


@pytest.mark.slow
def test_a_wheel_holds_the_package_and_nothing_else(built):
    sources = in_sdist(built.sdist)
    with zipfile.ZipFile(built.wheel) as archive:
        names = set(archive.namelist())
        compiled = {name for name in names if name.endswith(tuple(machinery.EXTENSION_SUFFIXES))}
        binaries = b"".join(archive.read(name) for name in compiled)
        bill = archive.read(f"{NAMED}.dist-info/sboms/fluxobs.cdx.json").decode()
        dates = {entry.date_time for entry in archive.infolist()}
    package = {name.removeprefix("src/") for name in sources if name.startswith("src/fluxobs/")}
    package -= {"fluxobs/page/libraries.json"}
    firmware = {f"fluxobs/{name}" for name in sources if name.startswith("firmware/")}
    about = ("METADATA", "RECORD", "WHEEL", "entry_points.txt", "licenses/LICENSE")
    about += ("sboms/fluxobs.cdx.json",)
    assert names - compiled == (
        package
        | firmware
        | {"fluxobs/firmware/LICENSE"}
        | {f"{NAMED}.dist-info/{name}" for name in about}
    )
    assert {name.split(".")[0] for name in compiled} == {"fluxobs/_core", "fluxobs/_core_single"}
    # Nothing of the computer that built it, and no time but the release's.
    for place in (str(ROOT), str(built.wheel.parents[1]), str(Path.home()), sys.prefix, "/tmp/"):
        assert place.encode() not in binaries, place
    assert dates == {time.gmtime(EPOCH)[:6]}
    check_bill(bill)


def check_bill(text):
    """It is CycloneDX, and names all that is linked or bundled, with versions and licences."""
    from cyclonedx.schema import SchemaVersion  # they take three seconds to load
    from cyclonedx.validation.json import JsonStrictValidator

    problem = JsonStrictValidator(SchemaVersion.V1_6).validate_str(text)
    assert problem is None, problem
    parts = {one["name"]: one for one in json.loads(text)["components"]}
    wanted = {"nanobind", "robin-map", "wasi-libc", "ziglang"}
    lock = json.loads((ROOT / "web" / "package-lock.json").read_text("utf-8"))["packages"]
    for name in json.loads((ROOT / "web" / "package.json").read_text("utf-8"))["dependencies"]:
        assert parts[name]["version"] == lock[f"node_modules/{name}"]["version"]
        wanted.add(name)
    assert set(parts) == wanted
    for name in wanted - {"wasi-libc"}:
        assert "opyright" in parts[name]["licenses"][0]["license"]["text"]["content"]
    assert all(one.get("version") for name, one in parts.items() if name != "wasi-libc")


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="a shell script stands in for git")
def test_builds_are_equal_byte_for_byte_and_need_no_git(built, tmp_path):
    """From the unpacked sdist, elsewhere, later, with other permissions, outside any repository."""
    tools = tmp_path / "tools"
    tools.mkdir()
    (tools / "git").write_text(f"#!/bin/sh\ntouch {tmp_path}/called\nexit 1\n")
    (tools / "git").chmod(0o755)
    folder = unpacked(built.sdist, tmp_path / "a folder with another and longer name")
    path = os.pathsep.join([str(tools), os.environ["PATH"]])
    again = build(folder, tmp_path / "dist", path=path, umask=0o077)
    assert not (tmp_path / "called").exists(), "the build asks git"
    assert again.sdist.read_bytes() == built.sdist.read_bytes()
    assert again.wheel.name == built.wheel.name
    assert again.wheel.read_bytes() == built.wheel.read_bytes()


@pytest.mark.slow
def test_a_wheel_in_a_fresh_environment(built, tmp_path):
    """Installed without its dependencies, with those of this environment borrowed; no compiler."""
    venv.create(tmp_path / "env", with_pip=False)
    programs = tmp_path / "env" / ("Scripts" if os.name == "nt" else "bin")
    python = next(programs.glob("python*"))
    install = [sys.executable, "-m", "pip", "--python", python, "install", "-q", "--no-deps"]
    subprocess.run([*install, built.wheel], check=True, cwd=tmp_path)
    asked = "import sysconfig; print(sysconfig.get_path('purelib'))"
    site = subprocess.run([python, "-c", asked], check=True, capture_output=True, text=True)
    borrowed = Path(site.stdout.strip()) / "borrowed.pth"
    borrowed.write_text(sysconfig.get_path("purelib") + "\n")
    variables = os.environ | {"PATH": str(programs)}
    script = (
        "import fluxobs, fluxobs._core as core, pathlib, importlib.resources as r\n"
        f"assert pathlib.Path(core.__file__).is_relative_to({str(tmp_path)!r}), core.__file__\n"
        "assert (r.files('fluxobs') / 'firmware' / 'fluxobs.c').is_file()\n"
        "assert (r.files('fluxobs') / 'page' / 'page.html').is_file()\n"
    )
    demo = [programs / "fluxobs", "demo", "--out", "results"]
    for command in ([python, "-c", script], demo):
        done = subprocess.run(command, cwd=tmp_path, env=variables, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
    assert (tmp_path / "results" / "report.png").exists()
