from pathlib import Path

import pytest

from support.distributions import build

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def built(tmp_path_factory):
    """Return the distributions of a release of this tree."""
    return build(ROOT, tmp_path_factory.mktemp("release") / "dist")
