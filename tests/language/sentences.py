"""Draws sentences of the project at random, for a reader who judges its English.

    python tests/language/sentences.py --count 100 --seed 1

Each line has the place, the kind (docs, docstring, comment, message) and the sentence. A reader who
did not write them marks those that need a second reading; at most three of 100 may.
"""

from __future__ import annotations

import argparse
import ast
import io
import random
import re
import subprocess
import tokenize
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
#: Folders whose texts nobody writes for readers of this project.
LEFT_OUT = ("tests/expected", "tests/logs/corpus", "tests/vectors", "web/node_modules")
#: Shorter ones are labels.
FEWEST_WORDS = 5
_END = re.compile(r"(?<=[.!?])\s+(?=[A-Z`\"(])")
#: Code, tables, headings, directives and the lists of parameters of a docstring.
_NO_PROSE = re.compile(r"^\s*([|#>=]|```|:::|---|>>>|\.\.\. |\$ |<!--|\w[\w, *]* : )")


class Sentence(NamedTuple):
    place: str
    kind: str
    text: str


def split(text: str) -> list[str]:
    """Sentences of a text whose paragraphs are separated by empty lines."""
    found = []
    for paragraph in re.split(r"\n\s*\n", text):
        lines = [line for line in paragraph.splitlines() if not _NO_PROSE.match(line)]
        joined = " ".join(re.sub(r"^\s*([-*]|\d+\.)\s+", "", line).strip() for line in lines)
        found += [one for one in _END.split(joined) if len(one.split()) >= FEWEST_WORDS]
    return found


def of_markdown(text: str) -> Iterator[tuple[int, str, str]]:
    """Paragraphs outside code, each with its line and kind."""
    text = re.sub(r"^```.*?^```$", lambda code: "\n" * code[0].count("\n"), text, flags=re.M | re.S)
    for paragraph in re.finditer(r"(?:^(?! {4}).*\S.*\n)+", text + "\n", flags=re.MULTILINE):
        yield text[: paragraph.start()].count("\n") + 1, "docs", paragraph[0]


def of_python(text: str) -> Iterator[tuple[int, str, str]]:
    """Docstrings, comments, and strings of several words, which are messages."""
    nodes = list(ast.walk(ast.parse(text)))
    formatted = [node for node in nodes if isinstance(node, ast.JoinedStr)]
    no_message = {id(part) for node in formatted for part in node.values}
    for node in nodes:
        if not isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            continue
        if prose := ast.get_docstring(node):
            no_message.add(id(node.body[0].value))  # type: ignore[attr-defined]
            yield node.body[0].lineno, "docstring", prose
    for node in formatted:
        parts = (part.value if isinstance(part, ast.Constant) else "…" for part in node.values)
        yield node.lineno, "message", "".join(map(str, parts))
    for node in nodes:
        if not isinstance(node, ast.Constant) or id(node) in no_message:
            continue
        if isinstance(node.value, str) and "\n" not in node.value:
            yield node.lineno, "message", node.value
    yield from _comments(text)


def _comments(text: str) -> Iterator[tuple[int, str, str]]:
    """Comments; lines that follow one another are one."""
    first, last, words = 0, 0, [""]
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type != tokenize.COMMENT or re.match(r"# (noqa|type:|mypy)", token.string):
            continue
        comment = token.string.lstrip("#: ")
        if token.start[0] == last + 1:
            words.append(comment)
        else:
            yield first, "comment", "\n".join(words)
            first, words = token.start[0], [comment]
        last = token.start[0]
    yield first, "comment", "\n".join(words)


def of_c(text: str) -> Iterator[tuple[int, str, str]]:
    for match in re.finditer(r"/\*(.*?)\*/|//(.*)", text, re.DOTALL):
        prose = re.sub(r"^\s*\* ?", "", match[1] or match[2] or "", flags=re.MULTILINE)
        yield text[: match.start()].count("\n") + 1, "comment", prose


READERS = {".md": of_markdown, ".py": of_python, ".c": of_c, ".h": of_c, ".hpp": of_c}


def sentences() -> list[Sentence]:
    """All of the project."""
    listed = subprocess.check_output(["git", "ls-files"], cwd=ROOT, text=True)
    found = []
    for name in listed.splitlines():
        path = ROOT / name
        if path.suffix not in READERS or name.startswith(LEFT_OUT) or not path.exists():
            continue
        for line, kind, text in READERS[path.suffix](path.read_text("utf-8")):
            found += [Sentence(f"{name}:{line}", kind, one) for one in split(text)]
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kind", choices=["docs", "docstring", "comment", "message"])
    parser.add_argument("--under", default="", help="only files whose path begins so")
    options = parser.parse_args()
    drawn = [one for one in sentences() if options.kind in (None, one.kind)]
    drawn = [one for one in drawn if one.place.startswith(options.under)]
    chosen = random.Random(options.seed).sample(drawn, min(options.count, len(drawn)))
    for number, one in enumerate(chosen, 1):
        print(f"{number:3d}. [{one.kind}] {one.text}\n     {one.place}")
    print(f"{len(chosen)} of {len(drawn)} sentences")


if __name__ == "__main__":
    main()
