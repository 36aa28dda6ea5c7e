"""`Kernel`: numba's dispatcher, spared the work that nobody asks for. Most kernels are only ever called by others.

numba makes each of them a whole program: optimized, turned into machine code with two wrappers for Python, loaded, kept
on disk; and then optimized again in every kernel above it. A `Kernel` that another one calls is only a part: its code
is optimized and handed up, and becomes machine code once, in the kernel that Python calls; what is too large to be
inlined is not optimized again on its way there. Called from Python itself, it is compiled as a whole like any other. A
part takes integers as integers, where numba would compile it anew for every constant that it is called with.

This leans on numba's inner workings (numba.core is no public interface): tests/test_compiled.py says what must hold.
"""

import contextlib
import itertools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from numba.core import caching, compiler, event, sigutils, types, typing
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import _FunctionCompiler
from numba.core.registry import CPUDispatcher
from numba.extending import overload
from numba.np import arrayobj

from asterism.server.kernel_references import without_borrowed

Types = tuple[Any, ...]
LARGE = 300  # instructions: several times what LLVM would inline


class _Library(JITCodeLibrary):
    """Code that does without parts too large to be inlined while it is optimized, as they have been already.

    numba links all that is called, and optimizes it once more at every level of calls.
    """

    _final_module: Any

    def __init__(self, codegen: Any, name: str) -> None:
        super().__init__(codegen, name)
        self.is_large = False
        self.left_out: dict[Any, None] = {}  # what a part calls before the part

    def add_linking_library(self, library: Any) -> None:
        library._ensure_finalized()
        if isinstance(library, _Library):
            self.left_out.update(library.left_out)
            if library.is_large:
                self.left_out[library] = None
                return
        super().add_linking_library(library)

    def _optimize_final_module(self) -> None:
        passes = self._codegen._module_pass_manager
        # What is small is brought into its callers first, so that what is counted in one is counted in the other.
        manager, builder = passes(
            loop_vectorize=self._codegen._loopvect, slp_vectorize=False, opt=self._codegen._opt_level, cost="cheap"
        )
        manager.run(self._final_module, builder)
        self._final_module = without_borrowed(self._final_module)
        super()._optimize_final_module()


class _PartLibrary(_Library):
    """Code to be linked into another library, of which no machine code is made."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True
        functions = self._final_module.functions
        instructions = (one for function in functions for block in function.blocks for one in block.instructions)
        self.is_large = next(itertools.islice(instructions, LARGE, None), None) is not None


class _WholeLibrary(_Library):
    """Code that Python calls, to which the parts that were left out are linked at last."""

    def _finalize_final_module(self) -> None:
        # Callers first: what nothing calls yet is not linked.
        for library in reversed(self.left_out):
            self._reload_init.update(library._reload_init)
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        super()._finalize_final_module()


class _PartCompiler(compiler.Compiler):
    """numba's pipeline, ending before machine code.

    A part is optimized by itself first: sums that may be reordered then are, whoever calls it, in the same order, and
    the whole is faster than one that is optimized all at once (solving a robot by 16 %).
    """

    def __init__(self, typingctx: Any, targetctx: Any, _: Any, *rest: Any) -> None:
        args, return_type, flags, locals_ = rest
        flags.no_compile = flags.no_cpython_wrapper = flags.no_cfunc_wrapper = True
        library = _PartLibrary(targetctx.codegen(), "part")
        super().__init__(typingctx, targetctx, library, args, return_type, flags, locals_)


class _WholeCompiler(compiler.Compiler):
    """numba's pipeline, with parts linked last."""

    def __init__(self, typingctx: Any, targetctx: Any, _: Any, *rest: Any) -> None:
        library = _WholeLibrary(targetctx.codegen(), "whole")
        library.enable_object_caching()
        super().__init__(typingctx, targetctx, library, *rest)


class _Cache(caching.FunctionCache):
    """numba's cache of a function, in a folder of ours.

    What cannot be written is not kept; what cannot be read, cut off when the power went, is not there.
    """

    def __init__(self, function: Callable[..., Any], folder: Path) -> None:
        class Locator(caching.UserProvidedCacheLocator):
            def __init__(self, py_func: Any, py_file: str) -> None:
                super().__init__(py_func, py_file)
                self._cache_path = str(folder / self.get_suitable_cache_subpath(py_file))

            @classmethod
            def from_function(cls, py_func: Any, py_file: str) -> Any:
                return cls(py_func, py_file)

        class Implementation(caching.CompileResultCacheImpl):
            _locator_classes = (Locator,)

        self._impl_class = Implementation
        super().__init__(function)

    def holds(self, args: Types, codegen: Any) -> bool:
        """Whether the machine code for these types is on disk."""
        with contextlib.suppress(Exception):
            return self._index_key(args, codegen) in self._cache_file._load_index()
        return False

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        with contextlib.suppress(Exception):
            return super().load_overload(sig, target_context)
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        try:
            super().save_overload(sig, data)
        except OSError:
            pass
        except Exception:
            # An index that cannot be read is replaced.
            with contextlib.suppress(OSError):
                self.flush()
                super().save_overload(sig, data)


class Kernel(CPUDispatcher):
    """A compiled function. ``folder``: where its machine code is kept; ``options``: numba's, as `njit` takes them."""

    def __init__(self, function: Callable[..., Any], folder: Path, **options: Any) -> None:
        options = {"nopython": True, "boundscheck": None, "no_cfunc_wrapper": True, **options}
        super().__init__(function, targetoptions=options, pipeline_class=_WholeCompiler)
        self._parts: dict[Types, Any] = {}
        self._part_compiler = _FunctionCompiler(function, self.targetdescr, options, {}, _PartCompiler)
        self._cache = _Cache(function, folder)

    def is_kept(self, args: Types) -> bool:
        """Whether the machine code for arguments of these types is on disk."""
        return self._cache.holds(args, self.targetctx.codegen())

    def compile(self, sig: Any) -> Any:
        """The whole for a call from Python: from the disk, or compiled."""
        with global_compiler_lock, _plain_errors():
            entry_point = super().compile(sig)
            args, _ = sigutils.normalize_signature(sig)
            whole = self.overloads[tuple(args)]
            # Its parts' constants, which had no address yet when they were compiled.
            if whole.referenced_envs is None:
                for environment in whole._find_referenced_environments():
                    whole.codegen.set_env(environment.env_name, environment)
        return entry_point

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """What a call with these types from another kernel gives; the part is compiled for it."""
        pysig, args = self.fold_argument_types(args, kws)
        args = tuple(types.unliteral(arg) for arg in args)
        name = self.py_func.__name__
        signatures = [self._part(args).signature]
        return typing.make_concrete_template(f"CallTemplate({name})", name, signatures), pysig, args, {}

    def get_overload(self, sig: Any) -> Any:
        """The key under which a call from another kernel finds its code."""
        args, _ = sigutils.normalize_signature(sig)
        return self._parts[tuple(args)].entry_point

    def _part(self, args: Types) -> Any:
        with global_compiler_lock:
            if args not in self._parts:
                told = {"dispatcher": self, "args": args, "return_type": None}
                with self._compiling_counter, event.trigger_event("numba:compile", data=told):
                    part = self._part_compiler.compile(args, None)._replace(entry_point=object())
                self.targetctx.insert_user_function(part.entry_point, part.fndesc, [part.library])
                self._parts[args] = part
            return self._parts[args]


def _refuse_shapes(source: Any, target: Any) -> None:
    """What a kernel does where the two sides of ``a[:] = b`` differ in shape."""
    raise NotImplementedError


@overload(_refuse_shapes)
def _refuse_shapes_in_kernels(source: Any, target: Any) -> Any:  # noqa: ARG001
    def refuse(source: Any, target: Any) -> None:  # noqa: ARG001
        raise ValueError("shapes of the two sides of an assignment differ")

    return refuse


@contextlib.contextmanager
def _plain_errors() -> Iterator[None]:
    """numba's own message tells both shapes: a second's worth of compiled string formatting in every kernel."""
    told = arrayobj.raise_with_shape_context
    arrayobj.raise_with_shape_context = _refuse_shapes
    try:
        yield
    finally:
        arrayobj.raise_with_shape_context = told
