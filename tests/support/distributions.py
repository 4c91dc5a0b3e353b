"""Source distribution and wheel, built as a release builds them."""

import os
import subprocess
import sys
import tarfile
from dataclasses import dataclass
from pathlib import Path

#: A date of a release [s since 1970]; even, as zip files count in steps of two seconds.
EPOCH = 1_700_000_000


@dataclass(frozen=True)
class Built:
    """Paths of what was built."""

    sdist: Path
    wheel: Path


def build(source: Path, out: Path, path: str | None = None, umask: int = 0o022) -> Built:
    """The sdist of a folder, and the wheel of this Python from that sdist."""
    variables = os.environ | {"SOURCE_DATE_EPOCH": str(EPOCH)} | ({"PATH": path} if path else {})
    done = subprocess.run(
        [sys.executable, "-m", "build", "--outdir", out, source],
        cwd=out.parent,
        env=variables,
        umask=umask if os.name == "posix" else -1,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    (sdist,), (wheel,) = out.glob("*.tar.gz"), out.glob("*.whl")
    return Built(sdist, wheel)


def unpacked(sdist: Path, into: Path) -> Path:
    """The folder in it."""
    with tarfile.open(sdist) as archive:
        archive.extractall(into, filter="data")
    (folder,) = into.iterdir()
    return folder
