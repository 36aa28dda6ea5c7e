"""References that kernels do not count: what they compute and what they free stays as it is with numba's own counts."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numba
import numpy as np
import pytest
from llvmlite import binding as llvm
from numba.core.runtime import _nrt_python, rtsys

from asterism.server.kernel import Kernel
from asterism.server.kernel_references import without_borrowed


class Pair(NamedTuple):
    first: Any
    second: Any


def rows(table: Any, sums: Any) -> Any:
    for k in range(table.shape[0]):
        row = table[k]
        for value in row:
            sums[k] += value


def one_or_other(pair: Any, which: Any) -> Any:
    chosen = pair.first if which > 0 else pair.second
    total = 0.0
    for k in range(chosen.shape[0]):
        rest = chosen[k:]
        if rest[0] > 0.5:
            chosen = pair.second if which > 0 else pair.first
        total += rest.sum()
    return total


def part_of(pair: Any, which: Any) -> Any:
    made = np.zeros(3)
    chosen = made if which > 0 else pair.first
    for k in range(2):
        chosen[k] += pair.second[k]
    return Pair(chosen, pair.second[1:])


def first_of_many(pair: Any, which: Any) -> Any:
    kept = [pair.first]
    for _ in range(which):
        kept.append(pair.second.copy())
    return kept[-1]


@pytest.fixture
def allocations() -> Iterator[None]:
    """What is allocated and freed is counted."""
    _nrt_python.memsys_enable_stats()
    yield
    _nrt_python.memsys_disable_stats()


def flat(told: Any) -> Any:
    return np.concatenate([np.ravel(one) for one in told]) if isinstance(told, tuple) else told


@pytest.mark.parametrize("function", [one_or_other, part_of, first_of_many])
@pytest.mark.usefixtures("allocations")
def test_kernels_compute_and_free_what_numba_does(
    function: Callable[..., Any], tmp_path: Path, rng: np.random.Generator
) -> None:
    inner, plain = Kernel(function, tmp_path), numba.njit(function)

    def outer(pair: Any, which: Any) -> Any:
        told = inner(pair, which)
        return told, inner(Pair(pair.first.copy(), pair.second), which)

    whole, values = Kernel(outer, tmp_path), rng.random((2, 6))
    for which in (0, 1, 3):
        ours, theirs = values.copy(), values.copy()
        wanted = plain(Pair(*theirs), which), plain(Pair(theirs[0].copy(), theirs[1]), which)
        for got, want in zip(whole(Pair(*ours), which), wanted, strict=True):
            np.testing.assert_array_equal(flat(got), flat(want))
        np.testing.assert_array_equal(ours, theirs)
        del got, want, wanted
        before = rtsys.get_allocation_stats()
        for _ in range(10):
            whole(Pair(*ours), which)
        after = rtsys.get_allocation_stats()
        assert after.mi_alloc - before.mi_alloc == after.mi_free - before.mi_free > 0


def test_what_belongs_to_the_caller_is_not_counted(tmp_path: Path) -> None:
    inner = Kernel(rows, tmp_path)

    def outer(table: Any, sums: Any) -> Any:
        inner(table, sums)

    sums = np.zeros(3)
    Kernel(outer, tmp_path)(np.ones((3, 4)), sums)
    assert sums.tolist() == [4.0, 4.0, 4.0]
    (part,) = inner._parts.values()
    assert "call void @NRT_" not in part.library.get_llvm_str()


MODULE = """
declare void @NRT_incref(ptr)
declare void @NRT_decref(ptr)
declare ptr @make()

define void @f(ptr %made, ptr %used, ptr %stored, ptr %joined, ptr %mixed, i1 %which) {
entry:
  %own = call ptr @make()
  call void @NRT_incref(ptr %used)
  call void @NRT_incref(ptr %stored)
  call void @NRT_incref(ptr %joined)
  call void @NRT_incref(ptr %mixed)
  store ptr %stored, ptr %made, align 8
  br i1 %which, label %left, label %right

left:
  br label %right

right:
  %one = phi ptr [ null, %entry ], [ %joined, %left ]
  %other = select i1 %which, ptr %mixed, ptr %own
  call void @NRT_decref(ptr %one)
  call void @NRT_decref(ptr %other)
  call void @NRT_decref(ptr %used)
  ret void
}
"""


def test_only_what_goes_nowhere_is_left_out() -> None:
    text = str(without_borrowed(llvm.parse_assembly(MODULE)))
    counted = [name for name in ("used", "stored", "joined", "one", "mixed", "other") if f"ref(ptr %{name})" in text]
    assert counted == ["stored", "mixed", "other"]
