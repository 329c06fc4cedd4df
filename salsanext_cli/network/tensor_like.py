# SPDX-License-Identifier: MIT
"""Another view of a network, derived from the network itself instead of written again."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar


class TensorLike:
    """Takes the place of a tensor: PyTorch asks it what each function of a network does to it.

    A function without a rule is an error, so the views of a network cannot drift apart.

    Attributes
    ----------
    RULES : mapping
        From a function to what stands for it; its arguments are the function's.
    VIEW : str
        What the rules are about, for the error.
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
