"""Folders that appear complete or not at all, and replace only files of an earlier export."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TypeVar

from ..core.output import claimed
from ..core.symlinks import refuse_link
from ..errors import FluxobsError

#: File that lists the exported files; a later export may replace only these files.
MANIFEST = "MANIFEST"


Content = TypeVar("Content")


def joined(*groups: Mapping[str, Content]) -> dict[str, Content]:
    """Return the contents of all groups of files, by relative path.

    Raises
    ------
    FluxobsError
        Two files have the same name apart from case, which some file systems ignore.
    """
    files: dict[str, Content] = {}
    names: set[str] = set()
    for name, content in (item for group in groups for item in group.items()):
        if name.casefold() in names:
            raise FluxobsError(f"{name}: two files have this name; give another prefix")
        names.add(name.casefold())
        files[name] = content
    return files


def check_folder(folder: Path, force: bool) -> None:
    """Raise FluxobsError unless the folder is new, empty, or an export that `force` may replace."""
    try:
        _check_replaceable(folder, force)
    except OSError as error:
        raise FluxobsError(f"{error.filename or folder}: {error.strerror}") from None


def _check_replaceable(folder: Path, force: bool) -> None:
    if not folder.exists():
        return
    if not folder.is_dir():
        raise FluxobsError(f"{folder}: exists and is not a folder; give another name")
    if not any(folder.iterdir()):
        return
    if not force:
        raise FluxobsError(f"{folder}: exists; give another name, or --force to replace an export")
    for name, digests in _manifest(folder).items():
        path = _within(folder, name)
        if _exists(path) and (path.is_symlink() or sha256(path.read_bytes()) not in digests):
            raise FluxobsError(
                f"{path}: changed since the export; move the file away, then export again"
            )


def _within(folder: Path, name: str) -> Path:
    """Return the path of a file in the folder; refuse links, which may lead out of the folder."""
    path = folder / name
    for parent in (folder / above for above in Path(name).parents[:-1]):
        refuse_link(parent)
        if _exists(parent) and not parent.is_dir():
            raise FluxobsError(f"{parent}: is not a folder; move the file away")
    return path


def _exists(path: Path) -> bool:
    return path.exists() or path.is_symlink()


def sha256(content: bytes) -> str:
    """Return the SHA-256 of a file's content in hexadecimal."""
    return hashlib.sha256(content).hexdigest()


def _manifest(folder: Path) -> dict[str, set[str]]:
    """Return the SHA-256 of each file of an earlier export (two values after an interruption)."""
    path = folder / MANIFEST
    refuse_link(path)
    if not path.exists():
        raise FluxobsError(
            f"{folder}: is not an earlier export and is not overwritten; give another name"
        )
    digests: dict[str, set[str]] = {}
    for line in path.read_bytes().decode(errors="replace").split("\n"):
        digest, _, name = line.partition("  ")
        if Path(name).is_absolute() or ".." in Path(name).parts:
            raise FluxobsError(f"{path}: damaged: {name!r} is not a path within the folder")
        if name:
            digests.setdefault(name, set()).add(digest)
    return digests


def _listing(contents: Mapping[str, bytes]) -> bytes:
    return "".join(f"{sha256(content)}  {name}\n" for name, content in contents.items()).encode()


@contextmanager
def _scratch(folder: Path) -> Iterator[Path]:
    """Yield a scratch folder beside `folder`; first remove the scratch folder of a killed run."""
    scratch = folder.with_name(f".{folder.name}.unfinished")
    with claimed(folder):
        try:
            _remove(scratch)
            scratch.mkdir()
            yield scratch
        finally:
            _remove(scratch)


def _remove(scratch: Path) -> None:
    if scratch.is_symlink():
        scratch.unlink()
    elif scratch.exists():
        shutil.rmtree(scratch)


def write_folder(folder: Path, files: Mapping[str, str | bytes]) -> None:
    """Write all files or none: write them beside the folder, then move them there.

    Raises
    ------
    FluxobsError
        Another file is in the way, or the folder cannot be written.
    """
    try:
        _write(folder, files)
    except OSError as error:
        raise FluxobsError(f"{folder}: cannot be written: {error.strerror}") from None


def _write(folder: Path, files: Mapping[str, str | bytes]) -> None:
    contents = {
        name: content.encode() if isinstance(content, str) else content
        for name, content in files.items()
    }
    folder.parent.mkdir(parents=True, exist_ok=True)
    with _scratch(folder) as scratch:
        new = scratch / "export"
        for name, content in [*contents.items(), (MANIFEST, _listing(contents))]:
            path = new / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        if folder.exists() and not any(folder.iterdir()):
            folder.rmdir()
        if not folder.exists():
            os.replace(new, folder)
            return
        old = _manifest(folder)
        for name in {**contents, **old}:
            path = _within(folder, name)
            if name not in old and _exists(path):
                raise FluxobsError(f"{path}: is not part of the earlier export; move the file away")
        # While files are being replaced, the manifest lists both versions.
        both = scratch / MANIFEST
        both.write_bytes((folder / MANIFEST).read_bytes() + _listing(contents))
        os.replace(both, folder / MANIFEST)
        for name in contents:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            os.replace(new / name, folder / name)
        for name in old.keys() - contents.keys():
            (folder / name).unlink(missing_ok=True)
            for above in Path(name).parents[:-1]:
                with suppress(OSError):  # not empty: it holds other files
                    (folder / above).rmdir()
        os.replace(new / MANIFEST, folder / MANIFEST)
