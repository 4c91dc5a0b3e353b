"""Draw sentences of the project at random, for a reader who judges its English.

    python tests/language/sentences.py --count 100 --seed 1

Each sentence is printed with its kind (docs, docstring, comment, message) and place. A reader who
is not the author counts the sentences that need a second reading: at most three of 100.
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
#: Folders with texts that are not for readers of this project.
EXCLUDED = ("tests/expected", "tests/logs/corpus", "tests/vectors", "web/node_modules")
#: Shorter texts are labels.
FEWEST_WORDS = 5
_END = re.compile(r"(?<=[.!?])\s+(?=[A-Z`\"(])")
#: Code, tables, headings, directives and the lists of parameters of a docstring.
_NOT_PROSE = re.compile(r"^\s*([|#>=]|```|:::|---|>>>|\.\.\. |\$ |<!--|\w[\w, *]* : )")


class Sentence(NamedTuple):
    place: str
    kind: str
    text: str


def split(text: str) -> list[str]:
    """Return the sentences of a text whose paragraphs are separated by empty lines."""
    sentences = []
    for paragraph in re.split(r"\n\s*\n", text):
        lines = [line for line in paragraph.splitlines() if not _NOT_PROSE.match(line)]
        joined = " ".join(re.sub(r"^\s*([-*]|\d+\.)\s+", "", line).strip() for line in lines)
        sentences += [text for text in _END.split(joined) if len(text.split()) >= FEWEST_WORDS]
    return sentences


def read_markdown(text: str) -> Iterator[tuple[int, str, str]]:
    """Yield the paragraphs outside code, each with its line and kind."""
    text = re.sub(
        r"\A---\n.*?^---$", lambda head: "\n" * head[0].count("\n"), text, flags=re.M | re.S
    )
    text = re.sub(r"^```.*?^```$", lambda code: "\n" * code[0].count("\n"), text, flags=re.M | re.S)
    for paragraph in re.finditer(r"(?:^(?! {4}).*\S.*\n)+", text + "\n", flags=re.MULTILINE):
        yield text[: paragraph.start()].count("\n") + 1, "docs", paragraph[0]


def read_python(text: str) -> Iterator[tuple[int, str, str]]:
    """Yield docstrings, comments, and other strings, which are messages."""
    nodes = list(ast.walk(ast.parse(text)))
    formatted = [node for node in nodes if isinstance(node, ast.JoinedStr)]
    not_messages = {id(value) for node in formatted for value in node.values}
    for node in nodes:
        if not isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            continue
        if prose := ast.get_docstring(node):
            not_messages.add(id(node.body[0].value))  # type: ignore[attr-defined]
            yield node.body[0].lineno, "docstring", prose
    for node in formatted:
        pieces = (value.value if isinstance(value, ast.Constant) else "…" for value in node.values)
        yield node.lineno, "message", "".join(map(str, pieces))
    for node in nodes:
        if not isinstance(node, ast.Constant) or id(node) in not_messages:
            continue
        if isinstance(node.value, str) and "\n" not in node.value:
            yield node.lineno, "message", node.value
    yield from _comments(text)


def _comments(text: str) -> Iterator[tuple[int, str, str]]:
    """Yield the comments; consecutive lines are one comment."""
    start, end, lines = 0, 0, [""]
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type != tokenize.COMMENT or re.match(r"# (noqa|type:|mypy)", token.string):
            continue
        comment = token.string.lstrip("#: ")
        if token.start[0] == end + 1:
            lines.append(comment)
        else:
            yield start, "comment", "\n".join(lines)
            start, lines = token.start[0], [comment]
        end = token.start[0]
    yield start, "comment", "\n".join(lines)


def read_c(text: str) -> Iterator[tuple[int, str, str]]:
    for match in re.finditer(r"/\*(.*?)\*/|//([^\n]*)", text, re.DOTALL):
        prose = re.sub(r"^\s*\* ?", "", match[1] or match[2] or "", flags=re.MULTILINE)
        yield text[: match.start()].count("\n") + 1, "comment", prose


READERS = {
    ".md": read_markdown,
    ".py": read_python,
    ".c": read_c,
    ".h": read_c,
    ".hpp": read_c,
    ".cpp": read_c,
}


def read_project() -> list[Sentence]:
    """Return all sentences of the project."""
    listed = subprocess.check_output(["git", "ls-files"], cwd=ROOT, text=True)
    sentences = []
    for name in listed.splitlines():
        path = ROOT / name
        if path.suffix not in READERS or name.startswith(EXCLUDED) or not path.exists():
            continue
        for line, kind, text in READERS[path.suffix](path.read_text("utf-8")):
            sentences += [Sentence(f"{name}:{line}", kind, sentence) for sentence in split(text)]
    return sentences


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kind", choices=["docs", "docstring", "comment", "message"])
    parser.add_argument("--under", default="", help="only files whose path starts with this")
    options = parser.parse_args()
    sentences = [
        sentence
        for sentence in read_project()
        if options.kind in (None, sentence.kind) and sentence.place.startswith(options.under)
    ]
    sample = random.Random(options.seed).sample(sentences, min(options.count, len(sentences)))
    for number, sentence in enumerate(sample, 1):
        print(f"{number:3d}. [{sentence.kind}] {sentence.text}\n     {sentence.place}")
    print(f"{len(sample)} of {len(sentences)} sentences")


if __name__ == "__main__":
    main()
