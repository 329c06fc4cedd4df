# SPDX-License-Identifier: MIT
"""The linter of words finds what it looks for, in the line where it is."""

import ast
from pathlib import Path
from textwrap import dedent

import pytest

from tools import words

PARTS = (
    ("A sentence. Another one.", ["A sentence.", "Another one."]),
    ("# Title\n\nText\nof two lines.", ["Title", "Text of two lines."]),
    ("| a cell | another |", ["a cell", "another"]),
    ("- an item\n- [a link](to/there.md)", ["- an item", "- a link"]),
    ("Before.\n\n```sh\nno prose\n```\n\nAfter.", ["Before.", "After."]),
    # Each word of a code span counts as a word of the sentence, but is not checked.
    ("The `span of (a | b)` ends.", ["The code code code code code ends."]),
    ("One <!-- hidden\nwords --> two.", ["One two."]),
    ("Shared options: `--jobs`, `--limit`", []),
)


@pytest.mark.parametrize(("text", "expected"), PARTS)
def test_sentences_of_a_page(text, expected):
    assert [sentence.text for sentence in words.sentences(text)] == expected


def test_sentences_have_the_number_of_their_line():
    text = (
        "# Title\n\n```sh\na\nb\n```\n<!-- one\ntwo -->\n\nFirst\nline. Second.\n\n| a |\n| b |\n"
    )
    lines = {sentence.text: sentence.line for sentence in words.sentences(text)}
    assert lines == {"Title": 1, "First line.": 10, "Second.": 11, "a": 13, "b": 14}


def written(folder: Path, text: str) -> Path:
    path = folder / "page.md"
    path.write_text(text, "utf-8")
    return path


def lines_of_problems(folder: Path, word_count: int) -> list[int]:
    """Return the lines of the problems of a page whose second line has so many words."""
    page = written(folder, f"Short.\n{'word ' * word_count}\n")
    return [problem.line for problem in words.problems_of_page(page)]


def test_the_longest_sentence_passes(tmp_path):
    assert lines_of_problems(tmp_path, words.LONGEST_SENTENCE) == []


def test_a_longer_sentence_is_found(tmp_path):
    assert lines_of_problems(tmp_path, words.LONGEST_SENTENCE + 1) == [2]


@pytest.mark.parametrize(
    "text",
    [
        "Of merged classes nothing is kept.",
        "a first guess",
        "scans of one's own",
        "There are promises",
    ],
)
def test_a_banned_word_is_found(tmp_path, text):
    assert len(list(words.problems_of_page(written(tmp_path, text)))) == 1


@pytest.mark.parametrize("text", ["The recipe is called", "there is no file", "`promise`"])
def test_other_words_pass(tmp_path, text):
    assert list(words.problems_of_page(written(tmp_path, text))) == []


def test_names_of_all_kinds_are_found(tmp_path):
    module = tmp_path / "module.py"
    code = """\
    found = 1
    def guess(each): pass
    class Own: left_out: int = 0
    async def told(): pass
    object.kept = what = found
    scan = 2
    """
    module.write_text(dedent(code), "utf-8")
    problems = words.problems_of_names(module)
    names = {
        (problem.line, problem.text.split('"')[1]) for problem in problems if '"' in problem.text
    }
    assert names == {
        (1, "found"),
        (2, "guess"),
        (2, "each"),
        (3, "left_out"),
        (4, "told"),
        (5, "kept"),
        (5, "what"),
    }


@pytest.mark.parametrize(
    ("name", "is_vague"), [("of_scan", True), ("given", True), ("share_of_scan", False)]
)
def test_a_name_without_its_noun_is_found(tmp_path, name, is_vague):
    module = tmp_path / "module.py"
    module.write_text(f"{name} = 1\n", "utf-8")
    assert bool(list(words.problems_of_names(module))) == is_vague


def test_a_vague_name_of_a_module_is_found(tmp_path):
    module = tmp_path / "utils.py"
    module.write_text("scan = 2\n", "utf-8")
    assert [problem.line for problem in words.problems_of_names(module)] == [1]


def test_reading_a_name_defines_nothing():
    assert list(words.defined_names(ast.parse("print(found.own)"))) == []


def test_a_problem_is_a_place_that_an_editor_opens():
    problem = words.Problem(path=words.ROOT / "docs/index.md", line=3, text="what is wrong")
    assert str(problem) == "docs/index.md:3: what is wrong"
