"""Who joins a domain is heard by nobody but this machine; what is in the way is said in a sentence."""

import socket
import sys

import pytest

pytest.importorskip("cyclonedds", reason="cyclonedds is not installed (pip install '.[dds]')")

from asterism.protocol.errors import InputError
from asterism.server.service.dds.participant import USERS_OWN, Participant, _opened, _sockets

DOMAIN = 201


@pytest.mark.skipif(sys.platform != "linux", reason="sockets are bound to a device on Linux alone")
def test_its_sockets_hear_loopback_alone_and_are_closed_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(USERS_OWN, raising=False)
    before = _sockets()
    for _ in range(2):
        participant = Participant(DOMAIN)
        bound = {}
        for one in _opened(_sockets() - before):
            device = one.getsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, 16).rstrip(b"\0")
            bound[one.getsockname()] = device
        assert len(bound) >= 5
        assert all(device == b"lo" or address == "127.0.0.1" for (address, _), device in bound.items())
        participant.close()
        assert _sockets() <= before


@pytest.mark.parametrize("domain", [0, 232])
def test_the_first_and_the_last_domain_can_be_joined(domain: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(USERS_OWN, raising=False)
    before = _sockets()
    participant = Participant(domain)
    assert len(_sockets() - before) >= 5
    participant.close()


def test_ports_that_are_taken_are_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(USERS_OWN, raising=False)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("0.0.0.0", 7400 + 250 * DOMAIN))
        with pytest.raises(InputError, match=rf"domain {DOMAIN} .* UDP ports, from 57650 on, .*expected another"):
            Participant(DOMAIN)


def test_a_configuration_of_the_users_own_holds_and_a_wrong_one_is_said(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    own = "<Interfaces><NetworkInterface address='127.0.0.1'/></Interfaces><MaxMessageSize>1400B</MaxMessageSize>"
    monkeypatch.setenv(USERS_OWN, f"<CycloneDDS><Domain><General>{own}</General></Domain></CycloneDDS>")
    Participant(DOMAIN).close()
    monkeypatch.setenv(USERS_OWN, "<CycloneDDS><Domain><General><Bogus/></General></Domain></CycloneDDS>")
    with pytest.raises(InputError, match=f"expected {USERS_OWN} to be a configuration"):
        Participant(DOMAIN)
