"""Processes that a user's script starts after it has read a file."""

import multiprocessing
import subprocess
import sys

import pytest

SCRIPT = """
import multiprocessing, sys, warnings
import fluxobs
from fluxobs.errors import UsageError
from fluxobs.simulation.closed_form.demo import LOG

def rows(_):
    try:
        return len(fluxobs.read_log(LOG))
    except UsageError as error:
        return str(error)

if __name__ == "__main__":
    warnings.simplefilter("ignore")
    if sys.argv[2] == "after":
        rows(0)
    with multiprocessing.get_context(sys.argv[1]).Pool(2) as pool:
        print(*set(pool.map(rows, range(2))))
"""


@pytest.mark.parametrize("method", multiprocessing.get_all_start_methods())
@pytest.mark.parametrize("when", ["before", "after"])
def test_children_read_files_or_say_why_not(tmp_path, method, when):
    """Never stand still; refused is only a fork after the first file."""
    (tmp_path / "script.py").write_text(SCRIPT)
    done = subprocess.run(
        [sys.executable, "script.py", method, when],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    if (method, when) == ("fork", "after"):
        assert 'multiprocessing.get_context("spawn")' in done.stdout
    else:
        assert int(done.stdout) > 1000
