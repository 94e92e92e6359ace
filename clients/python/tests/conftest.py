"""The service that the tests talk to: the one at `REBAKE_SERVER` (with the token `REBAKE_TOKEN`, which has to have all
scopes), else one that is started from the program `REBAKE_BINARY`. Without either, tests that need one are skipped."""

from __future__ import annotations

import os
import subprocess
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from rooms import room

from rebake import Client, Scene

TOKEN = "0123456789abcdef-of-the-tests"


@dataclass(frozen=True)
class Service:
    """Where a service is, and the token that opens it."""

    server: str
    token: str

    def client(self) -> Client:
        return Client(self.server, self.token, timeout=30)


@pytest.fixture(scope="session")
def service() -> Iterator[Service]:
    if server := os.environ.get("REBAKE_SERVER"):
        yield Service(server, os.environ.get("REBAKE_TOKEN", ""))
        return
    binary = os.environ.get("REBAKE_BINARY")
    if not binary:
        pytest.skip("neither REBAKE_SERVER nor REBAKE_BINARY is set: there is no service to test against")
    with tempfile.TemporaryDirectory() as folder:
        tokens = Path(folder, "tokens")
        tokens.write_text(f"{TOKEN} admin\n")
        command = [binary, "serve", "--listen", "127.0.0.1:0", "--threads", "2", "--token-file", str(tokens)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
            try:
                yield Service(address(process), TOKEN)
            finally:
                process.terminate()


def address(process: subprocess.Popen[str]) -> str:
    """Where a service that was just started listens: the last word of the first line that has one."""
    assert process.stdout is not None
    for line in process.stdout:
        if "http://" in line:
            return "http://" + line.split("http://", 1)[1].split()[0].rstrip("/")
    raise AssertionError(f"the service ended with {process.wait()} and said nowhere where it listens")


@pytest.fixture(scope="session")
def client(service: Service) -> Iterator[Client]:
    with service.client() as client:
        yield client


@pytest.fixture
def scene(client: Client) -> Iterator[Scene]:
    """A room that is not baked yet, coarse, so that everything is quick."""
    scene = client.upload(room(), name="room", spacing=0.25, bake=False)
    yield scene
    if scene.id in [known.id for known in client.scenes()]:
        scene.delete()
