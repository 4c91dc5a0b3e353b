"""Build source distribution and wheel as for a release."""

import os
import subprocess
import sys
import tarfile
from dataclasses import dataclass
from pathlib import Path

#: Time of a release [s since 1970], an even number because zip files count in steps of two seconds.
EPOCH = 1_700_000_000


@dataclass(frozen=True)
class Built:
    """Paths of the built files."""

    sdist: Path
    wheel: Path


def build(source: Path, out: Path, path: str | None = None, umask: int = 0o022) -> Built:
    """Build the sdist of a folder, and from it the wheel for this Python."""
    variables = os.environ | {"SOURCE_DATE_EPOCH": str(EPOCH)} | ({"PATH": path} if path else {})
    process = subprocess.run(
        [sys.executable, "-m", "build", "--outdir", out, source],
        cwd=out.parent,
        env=variables,
        umask=umask if os.name == "posix" else -1,
        capture_output=True,
        text=True,
    )
    assert process.returncode == 0, process.stdout + process.stderr
    (sdist,), (wheel,) = out.glob("*.tar.gz"), out.glob("*.whl")
    return Built(sdist, wheel)


def unpacked(sdist: Path, into: Path) -> Path:
    """Unpack an sdist; return its folder."""
    with tarfile.open(sdist) as archive:
        archive.extractall(into, filter="data")
    (folder,) = into.iterdir()
    return folder
