# SPDX-License-Identifier: MIT
"""Check the words of the pages and the names of the package: a step of `make lint`.

Pages have short sentences and use the terms of the glossary. Names are nouns of the field. Each
problem is a line ``file:line: problem``.

Run: python tools/words.py
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LONGEST_SENTENCE = 30
"""Number of words."""
LONGEST_README = 120
"""Number of lines."""
BANNED_WORDS = re.compile(
    r"\bpromis|first guess|synthetic streets?\b|\bleft out\b|\banew\b|\bbeside\b|one's own"
    r"|\b(those|that) which\b|\b(those|that) of (those|that|what|which)\b"
    r"|(?<!there )\b(is|are) no\b|^Of \w+ (classes|points|scans) \w+ (is|are)\b",
    re.IGNORECASE,
)
"""Words of pages that the vocabulary of the project replaces."""
VAGUE_NAMES = {
    "anew", "each", "found", "given", "kept", "known", "left_out", "own", "said", "some", "these",
    "those", "told", "usual", "wanted", "what"
}  # fmt: skip
BANNED_NAMES = re.compile("promis|guess|anew|_own_?$|^of_")
"""Parts of names that the documentation has a standard term for, and names that lack their noun."""
VAGUE_MODULES = {"common", "helper", "helpers", "misc", "tools", "util", "utils"}
CODE_BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", re.MULTILINE | re.DOTALL)
COMMENT_OR_TARGET = re.compile(r"<!--.*?-->|\]\([^)]*\)", re.DOTALL)
CODE_SPAN = re.compile(r"`([^`\n]*)`")
SENTENCE_END = re.compile(r"\n\s*\n|\||\n(?=\s*(?:[-#>]|\d+\.) )|(?<=[.!?:;])\s")
REMOVED_LINE = "\v"
"""Space in the place of a removed end of a line, so that lines keep their numbers."""
LISTED_NAMES = re.compile(r"^(Shared options|Usage): .*$", re.MULTILINE)
"""Lines of the command reference that are no sentences."""


@dataclass(frozen=True, kw_only=True)
class Problem:
    """A place that breaks a rule."""

    path: Path
    line: int
    text: str

    def __str__(self) -> str:
        return f"{self.path.relative_to(ROOT)}:{self.line}: {self.text}"


@dataclass(frozen=True, kw_only=True)
class Sentence:
    """Sentence of a page, and the line that it begins in."""

    line: int
    text: str


def main() -> int:
    """Print all problems; return 1 if there are any."""
    problems = list(all_problems())
    for problem in problems:
        print(problem)
    return 1 if problems else 0


def all_problems() -> Iterator[Problem]:
    """Yield the problems of all pages and modules."""
    readme = ROOT / "README.md"
    others = (ROOT / "CONTRIBUTING.md", ROOT / "benchmarks/README.md")
    for page in (readme, *others, *sorted((ROOT / "docs").rglob("*.md"))):
        yield from problems_of_page(page)
    lines = len(readme.read_text("utf-8").splitlines())
    if lines > LONGEST_README:
        text = f"{lines} lines instead of at most {LONGEST_README}"
        yield Problem(path=readme, line=lines, text=text)
    for module in sorted((ROOT / "salsanext_cli").rglob("*.py")):
        yield from problems_of_names(module)


def problems_of_page(page: Path) -> Iterator[Problem]:
    """Yield the sentences of a page that are too long or have a banned word."""
    for sentence in sentences(page.read_text("utf-8")):
        count = len(sentence.text.split())
        if count > LONGEST_SENTENCE:
            text = f"{count} words instead of at most {LONGEST_SENTENCE}: {sentence.text}"
            yield Problem(path=page, line=sentence.line, text=text)
        if banned := BANNED_WORDS.search(sentence.text):
            text = f'"{banned[0]}" is not in the vocabulary: {sentence.text}'
            yield Problem(path=page, line=sentence.line, text=text)


def sentences(text: str) -> Iterator[Sentence]:
    """Yield the sentences of a page, of its tables too, without blocks of code.

    The words of a code span count, but what they are does not matter.
    """
    text = CODE_BLOCK.sub(lambda block: "\n\n" + "\n" * (block[0].count("\n") - 2), text)
    text = COMMENT_OR_TARGET.sub(lambda removed: " " + REMOVED_LINE * removed[0].count("\n"), text)
    text = LISTED_NAMES.sub("", text)
    text = CODE_SPAN.sub(lambda span: re.sub(r"\S+", "code", span[1]), text)
    start = 0
    for end in (*(match.span() for match in SENTENCE_END.finditer(text)), (len(text), len(text))):
        part = text[start : end[0]]
        words = " ".join(re.sub(r"[*_#>\[\]!]", "", part).split())
        if words:
            begin = start + len(part) - len(part.lstrip())
            before = text[:begin]
            line = before.count("\n") + before.count(REMOVED_LINE) + 1
            yield Sentence(line=line, text=words)
        start = end[1]


def problems_of_names(module: Path) -> Iterator[Problem]:
    """Yield the vague names that a module has or defines."""
    if module.stem in VAGUE_MODULES:
        yield Problem(path=module, line=1, text=f'"{module.stem}" says nothing of the content')
    for name, line in defined_names(ast.parse(module.read_text("utf-8"))):
        if name in VAGUE_NAMES or BANNED_NAMES.search(name):
            yield Problem(path=module, line=line, text=f'"{name}" is no noun of the field')


def defined_names(tree: ast.AST) -> Iterator[tuple[str, int]]:
    """Yield the names of variables, arguments, functions, classes and attributes, with lines."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id, node.lineno
        elif isinstance(node, ast.arg):
            yield node.arg, node.lineno
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.name, node.lineno
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.attr, node.lineno


if __name__ == "__main__":
    sys.exit(main())
