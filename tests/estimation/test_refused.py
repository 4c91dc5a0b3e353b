"""The message on unsuitable input names the place, the value and acceptable input."""

import numpy as np
import pytest

import fluxobs
from fluxobs import (
    FluxobsError,
    LeastSquaresObserver,
    MachineError,
    ObserverError,
    Record,
    RecordError,
    UsageError,
)
from support.records import SERVO, log_columns, steady

H, ROWS = 1e-4, 1500
SAMPLES = steady(SERVO, H, 500.0, ROWS, 6j, 0.15 - 0.1j, -0.1 + 0.05j, 0.02)
COLUMNS = log_columns(SAMPLES)
U = np.stack([COLUMNS["u_alpha"], COLUMNS["u_beta"]], axis=1)
I = np.stack([COLUMNS["i_alpha"], COLUMNS["i_beta"]], axis=1)  # noqa: E741
MAGLEV = fluxobs.example("maglev-knospe")


def for_machine(machine):
    return LeastSquaresObserver.for_machine(machine, sample_time=H)


REFUSED = {
    "rows of four": (
        lambda: fluxobs.estimate((np.zeros((50, 4)), I), SERVO, sample_time=H),
        RecordError,
        [r"voltage must have shape (rows, 2)", "(50, 4)"],
    ),
    "flat currents": (
        lambda: fluxobs.estimate((U, I[:, 0]), SERVO, sample_time=H),
        RecordError,
        ["current must have shape (rows, 2)", "complex"],
    ),
    "rows that differ": (
        lambda: fluxobs.estimate((U, I[:-1]), SERVO, sample_time=H),
        RecordError,
        ["same number of rows", "1500 and 1499"],
    ),
    "a column too short": (
        lambda: fluxobs.estimate(COLUMNS | {"i_beta": I[:10, 1]}, SERVO),
        RecordError,
        ["differ in length", "i_beta 10"],
    ),
    "a column of words": (
        lambda: fluxobs.estimate(COLUMNS | {"i_beta": ["x"] * ROWS}, SERVO),
        RecordError,
        ["'i_beta'", "numbers"],
    ),
    "a matrix as a column": (
        lambda: fluxobs.estimate(COLUMNS | {"i_beta": I}, SERVO),
        RecordError,
        ["'i_beta'", "(rows,)", "(1500, 2)"],
    ),
    "a channel that is missing": (
        lambda: fluxobs.estimate({"t": COLUMNS["t"], "u_alpha": U[:, 0]}, SERVO),
        RecordError,
        ["no column 'u_beta'"],
    ),
    "a frame for a pair": (
        lambda: fluxobs.estimate((U, I), SERVO, sample_time=H, frame="dq"),
        UsageError,
        ["frame 'dq'", "mapping of channels"],
    ),
    "no such file": (
        lambda: fluxobs.estimate("none.csv", SERVO),
        RecordError,
        ["none.csv: no such file"],
    ),
    "a frame of an opened log": (
        lambda: fluxobs.estimate(fluxobs.read_log(COLUMNS), SERVO, frame="abc"),
        UsageError,
        ["already open", "read_log"],
    ),
    "a layout of a record": (
        lambda: fluxobs.estimate(Record(H, U, I), SERVO, lag=-1),
        UsageError,
        ["lag", "for a Record"],
    ),
    "a truth that is not a channel": (
        lambda: fluxobs.estimate(COLUMNS, SERVO, truth={"angle": "t"}),
        RecordError,
        ["truth must be one of theta_e, theta_mech, position", "'angle'"],
    ),
    "a truth that is not a column": (
        lambda: fluxobs.estimate(COLUMNS, SERVO, truth={"theta_e": "angle"}),
        RecordError,
        ["no column 'angle'"],
    ),
    "two truths": (
        lambda: fluxobs.estimate(COLUMNS, SERVO, truth={"theta_e": "t", "theta_mech": "t"}),
        RecordError,
        ["one channel only"],
    ),
    "a frame of another kind": (
        lambda: fluxobs.estimate(COLUMNS, SERVO, frame="ports"),
        RecordError,
        ["frame 'ports' does not fit kind surface-pmsm"],
    ),
    "a number as a machine": (
        lambda: fluxobs.estimate(COLUMNS, 5),
        MachineError,
        ["expected a machine", "servo-400w", "int"],
    ),
    "an unknown machine name": (
        lambda: fluxobs.estimate(COLUMNS, "servo-400"),
        MachineError,
        ["no such machine file", "did you mean 'servo-400w'"],
    ),
    "a dict for an observer": (
        lambda: for_machine({"kind": "surface-pmsm"}),
        MachineError,
        ["LeastSquaresObserver needs a machine, got dict"],
    ),
    "a levitation for an observer": (
        lambda: for_machine(MAGLEV),
        MachineError,
        ["maglev-2dof", "LeastSquaresObserver is for machines that turn"],
    ),
    "a levitation to check": (
        lambda: fluxobs.check(COLUMNS, "maglev-knospe"),
        MachineError,
        ["is for machines that turn"],
    ),
    "a levitation to compare": (
        lambda: fluxobs.compare(COLUMNS, "maglev-knospe", truth={"theta_e": "t"}),
        MachineError,
        ["the comparison is for machines that turn"],
    ),
    "resistance of a levitation": (
        lambda: fluxobs.estimate((U, I), MAGLEV, sample_time=H, unknowns="drift,resistance"),
        FluxobsError,
        ["maglev-2dof", "that turn"],
    ),
    "an unknown prior": (
        lambda: fluxobs.estimate(
            COLUMNS, SERVO, unknowns=("drift", "resistance"), priors={"R_s": 1.0}
        ),
        FluxobsError,
        ["prior: unknown 'R_s'"],
    ),
    "a memory of one sample": (
        lambda: fluxobs.estimate(COLUMNS, SERVO, memory=1e-4),
        ObserverError,
        ["too short: give at least ten samples, 0.001 s"],
    ),
    "a comparison without a truth": (
        lambda: fluxobs.compare(COLUMNS, SERVO),
        RecordError,
        ["no true angle", "truth="],
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_unsuitable_input_is_refused(case, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    call, kind, fragments = REFUSED[case]
    with pytest.raises(kind) as caught:
        call()
    assert isinstance(caught.value, FluxobsError)
    assert isinstance(caught.value, TypeError) is (kind is UsageError)
    for fragment in fragments:
        assert fragment in str(caught.value)
    assert not list(tmp_path.iterdir())
