import pytest

import fluxobs
from support.records import MACHINES


@pytest.fixture(scope="session")
def folders(tmp_path_factory):
    """Export every machine for 10 kHz; tests must not write to these folders."""
    exports = {}
    for name, machine in MACHINES.items():
        exports[name] = tmp_path_factory.mktemp("exports") / name
        fluxobs.export(machine, 1e-4, exports[name], unknowns="drift")
    return exports
