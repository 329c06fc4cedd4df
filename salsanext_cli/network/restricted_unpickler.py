# SPDX-License-Identifier: MIT
"""Interpreter of pickles that builds tensors and plain values and runs nothing.

A pickle is a program. Only those of its operations are carried out that numbers, text, lists,
tuples, dictionaries and dense tensors need; no function that it names is ever looked up, let alone
called. Time and memory grow with the length of the pickle, whatever it says.
"""

import math
import pickletools
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import islice
from typing import Any, BinaryIO

import torch
from torch import Tensor

from salsanext_cli.errors import shortened

MAX_OPERATIONS = 300_000
"""Operations of one pickle, which take a second; the published checkpoint has 10 000."""
MAX_DIMENSIONS = 8
MAX_KEY = 1 << 31
"""Bound of the numbers that are keys of dictionaries: larger ones can be made to collide."""
DTYPES = {
    "torch.FloatStorage": torch.float32,
    "torch.DoubleStorage": torch.float64,
    "torch.HalfStorage": torch.float16,
    "torch.BFloat16Storage": torch.bfloat16,
    "torch.LongStorage": torch.int64,
    "torch.IntStorage": torch.int32,
    "torch.ShortStorage": torch.int16,
    "torch.CharStorage": torch.int8,
    "torch.ByteStorage": torch.uint8,
    "torch.BoolStorage": torch.bool,
}
VALUES: dict[str, Callable[[], Any]] = {
    "NONE": lambda: None,
    "NEWTRUE": lambda: True,
    "NEWFALSE": lambda: False,
    "EMPTY_TUPLE": tuple,
    "EMPTY_LIST": list,
    "EMPTY_DICT": dict,
}
"""Operations that push a value of their own."""


@dataclass(frozen=True, slots=True)
class Opaque:
    """Class or function that a pickle names, or what it makes of it; only the name is kept."""

    name: str


class RestrictedUnpickler:
    """Interpreter of one pickle of `torch.save`.

    Dictionaries of any class become plain ones, without the keys that are neither text nor small
    numbers; parameters become tensors. Objects of other classes, and tensors that are sparse,
    quantised, without numbers, or of complex or 8-bit floating-point numbers, become `Opaque`.

    `storages`: returned by `load_storage`, by key.

    `file`: read from where it is, and left behind the pickle; `load_storage`: given key, dtype and
    number of elements, returns a tensor of one dimension; called once for each key.
    """

    def __init__(
        self, file: BinaryIO, load_storage: Callable[[str, torch.dtype, int], Tensor]
    ) -> None:
        self.storages: dict[str, Tensor] = {}
        self._file = file
        self._load_storage = load_storage
        self._stack: list[Any] = []
        self._marked: list[list[Any]] = []
        self._memo: dict[int, Any] = {}

    def load(self) -> Any:
        """Carry out the operations up to the end of the pickle, and return its object."""
        for operation, argument, _ in islice(pickletools.genops(self._file), MAX_OPERATIONS):
            if operation.name == "STOP":
                return self._stack.pop()
            self._carry_out(operation.name, argument)
        raise ValueError(f"more than {MAX_OPERATIONS} operations")

    def _carry_out(self, name: str, argument: Any) -> None:
        stack = self._stack
        match name:
            case "BINPUT" | "LONG_BINPUT":
                self._memo[argument] = stack[-1]
            case "BINGET" | "LONG_BINGET":
                stack.append(self._memo[argument])
            case "BINUNICODE" | "SHORT_BINSTRING" | "BINFLOAT":
                stack.append(argument)
            case "BININT" | "BININT1" | "BININT2" | "LONG1":
                stack.append(argument)
            case "GLOBAL":
                stack.append(Opaque(argument.replace(" ", ".", 1)))
            case "MARK":
                self._marked.append(stack)
                self._stack = []
            case "TUPLE":
                self._stack = self._marked.pop()
                self._stack.append(tuple(stack))
            case "TUPLE1" | "TUPLE2" | "TUPLE3":
                items = [stack.pop() for _ in range(int(name[-1]))]
                stack.append(tuple(reversed(items)))
            case "APPEND":
                value = stack.pop()
                _extend(stack[-1], [value])
            case "APPENDS":
                self._stack = self._marked.pop()
                _extend(self._stack[-1], stack)
            case "SETITEM":
                value, key = stack.pop(), stack.pop()
                _update(stack[-1], [(key, value)])
            case "SETITEMS":
                self._stack = self._marked.pop()
                _update(self._stack[-1], zip(stack[::2], stack[1::2], strict=True))
            case "REDUCE" | "NEWOBJ":
                arguments, function = stack.pop(), stack.pop()
                stack.append(_called(function, arguments))
            case "BUILD":
                # Attributes; those of tensors and dictionaries are not needed.
                stack.pop()
            case "BINPERSID":
                stack.append(self._storage(stack.pop()))
            case _ if name in VALUES:
                stack.append(VALUES[name]())
            case "PROTO":
                pass
            case _:
                raise ValueError(f"operation {name}")

    def _storage(self, identifier: Any) -> Tensor | Opaque:
        match identifier:
            case ("storage", Opaque(name=name), str(key), _, int(count), *view) if not any(view):
                if name not in DTYPES:
                    return Opaque(name)
                if key not in self.storages:
                    self.storages[key] = self._load_storage(key, DTYPES[name], count)
                return self.storages[key]
            case ("module", Opaque() as module, *_):
                return module
        raise ValueError("a reference to neither numbers nor a module")


def _extend(target: Any, values: list[Any]) -> None:
    if type(target) is list:
        target.extend(values)
    elif type(target) is not Opaque:
        raise TypeError(f"values for a {type(target).__name__}")


def _update(target: Any, items: Iterable[Any]) -> None:
    """Put items into a dictionary; to hash nested tuples can take forever."""
    if type(target) is dict:
        for item in items:
            match item:
                case [str(key), value]:
                    target[key] = value
                case [int(number), value] if abs(number) < MAX_KEY:
                    target[number] = value
    elif type(target) is not Opaque:
        raise TypeError(f"items for a {type(target).__name__}")


def _called(function: Any, arguments: Any) -> Any:
    """Return what one of the few known functions makes of its arguments."""
    match function, arguments:
        case Opaque("collections.OrderedDict"), ():
            return {}
        case Opaque("collections.OrderedDict"), (list(pairs),):
            found: dict[Any, Any] = {}
            _update(found, pairs)
            return found
        case Opaque("torch._utils._rebuild_tensor_v2"), (Tensor() as numbers, *geometry, _, _):
            return _tensor(numbers, *geometry)
        case Opaque("torch._utils._rebuild_tensor_v2"), (Opaque() as kind, *_):
            return kind
        case Opaque("torch._utils._rebuild_parameter"), (Tensor() | Opaque() as data, _, _):
            return data
        case Opaque(), _:
            return function
    raise TypeError(f"a call of a {type(function).__name__}")


def _tensor(numbers: Tensor, offset: Any, size: Any, stride: Any, *more: Any) -> Tensor | Opaque:
    """Return a view that has no more elements than there are numbers."""
    if more:
        return Opaque("torch._utils._rebuild_tensor_v2 with more than numbers")
    if not len(size) == len(stride) <= MAX_DIMENSIONS:
        raise ValueError(f"a tensor of {len(size)} dimensions")
    if any(type(number) is not int for number in (offset, *size, *stride)):
        raise TypeError("a tensor whose size is not of numbers")
    if math.prod(size) > len(numbers):
        raise ValueError(f"a tensor of {shortened(size)} from {len(numbers)} numbers")
    return numbers.as_strided(size, stride, offset)
