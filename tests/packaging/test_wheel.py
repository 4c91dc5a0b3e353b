"""Released files contain only what belongs there, are reproducible, and work alone."""

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
PREFIX = f"fluxobs-{PROJECT['project']['version']}"
#: Files that a build adds to a clone; git does not track them.
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
    assert {name.split("/")[0] for name in names} == {PREFIX}
    return {name.partition("/")[2] for name in names}


def test_a_clone_requires_the_tools_that_build_the_page():
    """A source distribution has no such file."""
    (override,) = PROJECT["tool"]["scikit-build"]["overrides"]
    assert override["build"]["requires"] == PROJECT["dependency-groups"]["page"]
    assert override["if"]["from-sdist"] is False
    assert not {tool.split(">")[0] for tool in PROJECT["build-system"]["requires"]} & {
        tool.split(">")[0] for tool in PROJECT["dependency-groups"]["page"]
    }


@pytest.mark.slow
def test_an_sdist_contains_the_files_in_git(built):
    """The page and the sdist's metadata are added."""
    git = ["git", "-C", ROOT, "ls-files", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(git, capture_output=True, text=True)
    if listed.returncode != 0:
        pytest.skip("not a git repository")
    expected = {
        name
        for name in listed.stdout.splitlines()
        if (ROOT / name).exists()
        and not name.startswith(tuple(PROJECT["tool"]["scikit-build"]["sdist"]["exclude"]))
    }
    assert in_sdist(built.sdist) == expected | PAGE | {"PKG-INFO"}


@pytest.mark.slow
def test_a_wheel_contains_only_the_package(built):
    sources = in_sdist(built.sdist)
    with zipfile.ZipFile(built.wheel) as archive:
        names = set(archive.namelist())
        compiled = {name for name in names if name.endswith(tuple(machinery.EXTENSION_SUFFIXES))}
        binaries = b"".join(archive.read(name) for name in compiled)
        bill = archive.read(f"{PREFIX}.dist-info/sboms/fluxobs.cdx.json").decode()
        dates = {entry.date_time for entry in archive.infolist()}
    package = {name.removeprefix("src/") for name in sources if name.startswith("src/fluxobs/")}
    package -= {"fluxobs/page/libraries.json"}
    firmware = {f"fluxobs/{name}" for name in sources if name.startswith("firmware/")}
    metadata = ("METADATA", "RECORD", "WHEEL", "entry_points.txt", "licenses/LICENSE")
    metadata += ("sboms/fluxobs.cdx.json",)
    assert names - compiled == (
        package
        | firmware
        | {"fluxobs/firmware/LICENSE"}
        | {f"{PREFIX}.dist-info/{name}" for name in metadata}
    )
    assert {name.split(".")[0] for name in compiled} == {
        "fluxobs/_core",
        "fluxobs/_core_single",
        "fluxobs/_smoother",
        "fluxobs/_engine",
    }
    # The files contain no path of the build machine, and no time except the release time.
    for path in (str(ROOT), str(built.wheel.parents[1]), str(Path.home()), sys.prefix, "/tmp/"):
        assert path.encode() not in binaries, path
    assert dates == {time.gmtime(EPOCH)[:6]}
    check_bill(bill)


def check_bill(text):
    """Check that the bill of materials is CycloneDX and lists all linked or bundled components.

    Each component has a version and a licence.
    """
    from cyclonedx.schema import SchemaVersion  # loading takes three seconds
    from cyclonedx.validation.json import JsonStrictValidator

    problem = JsonStrictValidator(SchemaVersion.V1_6).validate_str(text)
    assert problem is None, problem
    components = {component["name"]: component for component in json.loads(text)["components"]}
    names = {"nanobind", "robin-map", "wasi-libc", "ziglang"}
    lock = json.loads((ROOT / "web" / "package-lock.json").read_text("utf-8"))["packages"]
    for name in json.loads((ROOT / "web" / "package.json").read_text("utf-8"))["dependencies"]:
        assert components[name]["version"] == lock[f"node_modules/{name}"]["version"]
        names.add(name)
    assert set(components) == names
    for name in names - {"wasi-libc"}:
        assert "opyright" in components[name]["licenses"][0]["license"]["text"]["content"]
    assert all(
        component.get("version") for name, component in components.items() if name != "wasi-libc"
    )


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="a shell script replaces git")
def test_builds_are_equal_byte_for_byte_and_need_no_git(built, tmp_path):
    """Build from the sdist later, elsewhere, outside any repository, with other permissions."""
    tools = tmp_path / "tools"
    tools.mkdir()
    (tools / "git").write_text(f"#!/bin/sh\ntouch {tmp_path}/called\nexit 1\n")
    (tools / "git").chmod(0o755)
    folder = unpacked(built.sdist, tmp_path / "a folder with another and longer name")
    path = os.pathsep.join([str(tools), os.environ["PATH"]])
    second = build(folder, tmp_path / "dist", path=path, umask=0o077)
    assert not (tmp_path / "called").exists(), "the build calls git"
    assert second.sdist.read_bytes() == built.sdist.read_bytes()
    assert second.wheel.name == built.wheel.name
    assert second.wheel.read_bytes() == built.wheel.read_bytes()


@pytest.mark.slow
def test_a_wheel_in_a_fresh_environment(built, tmp_path):
    """Install without a compiler and without dependencies; this environment provides those."""
    venv.create(tmp_path / "env", with_pip=False)
    programs = tmp_path / "env" / ("Scripts" if os.name == "nt" else "bin")
    python = next(programs.glob("python*"))
    install = [sys.executable, "-m", "pip", "--python", python, "install", "-q", "--no-deps"]
    subprocess.run([*install, built.wheel], check=True, cwd=tmp_path)
    program = "import sysconfig; print(sysconfig.get_path('purelib'))"
    site = subprocess.run([python, "-c", program], check=True, capture_output=True, text=True)
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
        process = subprocess.run(
            command, cwd=tmp_path, env=variables, capture_output=True, text=True
        )
        assert process.returncode == 0, process.stderr
    assert (tmp_path / "results" / "report.png").exists()
