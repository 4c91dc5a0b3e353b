"""An installed wheel works outside the source tree and carries the firmware sources."""

import subprocess
import sys
import venv
import zipfile
from importlib import metadata, resources
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
#: The page, which git does not have, is in a wheel if it was built.
BUILT = ROOT / "src" / "fluxobs" / "web" / "page.html"


#: Code, its types, templates of exports, logs and machines that are shipped, licence.
KINDS = {".py", ".pyi", ".typed", ".so", ".pyd", ".c", ".h", ".toml", ".csv", ".json", ".html"}
KINDS |= {".md", ".mjs", ".m", ".ino", ".properties", ".js", ".css", ""}


def test_firmware_sources_are_package_data():
    folder = resources.files("fluxobs") / "firmware"
    sources = sorted((ROOT / "firmware").glob("fluxobs*.[ch]"))
    assert len(sources) == 14
    for source in sources:
        assert (folder / source.name).read_bytes() == source.read_bytes()


def check_contents(wheel):
    """What the package needs, and nothing else."""
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    top = {name.split("/")[0] for name in names}
    assert top == {"fluxobs", f"fluxobs-{metadata.version('fluxobs')}.dist-info"}
    assert not [name for name in names if "__pycache__" in name or "/." in name]
    inside = {name for name in names if name.startswith("fluxobs/")}
    kinds = {Path(name).suffix for name in inside}
    assert kinds <= KINDS, kinds - KINDS
    for path in (ROOT / "src" / "fluxobs" / "deployment" / "templates").rglob("*.*"):
        assert path.relative_to(ROOT / "src").as_posix() in inside


@pytest.mark.slow
def test_wheel_in_a_fresh_environment(tmp_path):
    """Builds the wheel, installs it without its dependencies, borrows those of this environment."""
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "wheel", "--no-deps"]
    subprocess.run(
        [*pip, "-q", "-w", tmp_path, ROOT], check=True, cwd=tmp_path, capture_output=True
    )
    (wheel,) = tmp_path.glob("fluxobs-*.whl")
    check_contents(wheel)
    venv.create(tmp_path / "env", with_pip=False)
    python = tmp_path / "env" / "bin" / "python"
    install = [sys.executable, "-m", "pip", "--python", python, "install", "-q", "--no-deps"]
    subprocess.run([*install, wheel], check=True, cwd=tmp_path)
    here = subprocess.run(
        [sys.executable, "-c", "import polars, sysconfig; print(sysconfig.get_path('purelib'))"],
        check=True,
        capture_output=True,
        text=True,
    ).stdout.strip()
    site = next((tmp_path / "env").glob("lib/python*/site-packages"))
    (site / "borrowed.pth").write_text(here + "\n")
    script = (
        "import fluxobs, fluxobs._core as core, pathlib, importlib.resources as r\n"
        f"assert pathlib.Path(core.__file__).is_relative_to({str(tmp_path)!r}), core.__file__\n"
        "assert (r.files('fluxobs') / 'firmware' / 'fluxobs.c').is_file()\n"
        f"assert (r.files('fluxobs') / 'web' / 'page.html').is_file() == {BUILT.is_file()}\n"
        "from fluxobs.cli import main\n"
        "import sys; sys.argv = ['fluxobs', 'demo', '--out', 'results']; main()\n"
    )
    done = subprocess.run([python, "-c", script], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "results" / "report.png").exists()
