"""A Dask cluster in place of this machine's cores. Files go over no wire: workers see them under the same paths."""

import asyncio
import contextlib
import importlib.util
import uuid
from collections.abc import Iterator
from concurrent.futures import Executor
from pathlib import Path
from typing import TYPE_CHECKING, Any

from asterism.protocol.errors import InputError, WorldError
from asterism.protocol.rig import Rig
from asterism.server.chain.warm_up import localizing, warm_up
from asterism.server.service.batch.basis import program
from asterism.server.service.batch.folder import HIDDEN
from asterism.server.service.batch.workers import be_alone

if TYPE_CHECKING:
    from distributed import Client

ANSWERS_S = 5.0  # within which a scheduler answers, and has workers


class Look:
    """What a worker tells before it has work: its program, and which of the files it cannot see. Travels there."""

    def __init__(self, paths: list[str]) -> None:
        self._paths = paths

    def __call__(self) -> tuple[str, list[str]]:
        be_alone()
        return program(), [path for path in self._paths if not Path(path).exists()]


class Ready:
    """Kernels compiled where they are not yet. Travels there."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig

    def __call__(self) -> None:
        warm_up(*localizing(self._rig))


@contextlib.contextmanager
def cluster(address: str, folder: Path, sources: list[str], rig: Rig) -> Iterator[tuple[Executor, int]]:
    """Where to send work, and how many pieces are solved there at once.

    Raises ModuleNotFoundError without Dask, InputError for an address that is none, or where workers are of another
    version or do not see the files, WorldError where nothing answers.
    """
    if importlib.util.find_spec("distributed") is None:
        raise ModuleNotFoundError("No module named 'distributed'", name="distributed")
    client = _client(address)
    try:
        threads = _threads(client, address)
        _check(client, folder, sources)
        _on_all(client, Ready(rig))
        yield client.get_executor(pure=False), sum(threads.values())
    finally:
        with contextlib.suppress(Exception):
            client.close(timeout=ANSWERS_S)


def _client(address: str) -> "Client":
    from distributed import Client

    # A client that failed to connect tells of it again when it is forgotten.
    try:
        asyncio.run(_ask(address))
    except ValueError as error:
        raise InputError(f"--dask {address}: {error}; expected such as tcp://HOST:8786") from None
    except (OSError, TimeoutError) as error:
        why = str(error).splitlines()[0] if str(error) else f"not within {ANSWERS_S:g} s"
        raise WorldError(f"--dask {address}: no scheduler answers there ({why}); start one: dask scheduler") from None
    except Exception as error:  # what others say makes it stumble over anything
        raise WorldError(
            f"--dask {address}: what answers there is no Dask scheduler ({type(error).__name__})"
        ) from None
    return Client(address, timeout=ANSWERS_S, set_as_default=False)


async def _ask(address: str) -> None:
    from distributed import rpc

    async with asyncio.timeout(ANSWERS_S):
        scheduler = rpc(address, timeout=ANSWERS_S)
        try:
            await scheduler.identity()
        finally:
            await scheduler.close_rpc()


def _threads(client: "Client", address: str) -> dict[str, int]:
    try:
        client.wait_for_workers(1, timeout=ANSWERS_S)
    except TimeoutError:
        raise WorldError(f"--dask {address}: the scheduler has no workers; start some: dask worker {address}") from None
    return dict(client.nthreads())


def _on_all(client: "Client", function: Any) -> dict[str, Any]:
    return dict(client.run(function))


def _check(client: "Client", folder: Path, sources: list[str]) -> None:
    sign = (folder / HIDDEN / f"seen-{uuid.uuid4().hex[:8]}").resolve()
    sign.touch()
    try:
        told = _on_all(client, Look([str(sign), *sources]))
    except Exception as error:  # a worker without asterism cannot even read what it is asked
        raise InputError(
            f"--dask: a worker cannot run asterism ({type(error).__name__}: {str(error)[:120]}), expected this version "
            f"on all of them: {program().partition(' ')[0]}"
        ) from None
    finally:
        sign.unlink(missing_ok=True)
    ours = program()
    for worker, (theirs, missing) in told.items():
        if theirs != ours:
            raise InputError(
                f"--dask: worker {worker} has asterism {theirs}, here it is {ours}; expected the same on all of them"
            )
        if missing:
            what = folder if missing[0] == str(sign) else missing[0]
            raise InputError(
                f"--dask: worker {worker} does not see {what}; expected all files under the same paths on every "
                "host, as on a network disk"
            )
