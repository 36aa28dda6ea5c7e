"""Which kernels Python calls, with what types, and what for: known before they run, so that they can be compiled first.

The list is kernels.json, a line each; `python -m tests.measure.first_start write` makes it anew from what runs, and a
test says when that is due. A kernel that is missing there is compiled when it is first called.
"""

import contextlib
import functools
import importlib
import json
from pathlib import Path
from typing import Any, NamedTuple

from numba import types
from numba.core.errors import NumbaError

from asterism.server.kernel import Kernel

FILE = Path(__file__).with_name("kernels.json")
PACKAGE = "asterism.server."

# What kernels are needed for, beside the names of the estimators.
BLOBS, LOCALIZE, SIMULATE, CHECK, DESIGN, FUSE, COVERAGE = (
    "blobs", "localize", "simulate", "check", "design", "fuse", "coverage",
)  # fmt: skip


class Entry(NamedTuple):
    """A kernel (its module and name below asterism.server), the types of its arguments as `text_of` writes them, what
    it is needed for, and how many seconds of processor time compiling it took where the list was made.
    """

    kernel: str
    arguments: tuple[Any, ...]
    needs: frozenset[str]
    seconds: float

    @property
    def dispatcher(self) -> Kernel:
        """The kernel itself; its module is imported."""
        module, _, name = self.kernel.rpartition(".")
        found: Kernel = getattr(importlib.import_module(PACKAGE + module), name)
        return found

    def is_kept(self) -> bool:
        """Whether its machine code is on disk."""
        return self.dispatcher.is_kept(tuple(map(type_of, self.arguments)))

    def make_ready(self) -> None:
        """Load its machine code from the disk, or compile it.

        Where the list is not up to date and the types do not fit, it is compiled when it is first called.
        """
        with contextlib.suppress(NumbaError, TypeError):
            self.dispatcher.compile(tuple(map(type_of, self.arguments)))


@functools.cache
def kernel_list() -> tuple[Entry, ...]:
    """All, in the order in which a frame meets them."""
    lines = json.loads(FILE.read_text(encoding="utf-8"))
    return tuple(
        Entry(line["kernel"], tuple(line["arguments"]), frozenset(line["needs"]), line["seconds"]) for line in lines
    )


def text_of(kind: Any) -> Any:
    """A numba type as JSON: "float64"; "float64[2]", an array of two dimensions; ["int64", ...], a tuple;
    {"identity.search.Spots": [...]}, a named one. Raises TypeError for anything else.
    """
    if isinstance(kind, types.Array) and (kind.layout, kind.mutable, kind.aligned) == ("C", True, True):
        return f"{kind.dtype}[{kind.ndim}]"
    if isinstance(kind, types.BaseNamedTuple):
        name = f"{kind.instance_class.__module__}.{kind.instance_class.__qualname__}"
        return {name.removeprefix(PACKAGE): [text_of(part) for part in kind.types]}
    if isinstance(kind, types.BaseTuple):
        return [text_of(part) for part in kind.types]
    if isinstance(kind, types.Number | types.Boolean | types.NumPyRandomGeneratorType):
        return str(kind)
    raise TypeError(f"an argument of type {kind}: kernels that Python calls take numbers, whole arrays and tuples")


def type_of(text: Any) -> Any:
    """The numba type that `text_of` wrote."""
    if isinstance(text, list):
        return types.BaseTuple.from_types([type_of(part) for part in text])
    if isinstance(text, dict):
        ((name, parts),) = text.items()
        module, _, cls = name.rpartition(".")
        made = getattr(importlib.import_module(PACKAGE + module), cls)
        return types.BaseTuple.from_types([type_of(part) for part in parts], made)
    scalar, _, dimensions = text.partition("[")
    if text == str(types.npy_rng):
        return types.npy_rng
    kind = getattr(types, "boolean" if scalar == "bool" else scalar)
    return types.Array(kind, int(dimensions.rstrip("]")), "C") if dimensions else kind
