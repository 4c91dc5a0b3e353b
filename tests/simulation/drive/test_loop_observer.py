"""The observer in the loop of a simulation equals the compiled observer, bit for bit."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fluxobs import AdaptiveObserver, LeastSquaresObserver
from fluxobs.machines import example
from fluxobs.simulation.drive.loop_observer import LoopObserver
from support.records import CURRENTS, MACHINES, steady

H, SPEED = 1e-4, 500.0
BINDING = Path(__file__).parents[3] / "binding"


def record(name, rows=600):
    machine = MACHINES[name]
    rated = machine.rated_current
    return steady(
        machine, H, SPEED, rows, i_dq=CURRENTS[name], current_bias=0.02 * rated, noise=0.003 * rated
    )


def assert_same_bits(compiled, voltage, current):
    in_loop = LoopObserver.of(compiled).run(voltage, current)
    outside = compiled.run(voltage, current)
    for name, values in vars(in_loop).items():
        np.testing.assert_array_equal(values, getattr(outside, name), err_msg=name)
    return outside


@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("kind", [LeastSquaresObserver, AdaptiveObserver])
def test_a_record_with_bad_samples_has_the_same_bits(kind, precision):
    machine, data = MACHINES["servo-400w"], record("servo-400w")
    voltage, current = data.voltage.copy(), data.current.copy()
    current[300, 1], current[400, 0], voltage[450:460] = np.nan, 1e6, np.nan
    compiled = kind.for_machine(machine, sample_time=H, precision=precision)
    estimate = assert_same_bits(compiled, voltage, current)
    # the bad samples keep the adaptive observer from half a turn without a gap
    assert estimate.valid.any() or kind is AdaptiveObserver


def test_a_flux_map_has_the_same_bits():
    machine = example("synrm-6kw7-saturated")
    compiled = LeastSquaresObserver.for_machine(machine, sample_time=H)
    rng = np.random.default_rng(1)
    angle = SPEED * H * np.arange(400)
    turning = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    current = machine.rated_current * turning + rng.normal(0, 0.01, (400, 2))
    assert_same_bits(compiled, 100 * turning[:, ::-1], current)


def test_batches_of_observers_and_of_samples():
    """In nested batches, parameters, states and samples can each have lanes or no lanes."""
    data = record("servo-400w", 50)
    machine = MACHINES["servo-400w"]
    compiled = [
        LeastSquaresObserver.for_machine(machine, sample_time=H, memory=memory)
        for memory in (0.02, 0.03, 0.05)
    ]
    observers = jax.tree.map(lambda *leaves: jnp.stack(leaves), *map(LoopObserver.of, compiled))
    voltage, current = jnp.asarray(data.voltage), jnp.asarray(data.current)

    def run(observer, scale):
        def body(state, row):
            state, reading = observer.step(state, row[0], scale * row[1])
            return state, reading.flux

        return jax.lax.scan(body, observer.init(), (voltage, current))[1]

    scales = jnp.array([1.0, 0.9])
    each_scale = jax.vmap(run, in_axes=(None, 0))
    flux = jax.jit(jax.vmap(each_scale, in_axes=(0, None)))(observers, scales)
    for k, observer in enumerate(compiled):
        for n, scale in enumerate(scales):
            alone = observer.run(data.voltage, float(scale) * data.current)
            np.testing.assert_array_equal(flux[k, n], alone.flux)


def test_another_state_is_refused():
    machine = MACHINES["servo-400w"]
    plain = LoopObserver.of(LeastSquaresObserver.for_machine(machine, sample_time=H))
    adaptive = LoopObserver.of(AdaptiveObserver.for_machine(machine, sample_time=H))
    with pytest.raises(Exception, match="an argument is of another version or precision"):
        plain.step(adaptive.init(), jnp.zeros(2), jnp.zeros(2))
    mixed = replace(plain, parameters=plain.parameters.at[0].add(1))
    with pytest.raises(Exception, match="the parameters are of another version or precision"):
        mixed.step(plain.init(), jnp.zeros(2), jnp.zeros(2))


STRUCTS = {
    "Extension": ("XLA_FFI_Extension_Base", ["struct_size", "type", "next"]),
    "Version": ("XLA_FFI_Api_Version", ["major_version", "minor_version"]),
    "Metadata": ("XLA_FFI_Metadata", ["api_version", "traits"]),
    "MetadataExtension": ("XLA_FFI_Metadata_Extension", ["extension_base", "metadata"]),
    "ErrorArguments": ("XLA_FFI_Error_Create_Args", ["message", "errc"]),
    "Buffer": ("XLA_FFI_Buffer", ["dtype", "data", "rank", "dims"]),
    "CallFrame": ("XLA_FFI_CallFrame", ["api", "ctx", "stage", "args", "rets"]),
}


def test_the_declared_interface_is_that_of_jaxlib(tmp_path):
    compiler = shutil.which("c++") or shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        pytest.skip("needs a C++ compiler")
    lines = ["#include <cstddef>", "#include <xla/ffi/api/c_api.h>", '#include "xla_interface.h"']

    def same(ours, theirs):
        lines.append(f'static_assert({ours} == {theirs}, "{theirs}");')

    for ours, (theirs, fields) in STRUCTS.items():
        for field in fields:
            same(f"offsetof(xla::{ours}, {field})", f"offsetof({theirs}, {field})")
    for theirs, items in (("XLA_FFI_Args", "args"), ("XLA_FFI_Rets", "rets")):
        same("offsetof(xla::Buffers, items)", f"offsetof({theirs}, {items})")
        same("offsetof(xla::Buffers, size)", f"offsetof({theirs}, size)")
    same("sizeof(xla::Buffers)", "sizeof(XLA_FFI_Args)")
    same("offsetof(xla::Api, api_version)", "offsetof(XLA_FFI_Api, api_version)")
    same("offsetof(xla::Api, error_create)", "offsetof(XLA_FFI_Api, XLA_FFI_Error_Create)")
    same("(int)xla::METADATA", "(int)XLA_FFI_Extension_Metadata")
    same("(int)xla::INVALID_ARGUMENT", "(int)XLA_FFI_Error_Code_INVALID_ARGUMENT")
    same("(int)xla::U8", "(int)XLA_FFI_DataType_U8")
    same("(int)xla::F64", "(int)XLA_FFI_DataType_F64")
    same("(int)xla::VERSION_MAJOR", "XLA_FFI_API_MAJOR")
    source = tmp_path / "interface.cpp"
    source.write_text("\n".join(lines) + "\n")
    command = [compiler, "-std=c++17", "-fsyntax-only", "-Wno-invalid-offsetof"]
    command += ["-I", jax.ffi.include_dir(), "-I", str(BINDING), str(source)]
    found = subprocess.run(command, capture_output=True, text=True)
    assert found.returncode == 0, found.stderr
