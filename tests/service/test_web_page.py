"""rerun's page, as it is handed on: whole, from this machine alone, and with the stream connected."""

import http.client
import socket
from collections.abc import Iterator
from email.message import Message
from urllib.parse import parse_qs, urlsplit

import pytest

pytest.importorskip("rerun", reason="rerun-sdk is not installed (pip install '.[review]')")

from asterism.protocol.errors import InputError
from asterism.server.service.web_page import WebPage
from tests.listening import free_ports


@pytest.fixture(scope="module")
def page() -> Iterator[WebPage]:
    page = WebPage(free_ports(4) + 1)
    yield page
    page.close()


def asked(page: WebPage, path: str) -> tuple[int, Message, bytes]:
    connection = http.client.HTTPConnection(urlsplit(page.address).netloc, timeout=60.0)
    try:
        connection.request("GET", path)
        answer = connection.getresponse()
        return answer.status, answer.headers, answer.read()
    finally:
        connection.close()


def test_the_printed_address_leads_to_the_stream(page: WebPage) -> None:
    status, headers, _ = asked(page, "/")
    assert status == 302
    assert parse_qs(urlsplit(headers["Location"]).query)["url"] == [page.url]
    port = urlsplit(page.address).port
    assert port is not None
    assert page.url == f"rerun+http://127.0.0.1:{port + 1}/proxy"


def test_the_page_may_ask_no_other_host(page: WebPage) -> None:
    status, headers, body = asked(page, "/?url=whatever")
    assert status == 200
    assert b"re_viewer.js" in body
    assert not [tag for tag in body.split(b"<") if tag.startswith(b"link") and b"//" in tag]
    assert int(headers["Content-Length"]) == len(body)
    rules = dict(rule.strip().split(" ", 1) for rule in headers["Content-Security-Policy"].split(";"))
    here = {"'self'", "data:", "blob:", page.url.removeprefix("rerun+").removesuffix("/proxy")}
    words = {"'unsafe-inline'", "'wasm-unsafe-eval'", "'none'"}
    assert {"default-src", "connect-src", "script-src"} <= rules.keys()
    assert {source for sources in rules.values() for source in sources.split()} <= here | words


def test_its_files_are_whole_and_others_are_not_there(page: WebPage) -> None:
    status, headers, body = asked(page, "/re_viewer_bg.wasm")
    assert (status, headers["Content-Type"]) == (200, "application/wasm")
    assert body[:4] == b"\0asm"
    assert int(headers["Content-Length"]) == len(body)
    assert asked(page, "/../../etc/passwd")[0] == 404


def test_who_hangs_up_disturbs_nobody(page: WebPage, capfd: pytest.CaptureFixture[str]) -> None:
    with socket.create_connection(("127.0.0.1", urlsplit(page.address).port)) as gone:
        gone.sendall(b"GET /re_viewer_bg.wasm HTTP/1.0\r\n\r\n")
    assert asked(page, "/re_viewer.js")[0] == 200
    assert capfd.readouterr() == ("", "")


def test_both_of_its_ports_must_be_free(page: WebPage) -> None:
    port = urlsplit(page.address).port
    assert port is not None
    asked(page, "/re_viewer.js")  # then rerun listens too
    for taken in (port - 1, port, port + 1):
        with pytest.raises(InputError, match=f"--web {taken}: port .* expected two free ports"):
            WebPage(taken)
