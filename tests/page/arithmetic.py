"""Functions that use Python and NumPy like the translated modules, run in both languages.

`test_arithmetic.py` translates this file and calls each function here and in Node.js. The name of a
parameter selects its arguments: see `ARGUMENTS` there. JavaScript has one type of number and treats
whole numbers as integers; where that matters, arguments are fractions.
"""

from __future__ import annotations

import binascii
import csv
import difflib
import math
import re
from bisect import bisect_right
from collections import Counter, defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cache, cached_property, lru_cache, partial
from itertools import combinations, islice, pairwise
from numbers import Real
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.interpolate import BSpline

# ---- arrays: operators and element by element --------------------------------


def operators(pair):
    a, b = pair
    return a + b, a - b, a * b, a / b


def floor_division(pair):
    a, b = pair
    return a // b, a % b, np.mod(a, b), np.remainder(a, b)


def comparisons(pair):
    a, b = pair
    return a < b, a <= b, a > b, a >= b, a == b, a != b


def extremes(pair):
    a, b = pair
    return np.maximum(a, b), np.minimum(a, b)


def clipped(real, bounds):
    low, high = bounds
    return np.clip(real, low, high)


def squares(numbers):
    return np.square(numbers), numbers**2


def powers(pair):
    a, b = pair
    return a**b


def integer_powers(integers, few):
    return integers**few


def logic(logicals):
    a, b = logicals
    return a & b, a | b, a ^ b, ~a, ~b


def bits(integer_pair):
    a, b = integer_pair
    return a & b, a | b, a ^ b, ~a


def signs(numbers):
    return np.abs(numbers), np.sign(numbers), abs(numbers)


def sizes_of_logicals(logicals):
    a, _ = logicals
    return np.abs(a), abs(a)


def negative(numbers):
    return -numbers


def complex_operators(complex_pair):
    a, b = complex_pair
    return a + b, a - b, a == b, a != b, -a, -b


def complex_product(complex_pair):
    a, b = complex_pair
    return a * b


def complex_quotient(complex_pair):
    a, b = complex_pair
    return a / b


def complex_parts(turning):
    return turning.real, turning.imag, turning.conj(), turning.conjugate(), np.iscomplexobj(turning)


def complex_sizes(turning):
    return np.abs(turning), np.angle(turning), abs(turning)


def complex_exponential(turning):
    return np.exp(turning)


def rounded(floats):
    return np.floor(floats), np.ceil(floats)


def rounded_to(floats, digits):
    return np.round(floats, digits), np.round(floats), floats.round(digits)


def rounded_integers(integers):
    return np.round(integers), np.sign(integers)


def known(array):
    return np.isfinite(array), np.isnan(array)


def filled(floats):
    return np.nan_to_num(floats), np.nan_to_num(floats, nan=2.5)


def roots(numbers):
    return np.sqrt(numbers)


def elementary(floats):
    return (
        np.exp(floats),
        np.log(floats),
        np.log10(floats),
        np.log2(floats),
        np.sin(floats),
        np.cos(floats),
        np.degrees(floats),
        np.radians(floats),
    )


def of_two(float_pair):
    a, b = float_pair
    return np.hypot(a, b), np.arctan2(a, b)


def close(float_pair):
    a, b = float_pair
    return np.isclose(a, b, rtol=1e-3), np.isclose(a, b)


def same(pair):
    a, b = pair
    return np.array_equal(a, b)


def added_in_place(floats):
    out = floats.copy().reshape(-1)
    out += 1.5
    out *= 2
    out -= 0.25
    out /= 3
    return out


def masked_in_place(logicals):
    a, b = logicals
    out = a | b
    out &= b
    out |= a
    return out


# ---- arrays: new, and of other shapes ----------------------------------------


def arrays_of(items):
    return np.array(items), np.asarray(items), np.array(items, dtype=float)


def array_of_ragged(ragged):
    return np.array(ragged, dtype=float)


def array_of_rows(rows):
    return np.array(rows, dtype=float), np.asarray(rows, dtype=complex)


def converted(array, dtype):
    return (
        array.astype(dtype),
        np.asarray(array, dtype=dtype),
        np.array(array, dtype),
        np.ascontiguousarray(array, dtype=dtype),
    )


def truncated(moderate):
    return moderate.astype(int), moderate.astype(np.int64), moderate.astype(bool)


def like(array):
    return np.zeros_like(array), np.ones_like(array), np.full_like(array, 1)


def blank(shape, dtype):
    return np.zeros(shape, dtype=dtype), np.ones(shape, dtype), np.empty(shape, dtype).shape


def full(shape, number):
    return np.full(shape, number)


def unit(few, dtype):
    return np.eye(few, dtype=dtype)


def ranges(few, whole):
    return np.arange(few), np.arange(whole, whole + few), np.arange(few, dtype=float)


def stepped(moderate_number, few):
    return np.arange(moderate_number, moderate_number + few, 0.1)


def spaced(moderate_number, other_number, few):
    return np.linspace(moderate_number, other_number, few), np.linspace(moderate_number, 1.0)


def log_spaced(few):
    return np.logspace(-2, 3, few)


def diagonal(array):
    return np.diag(array)


def sizes(array):
    return np.shape(array), np.size(array), array.shape, array.ndim, array.size


def shaped(array):
    return array.ravel(), array.reshape(-1), array.T, array.copy(), np.atleast_1d(array)


def reshaped(reshape):
    array, shape = reshape
    return array.reshape(shape)


def turned(turn):
    array, axes = turn
    return array.transpose(*axes)


def moved(move):
    array, source, target = move
    return np.moveaxis(array, source, target)


def spread(broadcast):
    array, shape = broadcast
    return np.broadcast_to(array, shape)


def listed(array):
    array.setflags(write=True)
    return array.tolist()


def quiet(floats):
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return 1 / floats


def joined(pieces):
    arrays, axis = pieces
    return np.concatenate(arrays, axis=axis)


def stacked(equals):
    arrays, axis = equals
    return np.stack(arrays, axis=axis), np.stack(arrays)


def stacked_flat(vectors):
    return np.hstack(vectors), np.append(vectors[0], vectors[1]), np.r_[vectors[0], vectors[1], 2.5]


def stacked_rows(equal_vectors):
    return np.vstack(equal_vectors), np.hstack(equal_vectors)


def blocks(matrix):
    return np.block([[matrix, 2 * matrix], [matrix, matrix]])


def without(removal):
    array, at = removal
    return np.delete(array, at)


def repeated(repetition):
    array, times, axis = repetition
    return np.repeat(array, times, axis=axis)


def tiled(vector, few):
    return np.tile(vector, (few, 1)), np.tile(vector, few)


def split_arrays(vector, few):
    return np.array_split(vector, few)


def differences(along_axis):
    array, axis = along_axis
    return np.diff(array, axis=axis)


def differences_behind(vector, moderate_number):
    return np.diff(vector, prepend=moderate_number), np.diff(vector)


def chosen(choice):
    mask, a, b = choice
    return np.where(mask, a, b)


def nonzero(array):
    return np.flatnonzero(array)


def open_mesh(positions):
    return np.ix_(positions, positions)


def from_bytes(floats_32):
    return np.frombuffer(floats_32, "<f4").astype(float)


def kinds(array):
    return (
        np.result_type(array, float) == np.complex128,
        np.iscomplexobj(array),
        np.finfo(float).eps,
        np.dtype(array.dtype).kind,
        np.dtype(array.dtype).names,
    )


# ---- arrays: indices ---------------------------------------------------------


def indexed(selection):
    array, index = selection
    return array[index]


def sliced(vector, bounds):
    low, high = bounds
    return vector[slice(low, high)], vector[slice(None, high)]


def assigned(selection, moderate_number):
    array, index = selection
    out = array.astype(float)
    out[index] = moderate_number
    return out


def assigned_whole(selection, moderate_number):
    array, index = selection
    whole, logical = np.zeros(array.shape, int), np.zeros(array.shape, bool)
    whole[index] = moderate_number
    logical[index] = moderate_number
    return whole, logical


def assigned_rows(broadcast):
    array, shape = broadcast
    out = np.zeros(shape)
    out[...] = array
    return out


def assigned_part(selection):
    array, index = selection
    out = array.astype(float)
    out[index] = -out[index]
    out[index] += 1
    return out


def assigned_values(selection, values):
    array, index = selection
    out = array.astype(float)
    if np.shape(out[index]) != ():
        out[index] = values
    return out


def overlapping(vector):
    out = np.asarray(vector, dtype=complex)
    out[1:] = out[:-1]
    other = np.array(vector)
    other[:] = other[::-1]
    halves = np.array(vector, dtype=complex)
    halves.imag = halves.real
    halves.real += 1
    return out, other, halves


def added_at(accumulation):
    target, at, values = accumulation
    out = target.copy()
    np.add.at(out, at, values)
    np.add.at(out[::-1], at, 1)
    return out


# ---- arrays: along axes ------------------------------------------------------


def total(along):
    array, axis = along
    return np.sum(array, axis=axis), array.sum(axis)


def flat_total(run):
    return np.sum(run), run.sum(), np.mean(run)


def total_of_rows(moderate):
    out = moderate.reshape(-1, 1)
    return np.sum(out, axis=0), np.sum(out, axis=1)


def mean(along):
    array, axis = along
    return np.mean(array, axis=axis), array.mean(axis=axis, keepdims=True)


def integer_totals(integers):
    return np.sum(integers), integers.sum(), np.cumsum(integers)


def complex_totals(turning_along):
    array, axis = turning_along
    return np.sum(array, axis), np.mean(array, axis=axis), np.mean(array)


def complex_runs(turning_vector):
    return (
        np.cumsum(turning_vector),
        np.diff(turning_vector),
        np.std(turning_vector),
        np.vdot(turning_vector, turning_vector[::-1]),
        np.isfinite(turning_vector),
        np.r_[turning_vector, turning_vector.conj()],
    )


def product(factors):
    array, axis = factors
    return np.prod(array, axis=axis), np.prod(array)


def shape_product(shape):
    return np.prod(shape, dtype=int)


def largest(along):
    array, axis = along
    return (
        np.max(array, axis),
        array.max(axis=axis, keepdims=True),
        np.min(array, axis),
        array.min(axis=axis),
        array.max(axis=axis, initial=1),
    )


def spans(along_numbers):
    array, axis = along_numbers
    return np.ptp(array, axis=axis)


def truths(along):
    array, axis = along
    return np.all(array), np.any(array), array.all(axis=axis), array.any(axis)


def positions_of_extremes(along_one):
    array, axis = along_one
    return np.argmax(array), np.argmin(array), np.argmax(array, axis), np.argmin(array, axis)


def medians(filled_along):
    array, axis = filled_along
    return np.median(array), np.median(array, axis=axis), np.median(array, axis, keepdims=True)


def deviations(moderate):
    return np.std(moderate), moderate.std()


def quantiles(run, shares):
    return np.quantile(run, 0.25), np.percentile(run, 95), np.quantile(run, shares)


def of_the_known(run):
    return np.nanmax(run), np.nanmin(run), np.nanmedian(run)


def sums_of_the_known(run):
    return np.nansum(run), np.nanmean(run)


def deviation_of_the_known(moderate):
    return np.nanstd(moderate)


def running(along_one):
    array, axis = along_one
    return np.cumsum(array, axis=axis), np.cumsum(array)


def sorted_positions(run, distinct_run):
    return np.abs(run)[np.argsort(np.abs(run))], np.argsort(distinct_run)


def places(search):
    ordered, values = search
    return (
        np.searchsorted(ordered, values),
        np.searchsorted(ordered, values, side="right"),
        np.searchsorted(ordered, values, side="left"),
    )


def distinct(run):
    return np.unique(run)


def counts(counted):
    whole, weights = counted
    return np.bincount(whole), np.bincount(whole, minlength=7), np.bincount(whole, weights)


def unwrapped(angles):
    return np.unwrap(angles, axis=-1), np.unwrap(angles)


def interpolated(points):
    at, x, y = points
    return np.interp(at, x, y)


def interpolated_between(complex_points):
    at, x, y = complex_points
    return np.interp(at, x, y)


# ---- arrays: products --------------------------------------------------------


def matrix_product(factors_of_product):
    a, b = factors_of_product
    return a @ b


def integer_matrix_product(integer_factors):
    a, b = integer_factors
    return a @ b


def complex_matrix_product(matrix, other_matrix):
    return (matrix + 1j * other_matrix) @ (other_matrix - 1j * matrix)


def summed_indices(quadratic):
    x, q, y = quadratic
    return (
        np.einsum("...i,ij,...j", x, q, y),
        np.einsum("...i,...i->...", x, y),
        np.einsum("...ij,...j->...i", q, y),
        np.einsum("ij,ik->jk", q, q),
        np.einsum("ii->i", q),
    )


def summed_batches(batches):
    return (
        np.einsum("pmi,pmj->pij", batches, batches),
        np.einsum("pii->pi", batches),
        np.einsum("...i,...ij,...j->...", batches[..., 0], batches, batches[..., 1]),
    )


def products(matrix, other_matrix):
    return np.kron(matrix, other_matrix), np.trace(matrix), np.tensordot(matrix, matrix, axes=1)


def vector_products(moderate_vector):
    return np.outer(moderate_vector, moderate_vector), np.vdot(moderate_vector, moderate_vector)


def folded(moderate_vector, turning_vector, kernel):
    return (
        np.convolve(moderate_vector, kernel, mode="same"),
        np.convolve(turning_vector, kernel, mode="same"),
    )


def norms(matrix):
    return np.linalg.norm(matrix), np.linalg.norm(matrix, axis=0), np.linalg.norm(matrix, axis=-1)


def solved(matrix, other_matrix):
    vector = other_matrix[:, 0]
    both = np.stack([matrix, matrix.T])
    return (
        np.linalg.solve(matrix, other_matrix),
        np.linalg.solve(matrix, vector),
        np.linalg.inv(matrix),
        np.linalg.inv(both),
        np.linalg.solve(both, np.stack([other_matrix, matrix])),
        np.linalg.pinv(both),
        np.linalg.pinv(matrix[:2]),
        np.linalg.svd(matrix[:2])[1],
    )


def factored(matrix):
    square = matrix.T @ matrix
    r = np.linalg.qr(matrix, mode="r")
    return np.linalg.cholesky(square), r.T @ r


def spectrum(matrix):
    values, vectors = np.linalg.eigh(matrix + matrix.T)
    u, sizes, v = np.linalg.svd(matrix)
    return values, (vectors * values) @ vectors.T, sizes, (u * sizes) @ v


def least_squares(tall):
    A, b = tall
    x, _, rank, sizes = np.linalg.lstsq(A, b, rcond=None)
    cut = np.linalg.lstsq(A, b, rcond=1e-12)[0]
    return x, rank, sizes, cut, np.linalg.pinv(A), np.linalg.pinv(A, rcond=1e-10)


def deficient(tall):
    A, b = tall
    A = A[:, [0, 1, 1]]
    x, _, rank, _ = np.linalg.lstsq(A, b, rcond=1e-12)
    return x, rank, np.linalg.pinv(A, rcond=1e-12)


def singular(few):
    return np.linalg.solve(np.zeros((few + 1, few + 1)), np.ones(few + 1))


def indefinite(few):
    return np.linalg.cholesky(-np.eye(few + 1))


def transformed(moderate_vector, size):
    spectrum = np.fft.rfft(moderate_vector, size)
    rows = np.stack([spectrum.real, spectrum.imag])[:, : size // 2]
    return spectrum, np.fft.irfft(spectrum, size), np.fft.fft(rows + 1j * rows[::-1], axis=1)


def frequencies(few):
    return np.fft.fftfreq(few + 1, 0.1), np.fft.fftfreq(few + 1, 1 / (few + 1))


def splines(knots, moderate_vector):
    at = np.clip(np.abs(moderate_vector) % 1, 0, 1)
    spline = BSpline(knots, np.eye(len(knots) - 4), 3)
    return spline(at), spline.derivative(1)(at)


# ---- numbers -----------------------------------------------------------------


def number_operators(number, other):
    return (
        number + other,
        number - other,
        number * other,
        number / other,
        number < other,
        number <= other,
        number > other,
        number >= other,
        number == other,
        number != other,
        -number,
        abs(number),
    )


def number_remainders(number, other):
    return number // other, number % other


def number_powers(number, few):
    return number**few


def in_place(number, other):
    out = number
    out += other
    out -= 1.5
    out *= other
    out /= 2.5
    return out


def integer_operators(integer, nonzero_integer):
    return (
        integer + nonzero_integer,
        integer - nonzero_integer,
        integer // nonzero_integer,
        integer % nonzero_integer,
        integer & nonzero_integer,
        integer | nonzero_integer,
        integer ^ nonzero_integer,
        ~integer,
    )


def shifts(integer, few):
    return integer << few, integer >> few


def logical_operators(flag, other_flag, few):
    return flag & other_flag, flag | other_flag, flag + few, flag * few, not flag, flag == few


def constants():
    return math.pi, math.tau, math.inf, np.pi, np.inf, np.nan, np.float64(2.5)


def roots_of_numbers(number):
    return math.isfinite(number), math.sqrt(number)


def whole(number):
    return int(number)


def truth(number):
    return bool(number)


def rounded_number(float_number, digits):
    return round(float_number, digits)


def rounded_whole(float_number):
    return round(float_number)


def complex_numbers(number, other):
    z = complex(number, other)
    return z.real, z.imag, z.conjugate(), z + 1, z - 2j, -z, z == other, bool(z)


def extreme_numbers(some_numbers, number):
    return (
        max(some_numbers),
        min(some_numbers),
        max(number, some_numbers[0]),
        min(number, 0.5),
        max(some_numbers, key=abs),
        min(some_numbers, key=lambda x: x * x),
    )


def extremes_or(items):
    return max(items, default=None), min(items, default=-1)


def sums_of_numbers(some_numbers):
    return sum(some_numbers), sum(x > 0 for x in some_numbers)


def sorted_numbers(some_ordered):
    return sorted(some_ordered), sorted(some_ordered, key=abs), sorted(some_ordered, reverse=True)


def read_number(numeral):
    return float(numeral)


def read_integer(numeral):
    return int(numeral)


def read_in_base(numeral, base):
    return int(numeral, base)


def kinds_of_numbers(number, flag, text):
    return (
        isinstance(number, float | int),
        isinstance(flag, bool),
        isinstance(text, str),
        isinstance(number, Real),
        isinstance(text, (list, tuple)),
        type(text) is str,
        isinstance({}, Mapping),
        isinstance(np.zeros(1)[0], np.floating),
    )


# ---- text --------------------------------------------------------------------


def formatted(float_number, spec):
    return f"{float_number:{spec}}"


def formatted_integer(integer, integer_spec):
    return f"{integer:{integer_spec}}"


def formatted_text(text, text_spec):
    return f"{text:{text_spec}}"


def written(fraction):
    return str(fraction), repr(fraction), f"{fraction}"


def written_integer(integer):
    return str(integer), repr(integer), f"{integer:d}"


def quoted(text):
    return repr(text), f"{text!r}", str(text)


def written_items(texts, integer):
    return repr(texts), str(tuple(texts)), repr({"a": texts}), repr((integer,)), repr(None)


def inserted(text, fraction):
    return "{}, {channel} [{unit}] {{}} {:.3g}".format(text, fraction, channel=text, unit="V")


def stripped(text, marks):
    return (
        text.strip(),
        text.lstrip(),
        text.rstrip(),
        text.strip(marks),
        text.lstrip(marks),
        text.rstrip(marks),
    )


def split(text, mark, few):
    return (
        text.split(),
        text.split(mark),
        text.split(mark, few),
        text.rsplit(mark, few),
        text.rsplit(mark, 1),
        text.splitlines(),
        text.partition(mark),
        text.rpartition(mark),
    )


def split_some(text, few):
    return text.split(None, few), text.split(maxsplit=few)


def searched(text, mark, few):
    return (
        text.find(mark),
        text.rfind(mark),
        text.find(mark, few),
        text.count(mark),
        text.startswith(mark),
        text.endswith(mark),
        text.startswith(("a", mark)),
        text.endswith(("1", mark)),
        mark in text,
        text.removeprefix(mark),
        text.removesuffix(mark),
    )


def index_of_mark(text, mark):
    return text.index(mark)


def replaced(text, mark, other_text, few):
    return text.replace(mark, other_text), text.replace(mark, other_text, few)


def cases_of_letters(text):
    return text.lower(), text.upper()


def classes_of_letters(text):
    return text.isalpha(), text.isprintable()


def translated_letters(text):
    return text.translate(str.maketrans({"a": "A", "µ": "u", "-": ""}))


def connected(text, texts, few):
    return text.join(texts), text + "x", text * few, len(text), list(text), text < "b", text == "a"


def cuts_of_text(text, cut):
    return text[cut], text[::-1]


def letter(text, position):
    return text[position], ord(text[position]), chr(ord(text[position]))


def encoded(text):
    return text.encode(), text.encode("utf-8"), text.encode("utf-16-le"), text.encode().decode()


def encoded_narrow(text, encoding):
    return text.encode(encoding)


def encoded_anyhow(text, encoding):
    return text.encode(encoding, errors="replace")


def close_words(text, texts):
    return (
        difflib.get_close_matches(text, texts),
        difflib.get_close_matches(text, texts, n=1, cutoff=0.4),
    )


# ---- regular expressions -----------------------------------------------------

_NUMBER = re.compile(r"^\s*[-+]?(\d+(\.\d*)?|\.\d+)([eE][-+]?\d+)?\s*$")
_UNIT = re.compile(r"^(.*?)\s*[\[({]\s*([^\[\](){}]*)\s*[\])}]\s*(.*)$")
_WORD = re.compile(r"^(out|in|value)\w*.$", re.IGNORECASE)
_LINE = re.compile(rb"^[ \t]*[-+.0-9\xf1]", re.MULTILINE)
_END = re.compile(rb"\n +\r?\n")
_NAMED = re.compile(r"(?P<first>[a-z])(?P<rest>\d*)")


def matched(text):
    out = []
    for pattern in (_NUMBER, _UNIT, _WORD, _NAMED):
        for match in (pattern.match(text), pattern.search(text), pattern.fullmatch(text)):
            if match is not None:
                out.append((match.group(), match.groups(), match.start(), match.end(), match[1]))
    return out


def matched_by_the_package(usual):
    pattern, text = usual
    out = []
    compiled = re.compile(pattern)
    for match in (compiled.match(text), compiled.search(text)):
        if match is not None:
            out.append((match.group(), match.groups(), match.start(), match.end()))
    return out, compiled.split(text)


def matched_bytes(octets):
    out = []
    for pattern in (_LINE, _END):
        for match in (pattern.match(octets), pattern.search(octets)):
            if match is not None:
                out.append((match.start(), match.end()))
    return out


def substituted(text):
    return (
        re.sub(r"\s+", " ", text),
        re.sub(r"[^a-z0-9]", "", text),
        re.sub(r"\([^()]*\)", "", text),
        re.sub(r"\d", lambda m: m.group() + "!", text),
        re.split(r"[,;]\s*|\t", text),
        re.split(r"\s{2,}", text),
        re.search(r"\d+.", text) is None,
        _NAMED.split(text),
    )


# ---- bytes -------------------------------------------------------------------


def decoded(octets):
    return octets.decode("latin-1"), octets.decode("utf-8", errors="replace")


def decoded_strictly(octets):
    return octets.decode(), octets.decode("utf-8-sig")


def decoded_windows(octets):
    return octets.decode("cp1252", errors="replace"), octets.decode("ascii", errors="replace")


def decoded_narrow(octets, encoding):
    return octets.decode(encoding)


def decoded_wide(octets):
    return octets.decode("utf-16"), octets.decode("utf-16-le"), octets.decode("utf-16-be")


def searched_bytes(octets, octet_mark):
    return (
        octets.find(octet_mark),
        octets.find(octet_mark, 2),
        octets.rfind(octet_mark),
        octets.startswith(octet_mark),
        octets.endswith(octet_mark),
        octets.startswith((b"a", octet_mark)),
        octet_mark in octets,
        octets.removeprefix(octet_mark),
        octets.split(octet_mark),
    )


def counted_bytes(octets, octet_pair):
    return octets.count(octet_pair)


def cuts_of_bytes(octets, cut):
    return (
        octets[cut],
        octets.strip(),
        octets.rstrip(),
        octets.isalpha(),
        b", ".join([octets, octets]),
        octets + b"x",
        len(octets),
        list(octets),
        bytes(list(octets)),
        octets == b"a",
        bool(octets),
    )


def checksum(octets, few):
    return binascii.crc_hqx(octets, few)


# ---- lists, dictionaries, sets -----------------------------------------------


def lists(items, few):
    out = list(items)
    out.append(few)
    out.extend([1, 2])
    out.insert(few, "x")
    out.insert(-1, "y")
    first = out.pop(0)
    last = out.pop()
    out += [first]
    copied = out.copy()
    copied.remove(few)
    out.reverse()
    return (
        out,
        first,
        last,
        copied,
        out.count(few),
        out.index(few),
        few in out,
        out + copied,
        few * [1],
    )


def list_index(items, number):
    return items.index(number)


def list_pop(items, position):
    out = list(items)
    return out.pop(position), out


def list_cuts(items, cut):
    return items[cut], tuple(items)[cut], list(reversed(items)), len(items), items == items[::-1]


def list_item(items, position):
    return items[position]


def list_assigned(items, position):
    out = list(items)
    out[position] = "x"
    del out[0]
    return out


def list_deleted(items, short_cut):
    out = list(items)
    del out[short_cut]
    other = list(items)
    other[short_cut] = ["a", "b"]
    return out, other


def list_sorted(texts):
    out = list(texts)
    out.sort()
    other = list(texts)
    other.sort(key=len)
    return out, other, sorted(texts, key=lambda word: (len(word), word)), max(texts, key=len)


def tuples(items, others):
    return tuple(items) < tuple(others), tuple(items) == tuple(others), items <= others


def dictionaries(texts, items):
    out = dict(zip(texts, items, strict=False))
    out.setdefault("a", 1)
    out.setdefault("b")
    removed = out.pop("a"), out.pop("none", None)
    out.update({"c": 3})
    out.update(d=4)
    copied = out.copy()
    copied["e"] = 5
    merged = out | {"f": 1}
    out |= {"g": 2}
    del copied["c"]
    return (
        out,
        removed,
        copied,
        merged,
        list(out.items()),
        list(out.values()),
        list(out.keys()),
        out.get("c"),
        out.get("none", 7),
        "c" in out,
        len(out),
        out == copied,
        dict.fromkeys(texts, 0),
    )


def dictionary_item(texts, text):
    return dict.fromkeys(texts, 1)[text]


def number_keys(items, others):
    table = {(x, y): n for n, (x, y) in enumerate(zip(items, others, strict=False))}
    return list(table.values()), len(set(items)), [x in {1, 2.5, 0} for x in items]


def sets(items, others):
    a, b = set(items), set(others)
    added = set(a)
    added.add(3)
    added.update(b)
    added.discard(1)
    return (
        a,
        a & b,
        a | b,
        a - b,
        added,
        a <= b,
        a >= b,
        a.issubset(b),
        len(a),
        frozenset(b),
        a == b,
    )


def set_pop(items):
    out = set(items[:1])
    return out.pop(), len(out)


def counted_items(texts):
    counter = Counter(texts)
    return dict(counter), counter.most_common(1), counter.most_common()


def grouped(texts):
    groups = defaultdict(list)
    for word in texts:
        groups[len(word)].append(word)
    return dict(groups), list(groups.items())


# ---- loops and tools ---------------------------------------------------------


def iterated(items, texts, few):
    return (
        list(enumerate(items)),
        list(enumerate(items, 1)),
        list(zip(items, texts, strict=False)),
        list(map(str, texts)),
        list(map(lambda x, y: (x, y), items, texts)),
        list(filter(None, texts)),
        list(range(few)),
        list(range(few, 0, -2)),
        list(pairwise(items)),
        list(combinations(items, 2)),
        list(islice(items, few)),
        any(items),
        all(items),
        next(iter(items), None),
        tuple(x for x in items if x),
    )


def errors(texts, items, octets, position):
    out = []
    for text in [*texts, "1", "a"]:
        try:
            out.append({"a": 1}[text] + int(text))
        except (KeyError, NotImplementedError) as error:
            out.append(isinstance(error, ValueError))
        except ValueError:
            out.append("value")
    try:
        out.append(octets.decode() + items[position])
    except UnicodeDecodeError:
        out.append("bytes")
    except (OSError, csv.Error):
        out.append("file")
    except TypeError:
        out.append("type")
    except IndexError:
        out.append("index")
    return out


def zipped_strictly(items, texts):
    return list(zip(items, texts, strict=True))


def unpacked(items):
    first, *rest = items
    (second, third) = rest
    return first, second, third


def chained(number, some_numbers):
    return (
        0 < number <= 5,
        number in some_numbers,
        number not in some_numbers,
        number and 1,
        number or 2,
    )


def inserted_at(ordered_list, number):
    return bisect_right(ordered_list, number)


def read_lines(lines, delimiter):
    return list(csv.reader(lines, delimiter=delimiter)), list(
        csv.reader(lines, skipinitialspace=True)
    )


def read_tables(lines):
    return list(csv.DictReader(lines, skipinitialspace=True))


def paths(name, other_name):
    path = Path(name) / other_name
    return str(path), path.name, path.suffix, path.stem, str(path.parent), path == Path(str(path))


class Plain(NamedTuple):
    x: float
    y: float = 2.0


@dataclass(frozen=True)
class Record:
    x: float
    rows: list[float] = field(default_factory=list)
    hidden: float = field(default=1.0, compare=False, repr=False)
    late: float = field(init=False, default=3.0, metadata={"unit": "V"})

    @property
    def twice(self):
        return 2 * self.x

    @cached_property
    def count(self):
        return len(self.rows)

    @classmethod
    def of(cls, x):
        return cls(x, [x])

    @staticmethod
    def thrice(x):
        return 3 * x


@dataclass(frozen=True, eq=False)
class Child(Record):
    own: float = 0.0

    def __post_init__(self):
        object.__setattr__(self, "own", 2 * self.x)


@lru_cache(maxsize=4)
def _doubled(x):
    return 2 * x


@cache
def _halved(x):
    return x / 2


def classes(fraction, other_fraction):
    name = "x"
    record = Record.of(fraction)
    changed = replace(record, x=other_fraction, hidden=5.0)
    plain = Plain(fraction)._replace(y=other_fraction)
    return (
        record.twice,
        record.count,
        Record.thrice(other_fraction),
        [slot.name for slot in fields(record)],
        [slot.metadata.get("unit") for slot in fields(record)],
        changed.x,
        changed.hidden,
        record == Record(fraction, [fraction], 9.0),
        record == changed,
        issubclass(Child, Record),
        isinstance(Child(1.0), Record),
        Child(1.0) == Child(1.0),
        Child(other_fraction).own,
        getattr(record, name),
        getattr(record, "none", None),
        hasattr(record, "rows"),
        {record.x: 1}[fraction],
        plain,
        plain.x,
        plain == (fraction, other_fraction),
        partial(_added, fraction)(other_fraction),
        _doubled(fraction),
        _doubled(fraction),
        _halved(other_fraction),
    )


def _added(a, b):
    return a + b
