"""Connections to cameras' servers: what holds them up ends with them."""

from types import SimpleNamespace

import pytest

from asterism.server.service.fusing import ears


def test_whoever_is_still_being_asked_is_waited_for_together(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]

    def join(timeout_s: float) -> None:  # of one that answers nothing
        now[0] += timeout_s

    heard = ears.Ears([], None, (), lambda _: None)
    monkeypatch.setattr(ears, "time", SimpleNamespace(monotonic=lambda: now[0]))
    heard._asking = [SimpleNamespace(join=join) for _ in range(64)]  # type: ignore[misc]
    heard.close()
    assert now[0] == ears.ANSWER_S + 1.0
