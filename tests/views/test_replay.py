"""The replay page and its server, without a browser."""

import base64
import hashlib
import json
import re
import socket
import subprocess
import urllib.error
import urllib.request
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from unittest.mock import Mock

import pytest
from page_data import data_of, hostile

from cmbot.common.errors import InputError
from cmbot.planning import Plan
from cmbot.views import ReplayServer, replay, replay_page, report_page
from cmbot.views.replay_data import replay_data

EVIL = "</script></title><img src=x onerror=alert(1)><!--\u2028\ud800"


class Page(HTMLParser):
    """What a browser would make of a page: its elements, and the texts of those that hold text alone."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[tuple[str, dict[str, str | None], str]] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        if self.elements and data.strip():
            self.texts.append((*self.elements[-1], data))

    def text_of(self, tag: str, **attributes: str) -> str:
        return "".join(
            text for name, given, text in self.texts if name == tag and attributes.items() <= given.items()
        )


@pytest.fixture(scope="module")
def text(triangle_plan: Plan) -> str:
    return replay_page(triangle_plan)


@pytest.fixture(scope="module")
def page(text: str) -> Page:
    return Page(text)


def test_the_page_is_small_and_holds_all_it_needs(text: str, page: Page, triangle_plan: Plan) -> None:
    assert len(text.encode()) < 5_000_000
    assert replay_page(triangle_plan) == text
    for tag, attributes in page.elements:
        assert "src" not in attributes
        assert attributes.get("href", "data:,") == "data:,", tag
        assert not [name for name in attributes if name.startswith("on")]
    style = page.text_of("style")
    assert "url(" not in style
    assert "@import" not in style
    assert page.text_of("title") == "triangle"
    for notice in ("Robin Deits", "Three.js Authors", "Feross Aboukhadijeh", "Yusuke Kawasaki"):
        assert notice in text
    data = json.loads(page.text_of("script", id="replay-data"))
    assert data == json.loads(json.dumps(replay_data(triangle_plan)))


def test_its_policy_allows_its_own_two_scripts_alone(page: Page) -> None:
    policies = [a["content"] for tag, a in page.elements if tag == "meta" and "http-equiv" in a]
    assert len(policies) == 1
    rules = dict(rule.strip().split(" ", 1) for rule in str(policies[0]).split(";"))
    assert rules["default-src"] == "'none'"
    scripts = [text for tag, attributes, text in page.texts if (tag, attributes) == ("script", {})]
    assert len(scripts) == 2
    hashes = {base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in scripts}
    assert set(rules["script-src"].split()) == {f"'sha256-{digest}'" for digest in hashes}


@pytest.mark.parametrize("page_of", [replay_page, report_page])
def test_names_are_text(triangle_plan: Plan, page_of: Callable[[Plan], str]) -> None:
    text, plain = (page_of(plan) for plan in (hostile(triangle_plan, EVIL), triangle_plan))
    evil, data = Page(text), data_of(text)
    assert "<img src" not in text
    assert text.count("</script>") == plain.count("</script>")
    assert [tag for tag, _ in evil.elements] == [tag for tag, _ in Page(plain).elements]
    assert evil.text_of("title") == evil.text_of("h1") == EVIL
    assert data["title"] == data["robot"] == EVIL


def test_a_file_is_written_without_a_server_or_a_process(
    triangle_plan: Plan, text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    refuse = Mock(side_effect=pytest.fail.Exception("a process or a socket was asked for"))
    monkeypatch.setattr(subprocess, "Popen", refuse)
    monkeypatch.setattr(socket, "socket", refuse)
    path = tmp_path / "replay.html"
    path.write_text("old", encoding="utf-8")
    assert replay(triangle_plan, html=str(path)) is None
    assert path.read_text(encoding="utf-8") == text
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("place", ["missing/replay.html", "folder", "null\0byte"])
def test_a_file_that_cannot_be_written(triangle_plan: Plan, tmp_path: Path, place: str) -> None:
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match="cannot be written") as caught:
        replay(triangle_plan, tmp_path / place)
    assert caught.value.source == str(tmp_path / place)
    assert [path.name for path in tmp_path.iterdir()] == ["folder"]
    with pytest.raises(InputError, match="html, serve: got neither"):
        replay(triangle_plan)


def test_the_server_serves_this_computer_alone(triangle_plan: Plan, text: str) -> None:
    server = replay(triangle_plan, serve=True)
    with server:
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+/", server.url)
        with urllib.request.urlopen(server.url, timeout=60) as answer:
            assert answer.headers["Content-Type"] == "text/html; charset=utf-8"
            assert answer.read().decode() == text
        # Every address 127.x.y.z is this computer: a server on all interfaces would answer here.
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.2", server.port), timeout=60)
        assert server.wait(timeout=0) is False
        server.close()
    assert server.wait() is True
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", server.port), timeout=60)


FOREIGN_HOSTS = ("evil.example", "127.0.0.1:1@evil.example", "localhost.evil.example", "127.0.0.1:80:1", "")


def test_the_server_refuses_other_paths_hosts_and_ports() -> None:
    with ReplayServer("<p>page</p>") as server:
        for url, host, status in (
            (f"{server.url}x", "localhost", 404),
            *((server.url, host, 421) for host in FOREIGN_HOSTS),
        ):
            request = urllib.request.Request(url, headers={"Host": host})
            with pytest.raises(urllib.error.HTTPError) as caught:
                urllib.request.urlopen(request, timeout=60)
            caught.value.close()
            assert caught.value.code == status
        for port in (server.port, 70_000, -1):
            with pytest.raises(InputError, match="a free port"):
                ReplayServer("page", port)
