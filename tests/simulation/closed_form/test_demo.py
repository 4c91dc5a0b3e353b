"""The demonstration, and a replay of its log that must give the committed outputs.

Every changed number appears as a difference in tests/expected/demo.csv. If the change is intended,
rewrite the file with ``PYTHONPATH=tests python tests/simulation/closed_form/test_demo.py``.
"""

import io
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from PIL import Image

from fluxobs import estimate
from fluxobs.simulation.closed_form.demo import LOG, MACHINE, demo_log, generate, write
from support.cli import fluxobs

EXPECTED = Path(__file__).parents[2] / "expected" / "demo.csv"
EVERY = 50


@pytest.fixture(scope="module")
def replayed(tmp_path_factory):
    return replay(tmp_path_factory.mktemp("replay"))


def replay(folder):
    result = estimate(demo_log(), MACHINE, out=folder / "out.parquet")
    return result, pl.read_parquet(folder / "out.parquet")


def test_shipped_log_is_the_generated_one(tmp_path):
    write(tmp_path / "log.csv")
    generated, shipped = (
        pl.read_csv(source) for source in (tmp_path / "log.csv", io.StringIO(LOG.read_text()))
    )
    assert generated.columns == shipped.columns == list(generate())
    # Another libm may round the last digit of a quantised value differently.
    for name, step in (("i_alpha", 0.011), ("u_beta", 0.0051), ("theta_e", 1.1e-5), ("t", 0)):
        assert (generated[name] - shipped[name]).abs().max() <= step


def test_replay_gives_the_committed_numbers(replayed):
    _, estimates = replayed
    expected = pl.read_csv(EXPECTED)
    estimates = estimates.gather_every(EVERY)
    assert estimates.columns == expected.columns
    for name in expected.columns:
        a, b = estimates[name].to_numpy(), expected[name].to_numpy()
        if name == "valid":
            np.testing.assert_array_equal(a, b)
        else:
            np.testing.assert_allclose(a, b, rtol=1e-7, atol=1e-9, err_msg=name)


def test_the_picture_in_the_readme_is_that_of_the_demo(replayed):
    """If the title changed, run `python benchmarks/pictures.py` and read the README again."""
    result, _ = replayed
    with Image.open(Path(__file__).parents[3] / "docs" / "images" / "demo.png") as picture:
        assert picture.text["Title"] == result.plot().get_suptitle()


def test_demo_errors_are_small(replayed):
    result, estimates = replayed
    statistics = result.statistics
    assert statistics.valid > 0.85 * statistics.rows  # not at full load: L_s is assumed to 10 %
    assert statistics.error_max < np.radians(2)  # even through zero speed
    settled = estimates.filter(pl.col("valid") & (pl.col("t") > 0.2) & (pl.col("t") < 1.0))
    assert settled["theta_e_error"].abs().max() < np.radians(2)


def test_demo_command_writes_both_files(tmp_path):
    done = fluxobs("demo", "--out", "results", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert sorted(p.name for p in (tmp_path / "results").iterdir()) == [
        "estimates.parquet",
        "report.png",
    ]
    assert "mWb (file 12.5 mWb)" in done.stdout
    assert "Warning" not in done.stdout


if __name__ == "__main__":
    import tempfile

    EXPECTED.parent.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        replay(Path(folder))[1].gather_every(EVERY).write_csv(EXPECTED)
