import pytest

from support import drives


@pytest.fixture(autouse=True, scope="module")
def compiled_once():
    """Let runs of different lengths share their compilation."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(drives.module, "_simulate", drives.simulate_compiled_once)
        yield
