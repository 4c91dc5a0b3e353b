"""One-line errors in Python modules: the mutations of Cosmic Ray that a test could miss."""

from __future__ import annotations

import tempfile
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path

from cosmic_ray.commands import init
from cosmic_ray.mutating import use_mutation
from cosmic_ray.plugins import get_operator
from cosmic_ray.work_db import WorkDB, use_db
from cosmic_ray.work_item import MutationSpec

ROOT = Path(__file__).parents[2]
SOURCES = ROOT / "src" / "fluxobs"
#: These operators raise TypeError on floats, which any test catches; "|" mostly separates types.
BITWISE = {"BitOr", "BitAnd", "BitXor", "LShift", "RShift"}


@dataclass(frozen=True)
class PythonMutant:
    """One mutation of one expression."""

    path: Path
    line: int
    name: str
    #: The expression, the same in all its mutations.
    site: tuple[object, ...]
    mutation: MutationSpec

    def applied(self) -> AbstractContextManager[object]:
        """Return a context in which the source file contains the error."""
        operator = get_operator(self.mutation.operator_name)(**self.mutation.operator_args)
        return use_mutation(self.path, operator, self.mutation.occurrence)


def python_mutants(room: str) -> list[PythonMutant]:
    """Return all errors in a folder or file below src/fluxobs."""
    where = SOURCES / room
    files = sorted(where.rglob("*.py")) if where.is_dir() else [where]
    with (
        tempfile.TemporaryDirectory() as folder,
        use_db(Path(folder) / "mutants.sqlite", WorkDB.Mode.create) as database,
    ):
        init(files, database, {})
        mutations = [mutation for item in database.work_items for mutation in item.mutations]
    return [
        PythonMutant(
            path=Path(mutation.module_path),
            line=mutation.start_pos[0],
            name=mutation.operator_name.removeprefix("core/"),
            site=(mutation.module_path, mutation.start_pos, mutation.end_pos),
            mutation=mutation,
        )
        for mutation in mutations
        if not BITWISE & set(mutation.operator_name.split("_"))
    ]
