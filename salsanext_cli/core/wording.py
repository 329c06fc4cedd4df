# SPDX-License-Identifier: MIT
"""How messages spell the arguments of functions: as Python does, or in the words of a program.

An error that a caller in Python gets says ``device="cpu"``. The command line hands in its own
spelling, so that the same error says what to type there.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager


class Spelling:
    """Spelling of arguments in messages; this is that of Python."""

    def name(self, argument: str) -> str:
        """Spell an argument such as ``width``, or a field of a record, such as ``knn.k``."""
        return argument.rpartition(".")[2]

    def setting(self, argument: str, value: object) -> str:
        """Spell an argument with a value, which is True for a switch."""
        return f"{self.name(argument)}={literal(value)}"

    def share(self, argument: str, value: float) -> str:
        """Spell an argument with a share, 0…1."""
        return f"{self.name(argument)}={value:g}"

    def part(self, argument: str, source: object, name: str) -> str:
        """Spell the choice of a part of a source; in Python, the path of the part is the source."""
        return literal(f"{source}/{name.strip('/')}")

    def command(self, words: str, settings: Sequence[str]) -> str:
        """Spell a command of some words and settings, which are spelled already."""
        return f"{words} with {' and '.join(settings)}" if settings else words


def literal(value: object) -> str:
    """Return a value as Python reads it: texts and paths in double quotes."""
    if isinstance(value, tuple):
        items = ", ".join(literal(item) for item in value)
        return f"({items},)" if len(value) == 1 else f"({items})"
    if isinstance(value, bool | int | float) or value is None:
        return repr(value)
    return json.dumps(str(value), ensure_ascii=False)


_spelling = Spelling()


def use(spelling: Spelling) -> None:
    """Use this spelling in this process from now on."""
    global _spelling
    _spelling = spelling


def used() -> Spelling:
    """Return the spelling of this process."""
    return _spelling


@contextmanager
def spelled(spelling: Spelling) -> Iterator[None]:
    """Use a spelling in this process while the body runs."""
    before = used()
    use(spelling)
    try:
        yield
    finally:
        use(before)


def argument(*names: str) -> str:
    """Spell one or several arguments, such as ``width``, or ``knn.k`` for a field of a record."""
    return " and ".join(_spelling.name(name) for name in names)


def setting(name: str, value: object) -> str:
    """Spell an argument with a value, which is True for a switch."""
    return _spelling.setting(name, value)


def share(name: str, value: float) -> str:
    """Spell an argument with a share, 0…1."""
    return _spelling.share(name, value)


def part(argument: str, source: object, name: str) -> str:
    """Spell the choice of a part of a source, such as a topic of a recording."""
    return _spelling.part(argument, source, name)


def command(words: str, *settings: str) -> str:
    """Spell a command of some words and settings, which `setting` has spelled."""
    return _spelling.command(words, settings)
