# SPDX-License-Identifier: MIT
"""Stand-ins for tensors, by which other functions are derived from a network itself."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar


class TensorLike:
    """Stand-in for a tensor that PyTorch asks what each function of a network does to it.

    A function without a rule is an error, so the views of a network cannot drift apart.

    Attributes
    ----------
    RULES : mapping
        Replacements of functions, with the same arguments.
    VIEW : str
        Subject of the rules, for the error.
    """

    __slots__ = ()
    RULES: ClassVar[Mapping[Callable[..., Any], Callable[..., Any]]] = {}
    VIEW: ClassVar[str]

    @classmethod
    def __torch_function__(
        cls,
        function: Callable[..., Any],
        types: Sequence[type],
        args: Sequence[Any] = (),
        kwargs: dict[str, Any] | None = None,
    ) -> Any:
        """Apply the rule of a function; PyTorch calls this."""
        rule = cls.RULES.get(function)
        if rule is None:
            raise NotImplementedError(f"no rule for the {cls.VIEW} of {function.__name__}")
        return rule(*args, **(kwargs or {}))
