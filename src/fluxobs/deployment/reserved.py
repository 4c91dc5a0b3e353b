"""Reserved words of the languages of an export, and names that Windows reserves."""

from __future__ import annotations

import re

#: C up to C23. Keywords with a leading underscore are missing, because every prefix must begin with
#: a letter.
_C = """
alignas alignof asm auto bool break case char const constexpr continue default do double else enum
extern false float for goto if inline int long nullptr register restrict return short signed sizeof
static static_assert struct switch thread_local true typedef typeof typeof_unqual union unsigned
void volatile while
"""
#: Keywords of C++ up to C++23 that are not in C, with alternative spellings of operators.
_CPP = """
and and_eq bitand bitor catch char8_t char16_t char32_t class co_await co_return co_yield compl
concept const_cast consteval constinit decltype delete dynamic_cast explicit export friend mutable
namespace new noexcept not not_eq operator or or_eq private protected public reinterpret_cast
requires static_cast template this throw try typeid typename using virtual wchar_t xor xor_eq
"""
#: Further keywords of Rust, some reserved for future use (The Rust Reference, Keywords).
_RUST = """
Self abstract as async await become box crate dyn final fn gen impl in let loop macro match mod move
mut override priv pub ref self super trait type unsafe unsized use where yield
"""
KEYWORDS = frozenset((_C + _CPP + _RUST).split())
#: Device names of Windows, with any file extension.
_DEVICE = re.compile(r"con|prn|aux|nul|com\d|lpt\d", re.IGNORECASE)


def why_refused(prefix: str) -> str | None:
    """Return why names and files of an export cannot begin with a prefix; None if they can.

    Examples
    --------
    >>> why_refused("int"), why_refused("motor")
    ('it is a keyword of C, C++ or Rust', None)
    """
    if re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,39}", prefix) is None:
        return "it must be a letter, then up to 39 letters, digits and underscores"
    if re.match(r"fo(_|$)|fluxobs", prefix, re.IGNORECASE):  # some file systems ignore case
        return "it is the beginning of names in the library"
    if prefix in KEYWORDS:
        return "it is a keyword of C, C++ or Rust"
    if "__" in f"{prefix}_":
        return "C++ reserves names with two underscores in a row"
    if _DEVICE.fullmatch(prefix):
        return "it is a device of Windows, where files cannot have this name"
    return None
