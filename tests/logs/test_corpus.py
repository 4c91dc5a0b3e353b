"""One run, saved in the layouts of many tools and instruments: each file gives the same angle."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

import fluxobs

_SPEC = importlib.util.spec_from_file_location(
    "write_corpus", Path(__file__).with_name("write_corpus.py")
)
corpus = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(corpus)

SIGNALS = corpus.run()
#: Angle error [°] of files whose first interval is unknown or whose values are rounded.
ROUNDING = dict.fromkeys(("mesc.csv", "odrive.csv", "moteus.npz", "vesc-sampled.csv"), 0.01)
TOLERANCE = 5e-4
#: Formats whose files contain a date or compressed bytes.
NOT_TEXT = (
    ".mf4",
    ".tdms",
    ".mat",
    ".h5",
    ".xlsx",
    ".xls",
    ".parquet",
    ".feather",
    ".npz",
    ".npy",
    ".gz",
)


@pytest.fixture(scope="module")
def expected():
    names = ("t", "u_alpha", "u_beta", "i_alpha", "i_beta")
    columns = {name: SIGNALS[name] for name in names}
    return fluxobs.estimate(columns, corpus.MACHINE, unknowns="drift", causal=True)


@pytest.mark.parametrize("name", corpus.LAYOUTS)
def test_the_first_command_is_right(name, expected):
    options = {"preset": corpus.PRESETS[name]} if name in corpus.PRESETS else {}
    if name == "moteus.npz":  # the stream has no time, and its rate is not the usual 30 kHz
        options["sample_time"] = corpus.SAMPLE_TIME
    result = fluxobs.estimate(
        corpus.FOLDER / name, corpus.MACHINE, unknowns="drift", causal=True, **options
    )
    assert len(result.estimates) == corpus.ROWS
    both = result["valid"] & expected["valid"]
    assert both.sum() >= expected["valid"].sum() - 1
    error = np.degrees(np.angle(np.exp(1j * (result["theta_e"] - expected["theta_e"]))))
    assert np.abs(error[both]).max() < ROUNDING.get(name, TOLERANCE)
    if result.log.true is not None:
        assert abs(result.truth_fit["zero"].value) < np.radians(0.1)
        assert not result.truth_fit.wrong_turns


@pytest.mark.parametrize("name", [n for n in corpus.LAYOUTS if not n.endswith(NOT_TEXT)])
def test_the_corpus_is_up_to_date(name, tmp_path):
    corpus.LAYOUTS[name](SIGNALS, tmp_path / name)
    assert (tmp_path / name).read_bytes() == (corpus.FOLDER / name).read_bytes()


@pytest.mark.parametrize("name", corpus.LAYOUTS)
def test_every_guess_can_be_saved(name, tmp_path):
    """With a saved record, the file is read in the same way, but without guesses."""
    from fluxobs.logs import read_log
    from fluxobs.logs.meaning.record_files import write_record

    options = {"preset": corpus.PRESETS[name]} if name in corpus.PRESETS else {}
    if name == "moteus.npz":
        options["sample_time"] = corpus.SAMPLE_TIME
    log = read_log(corpus.FOLDER / name, **options)
    write_record(log, tmp_path / "record.toml")
    reopened = read_log(corpus.FOLDER / name, record=tmp_path / "record.toml")
    assert (reopened.frame, reopened.names, reopened.truth) == (log.frame, log.names, log.truth)
    assert dict(reopened.conversions) == dict(log.conversions)
    assert not any("taken as" in note or "taken for" in note for note in reopened.notes)
    for batch, reopened_batch in zip(log.aligned(), reopened.aligned(), strict=True):
        np.testing.assert_array_equal(batch.voltage, reopened_batch.voltage)
        np.testing.assert_array_equal(batch.current, reopened_batch.current)
