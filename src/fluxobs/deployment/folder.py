"""A folder that appears complete or not at all, and replaces only what it wrote itself."""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path

from ..errors import FluxobsError

#: Lists what was written, so that another export may replace that and nothing else.
MANIFEST = "MANIFEST"


def check_folder(folder: Path, force: bool) -> None:
    """FluxobsError unless the folder is new or empty, or an export that `force` may replace."""
    if not folder.exists():
        return
    if not folder.is_dir():
        raise FluxobsError(f"{folder}: exists and is no folder; give another name")
    if not any(folder.iterdir()):
        return
    if not force:
        raise FluxobsError(f"{folder}: exists; give another name, or --force to replace an export")
    for name, digest in _manifest(folder).items():
        path = folder / name
        if path.exists() and _digest(path.read_bytes()) != digest:
            raise FluxobsError(
                f"{path}: changed since it was exported; move it away, and it will be written anew"
            )


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _manifest(folder: Path) -> dict[str, str]:
    """What an earlier export wrote: name → SHA-256."""
    path = folder / MANIFEST
    if not path.exists():
        raise FluxobsError(f"{folder}: no earlier export, so nothing in it is overwritten")
    lines = path.read_text(encoding="utf-8").split("\n")
    return {name: digest for digest, _, name in (line.partition("  ") for line in lines) if name}


def write_folder(folder: Path, files: Mapping[str, str]) -> None:
    """All files or none: they are made beside the folder and moved there when complete.

    Raises
    ------
    FluxobsError
        Something is in the way, or the folder cannot be written.
    """
    try:
        _write(folder, files)
    except OSError as error:
        raise FluxobsError(f"{folder}: cannot be written: {error.strerror}") from None


def _write(folder: Path, files: Mapping[str, str]) -> None:
    contents = {name: text.encode() for name, text in files.items()}
    listing = "".join(f"{_digest(content)}  {name}\n" for name, content in contents.items())
    contents[MANIFEST] = listing.encode()
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".fluxobs-", dir=folder.parent) as scratch:
        made = Path(scratch) / "export"
        for name, content in contents.items():
            path = made / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        if folder.exists() and not any(folder.iterdir()):
            folder.rmdir()
        if not folder.exists():
            os.replace(made, folder)
            return
        old = _manifest(folder)
        for name in contents:
            path = folder / name
            if name not in old and name != MANIFEST and path.exists():
                raise FluxobsError(f"{path}: is no part of the earlier export; move it away")
            if path.parent.exists() and not path.parent.is_dir():
                raise FluxobsError(f"{path.parent}: is no folder; move it away")
        for name in contents:
            (folder / name).parent.mkdir(exist_ok=True)
            os.replace(made / name, folder / name)
        for name in old.keys() - contents.keys():
            (folder / name).unlink(missing_ok=True)
