"""References that a kernel counts and need not: those to arrays that its caller holds anyway.

numba counts a reference for every name that an array has in a function, views and fields of bundles among them, with
an atomic instruction each, across which nothing is kept in registers; its own pass leaves many that loops and branches
part. A caller holds the arrays that it hands over until the call is over. So of arguments that are only used, and
stored or returned nowhere, a function's own counts may go, all of them together: they cancel out.
"""

import re
from collections.abc import Iterator

from llvmlite import binding as llvm

_NAME = r'%(?:"[^"]*"|[\w.$-]+)'
_NAMES = re.compile(_NAME)
_FUNCTION = re.compile(r"^define .*?^}$", re.MULTILINE | re.DOTALL)
_COUNT = re.compile(rf"^.*call void @NRT_(?:inc|dec)ref\(ptr [^%)]*({_NAME})\).*$\n", re.MULTILINE)
# One of several values, as it comes from branches; and what is done with a value that leads nowhere.
_ONE_OF = re.compile(rf"^ *({_NAME}) = (?:phi ptr (.*)|select i1 [^,]*, (.*))$", re.MULTILINE)
_USES = re.compile(r"[= ]call (?!.*@NRT_)|= icmp ")


def without_borrowed(module: llvm.ModuleRef) -> llvm.ModuleRef:
    """The module without what its functions count of arrays that belong to their callers."""
    text = str(module)
    if "@NRT_incref" not in text:
        return module
    changed = llvm.parse_assembly(_FUNCTION.sub(lambda match: _uncounted(match.group()), text))
    changed.name = module.name
    return changed


def _uncounted(function: str) -> str:
    """The text of a function without the counts of arguments, and of what is one or another of them."""
    counted = {match.group(1) for match in _COUNT.finditer(function)}
    head, body = function.split("\n", 1)
    arguments = set(_NAMES.findall(head))
    joined = {match.group(1): _values(match.group(2) or match.group(3)) for match in _ONE_OF.finditer(body)}
    kept = _kept(_ONE_OF.sub("", _COUNT.sub("", body)))
    borrowed: set[str] = set()
    for group in _groups(joined):
        if group <= arguments | joined.keys() and not group & kept:
            borrowed |= group
    borrowed |= (counted & arguments) - kept - {name for group in _groups(joined) for name in group}
    return _COUNT.sub(lambda match: "" if match.group(1) in borrowed else match.group(), function)


def _values(told: str) -> list[str]:
    """The names of the values that one is of."""
    return _NAMES.findall(re.sub(rf", {_NAME} ]", "]", told))


def _kept(body: str) -> set[str]:
    """The values that are more than used: stored, say, or returned, or made in the function."""
    lines = (line for line in body.splitlines() if not _USES.search(line))
    return {name for line in lines for name in _NAMES.findall(line)}


def _groups(joined: dict[str, list[str]]) -> Iterator[set[str]]:
    """Names that may be of one value."""
    groups: dict[str, set[str]] = {}
    for name, values in joined.items():
        together = {name}.union(*(groups.get(one, {one}) for one in (name, *values)))
        groups.update(dict.fromkeys(together, together))
    return iter({id(group): group for group in groups.values()}.values())
