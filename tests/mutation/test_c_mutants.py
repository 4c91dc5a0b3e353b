"""One-line errors in C are at the stated places, and are reverted."""

import contextlib
import os
import signal

import pytest

from mutation import c_mutants

HEADER = """\
#define LIMITS(X) X(LOW, 1e-4F) \\
                  X(HIGH, .5)
#define MASK 0x10U
#define HUGE 1e30
"""
SOURCE = """\
#include "limits_of.h"
#include <stdbool.h>
#define VALUE(name, value) value,
static const double limits[] = {LIMITS(VALUE)};
bool above(double x, unsigned n, const char letters[8])
{
    const bool high = x > limits[1];
    char first;
    first = *letters;
    return high && !(n == MASK);
}
"""


@pytest.fixture
def mutants(tmp_path, monkeypatch):
    (tmp_path / "limits_of.h").write_text(HEADER)
    (tmp_path / "source.c").write_text(SOURCE)
    monkeypatch.setattr(c_mutants, "FIRMWARE", tmp_path)
    monkeypatch.setattr(c_mutants, "install", lambda: None)
    return c_mutants.c_mutants()


def test_every_error_is_at_its_stated_place(mutants):
    changes = {f"{mutant.path.name}:{mutant.line} {mutant.name}" for mutant in mutants}
    assert changes == {
        "limits_of.h:1 1e-4F -> 1.0001F",
        "limits_of.h:1 1e-4F -> (-0.9999F)",
        "limits_of.h:2 .5 -> 1.5",
        "limits_of.h:2 .5 -> (-0.5)",
        "limits_of.h:3 0x10U -> 17U",
        "limits_of.h:3 0x10U -> 15U",
        "source.c:7 > -> >=",
        "source.c:7 > -> <",
        "source.c:7 1 -> 2",
        "source.c:7 1 -> 0",
        "source.c:10 && -> ||",
        "source.c:10 ! -> nothing",
        "source.c:10 == -> !=",
    }
    for mutant in mutants:
        original = mutant.path.read_bytes()
        assert original[mutant.start : mutant.end].decode() == mutant.name.split(" -> ")[0]


def test_an_interrupt_reverts_the_error(mutants):
    for mutant in mutants:
        original = mutant.path.read_bytes()
        with contextlib.suppress(KeyboardInterrupt), mutant.applied():
            assert mutant.path.read_bytes() != original
            raise KeyboardInterrupt
        assert mutant.path.read_bytes() == original


def test_an_interrupt_waits_until_the_sources_are_compiled_again(mutants, monkeypatch):
    installed = []

    def install():
        if installed:
            os.kill(os.getpid(), signal.SIGINT)
        installed.append(mutants[0].path.read_bytes())

    monkeypatch.setattr(c_mutants, "install", install)
    original = mutants[0].path.read_bytes()
    # Background jobs of a shell ignore SIGINT.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt), mutants[0].applied():
            pass
    finally:
        signal.signal(signal.SIGINT, before)
    assert installed[1:] == [original]


def test_a_source_that_clang_cannot_parse_is_reported(mutants, tmp_path):
    (tmp_path / "source.c").write_text("unknown f(void);")
    with pytest.raises(ValueError, match="unknown"):
        c_mutants.c_mutants()
