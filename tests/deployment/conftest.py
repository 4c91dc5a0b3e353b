import pytest

import fluxobs
from support.records import MACHINES


@pytest.fixture(scope="session")
def folders(tmp_path_factory):
    """Every machine exported for 10 kHz: not to be written to."""
    made = {}
    for name, machine in MACHINES.items():
        made[name] = tmp_path_factory.mktemp("exports") / name
        fluxobs.export(machine, 1e-4, made[name])
    return made
