"""A real service for tests: `lightshaft serve` on a free port, and a way to cut its connections."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[3]
BINARY = Path(
    os.environ.get("LIGHTSHAFT_BINARY")
    or Path(os.environ.get("CARGO_TARGET_DIR") or REPOSITORY / "target") / "debug" / "lightshaft"
)
PATIENCE_S = 60.0


class Service:
    """`lightshaft serve` with its worker, in a process group of its own."""

    def __init__(self, folder: Path, *options: str) -> None:
        self.folder = folder
        self._options = options
        self._listen = "127.0.0.1:0"
        self.url = ""
        self.start()

    def start(self) -> None:
        """Starts it, or starts it again on the same data and port."""
        out = self.folder / "serve.out"
        with out.open("w") as stdout, (self.folder / "serve.log").open("a") as log:
            self._process = subprocess.Popen(
                [BINARY, "serve", "--listen", self._listen, "--data", self.folder / "data", *self._options],
                stdin=subprocess.DEVNULL,
                stdout=stdout,
                stderr=log,
                start_new_session=True,
            )
        deadline = time.monotonic() + PATIENCE_S
        while not (listening := re.search(r"^listening on (http://(.*))$", out.read_text(), re.MULTILINE)):
            assert self._process.poll() is None, f"serve ended:\n{self.log()}"
            assert time.monotonic() < deadline, f"serve does not listen:\n{self.log()}"
            time.sleep(0.02)
        self.url, self._listen = listening[1], listening[2]

    def kill(self) -> None:
        """Ends it and its worker without warning."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()

    def log(self) -> str:
        return (self.folder / "serve.log").read_text()


def generate(folder: Path, kind: str, *options: str) -> Path:
    """A scene of the generator."""
    path = folder / f"{kind}{''.join(options)}.glb"
    subprocess.run([BINARY, "scene", "generate", kind, *options, "-o", path], check=True, capture_output=True)
    return path


#: How many bytes of an answer come through, by the head of the request; all of them when None.
Cut = Callable[[str], int | None]


class Proxy:
    """Stands between client and service, one request for each connection, and cuts answers short."""

    def __init__(self, target: str, cut: Cut) -> None:
        host, _, port = target.removeprefix("http://").partition(":")
        self._target = (host, int(port))
        self._cut = cut
        self._listener = socket.create_server(("127.0.0.1", 0))
        #: Heads of the requests, in order.
        self.requests: list[str] = []
        threading.Thread(target=self._accept, daemon=True).start()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self._listener.getsockname()[1]}"

    def close(self) -> None:
        _hang_up(self._listener)

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                connection, _ = self._listener.accept()
                threading.Thread(target=self._serve, args=(connection,), daemon=True).start()

    def _serve(self, client: socket.socket) -> None:
        with contextlib.suppress(OSError), _ending(client):
            received = b""
            while b"\r\n\r\n" not in received:
                piece = client.recv(65536)
                if not piece:
                    return
                received += piece
            head, _, body = received.partition(b"\r\n\r\n")
            self.requests.append(head.decode())
            left = self._cut(head.decode())
            if left == 0:
                return
            with _ending(socket.create_connection(self._target)) as service:
                closing = re.sub(rb"\r\nconnection:[^\r]*", b"", head, flags=re.IGNORECASE) + b"\r\nConnection: close"
                service.sendall(closing + b"\r\n\r\n" + body)
                threading.Thread(target=_pump, args=(client, service), daemon=True).start()
                while left is None or left > 0:
                    piece = service.recv(65536 if left is None else min(left, 65536))
                    if not piece:
                        return
                    client.sendall(piece)
                    left = None if left is None else left - len(piece)


@contextlib.contextmanager
def _ending(connection: socket.socket) -> Iterator[socket.socket]:
    try:
        yield connection
    finally:
        _hang_up(connection)


def _hang_up(connection: socket.socket) -> None:
    """Ends a connection for good: closing alone waits for a thread that reads from it."""
    with contextlib.suppress(OSError):
        connection.shutdown(socket.SHUT_RDWR)
    connection.close()


def _pump(source: socket.socket, target: socket.socket) -> None:
    with contextlib.suppress(OSError):
        while piece := source.recv(65536):
            target.sendall(piece)
