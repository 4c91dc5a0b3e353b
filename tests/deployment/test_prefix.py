"""A prefix never collides with a file, name or include guard of the library."""

import subprocess

import pytest

import fluxobs
from fluxobs import FluxobsError
from fluxobs.deployment.folder import joined
from fluxobs.deployment.settings import check_prefix
from support.firmware import STRICT

#: Parts of the library's file names and include guards that a prefix could repeat.
LIKE_THE_LIBRARY = [
    *("ADAPTIVE", "REAL", "SEED", "KEEP", "CONFIG", "RETUNE", "MAP", "INTERNAL"),
    *("adaptive", "map", "telemetry", "unit", "focus"),
]


@pytest.mark.parametrize(
    ("prefix", "unknowns"),
    [
        pytest.param(p, unknowns, marks=() if k < 4 and k % 2 == m else pytest.mark.slow)
        for k, p in enumerate(LIKE_THE_LIBRARY)
        for m, unknowns in enumerate(("drift", "auto"))
    ],
)
def test_a_prefix_that_resembles_the_library_compiles(tmp_path, prefix, unknowns):
    """All headers compile together with the machine's sources and a flux map."""
    folder = tmp_path / "motor"
    fluxobs.export("ipm-5kw6", 1e-4, folder, unknowns=unknowns, prefix=prefix)
    headers = [path.name for path in (*folder.glob("*.h"), *folder.glob("runtime/*.h"))]
    every = tmp_path / "every.c"
    every.write_text("".join(f'#include "{name}"\n' for name in sorted(headers)))
    uses = tmp_path / "uses.c"
    uses.write_text(
        f'#include "{prefix}_config.h"\n#include "{prefix}_observer.h"\n'
        f"int main(void) {{ return {prefix}_config.sample_time > 0 && &{prefix}_observer; }}\n"
    )
    sources = [every, uses, folder / f"{prefix}_observer.c", folder / f"runtime/{prefix}_config.c"]
    flags = [*STRICT, "-Wno-address", f"-I{folder}", f"-I{folder}/runtime"]
    subprocess.run(["gcc", *flags, "-fsyntax-only", *sources], check=True)


@pytest.mark.parametrize(
    "prefix", ["fo", "FO", "fo_adaptive", "fo_use", "Fo_map", "fluxobs", "FLUXOBS", "fluxobs_seed"]
)
def test_the_library_s_own_prefixes_are_refused(tmp_path, prefix):
    with pytest.raises(FluxobsError, match=f"prefix '{prefix}' cannot.*use 'motor'"):
        fluxobs.export("ipm-5kw6", 1e-4, tmp_path / "motor", unknowns="auto", prefix=prefix)
    assert not (tmp_path / "motor").exists()


@pytest.mark.parametrize(
    ("prefix", "reason"),
    [
        *((word, "it is a keyword") for word in ("int", "while", "class", "xor", "char8_t")),
        *((word, "it is a keyword") for word in ("constexpr", "fn", "Self", "yield", "typeof")),
        *((word, "two underscores") for word in ("a__b", "axis_")),
        *((word, "must be a letter, then") for word in ("_Motor", "__axis", "1st", "", "é")),
        *((word, "device of Windows") for word in ("con", "NUL", "com1")),
    ],
)
def test_reserved_names_are_refused(tmp_path, prefix, reason):
    with pytest.raises(FluxobsError, match=f"^prefix '{prefix}' cannot begin .* {reason}") as error:
        fluxobs.export("servo-400w", 1e-4, tmp_path / "motor", prefix=prefix, unknowns="drift")
    assert not (tmp_path / "motor").exists()
    nearest = str(error.value).split("'")[-2]
    check_prefix(nearest)


@pytest.mark.parametrize("prefix", ["Int", "main", "errno", "final_drive", "console", "a" * 40])
def test_names_that_resemble_reserved_ones_are_accepted(prefix):
    check_prefix(prefix)


def test_the_proposed_prefix_is_accepted(tmp_path):
    with pytest.raises(FluxobsError, match="use 'motor'"):
        fluxobs.export(
            "servo-400w", 1e-4, tmp_path / "motor", prefix="fluxobs-axis", unknowns="drift"
        )


def test_two_files_with_the_same_name_are_refused():
    assert joined({"a": "1"}, {"b": b"2"}) == {"a": "1", "b": b"2"}
    with pytest.raises(FluxobsError, match="two files have this name"):
        joined({"a": "1"}, {"A": "2"})
