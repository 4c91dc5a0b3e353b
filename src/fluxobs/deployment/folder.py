"""A folder that appears complete or not at all, and replaces only what it wrote itself."""

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

#: Lists what was written, so that another export may replace that and nothing else.
MANIFEST = "MANIFEST"


Content = TypeVar("Content")


def joined(*parts: Mapping[str, Content]) -> dict[str, Content]:
    """Relative path → content: the files of all parts, none of which replaces another.

    Raises
    ------
    FluxobsError
        Two files have one name, if only on a file system that knows no case.
    """
    found: dict[str, Content] = {}
    names: set[str] = set()
    for name, content in (item for part in parts for item in part.items()):
        if name.casefold() in names:
            raise FluxobsError(f"{name}: two files have this name; give another prefix")
        names.add(name.casefold())
        found[name] = content
    return found


def check_folder(folder: Path, force: bool) -> None:
    """Raise FluxobsError unless the folder is new, empty, or an export that `force` may replace."""
    try:
        _check(folder, force)
    except OSError as error:
        raise FluxobsError(f"{error.filename or folder}: {error.strerror}") from None


def _check(folder: Path, force: bool) -> None:
    if not folder.exists():
        return
    if not folder.is_dir():
        raise FluxobsError(f"{folder}: exists and is no folder; give another name")
    if not any(folder.iterdir()):
        return
    if not force:
        raise FluxobsError(f"{folder}: exists; give another name, or --force to replace an export")
    for name, digests in _manifest(folder).items():
        path = _within(folder, name)
        if _exists(path) and (path.is_symlink() or sha256(path.read_bytes()) not in digests):
            raise FluxobsError(
                f"{path}: changed since it was exported; move it away, and it will be written anew"
            )


def _within(folder: Path, name: str) -> Path:
    """The path of a file of an export, which no link on the way leads elsewhere."""
    path = folder / name
    for parent in (folder / above for above in Path(name).parents[:-1]):
        refuse_link(parent)
        if _exists(parent) and not parent.is_dir():
            raise FluxobsError(f"{parent}: is no folder of its own; move it away")
    return path


def _exists(path: Path) -> bool:
    return path.exists() or path.is_symlink()


def sha256(content: bytes) -> str:
    """Hash of a file's content."""
    return hashlib.sha256(content).hexdigest()


def _manifest(folder: Path) -> dict[str, set[str]]:
    """What an earlier export wrote: name → SHA-256, or two of them if it was interrupted."""
    path = folder / MANIFEST
    refuse_link(path)
    if not path.exists():
        raise FluxobsError(f"{folder}: no earlier export, so nothing in it is overwritten")
    found: dict[str, set[str]] = {}
    for line in path.read_bytes().decode(errors="replace").split("\n"):
        digest, _, name = line.partition("  ")
        if Path(name).is_absolute() or ".." in Path(name).parts:
            raise FluxobsError(f"{path}: damaged: {name!r} is no name within the folder")
        if name:
            found.setdefault(name, set()).add(digest)
    return found


def _listing(contents: Mapping[str, bytes]) -> bytes:
    return "".join(f"{sha256(content)}  {name}\n" for name, content in contents.items()).encode()


@contextmanager
def _scratch(folder: Path) -> Iterator[Path]:
    """A folder beside another, for this run alone; one that a killed run left is removed."""
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
    """Write all files or none: they are made beside the folder and moved there when complete.

    Raises
    ------
    FluxobsError
        Something is in the way, or the folder cannot be written.
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
        made = scratch / "export"
        for name, content in [*contents.items(), (MANIFEST, _listing(contents))]:
            path = made / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        if folder.exists() and not any(folder.iterdir()):
            folder.rmdir()
        if not folder.exists():
            os.replace(made, folder)
            return
        old = _manifest(folder)
        for name in {**contents, **old}:
            path = _within(folder, name)
            if name not in old and _exists(path):
                raise FluxobsError(f"{path}: is no part of the earlier export; move it away")
        # While files are being replaced, either version of them is ours.
        both = scratch / MANIFEST
        both.write_bytes((folder / MANIFEST).read_bytes() + _listing(contents))
        os.replace(both, folder / MANIFEST)
        for name in contents:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            os.replace(made / name, folder / name)
        for name in old.keys() - contents.keys():
            (folder / name).unlink(missing_ok=True)
            for above in Path(name).parents[:-1]:
                with suppress(OSError):  # something else is in it
                    (folder / above).rmdir()
        os.replace(made / MANIFEST, folder / MANIFEST)
