"""The HTTP server of the figures: few requests at once, and none that waits for long."""

import socket
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from socketserver import ThreadingMixIn
from typing import Any, Final
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer

#: Most requests at once; more are closed.
REQUESTS_MAX: Final = 16
#: Longest wait for the next part of a request, or for who asks to take the next part of the answer.
PATIENCE_S: Final = 5.0


class _Handler(WSGIRequestHandler):
    timeout = PATIENCE_S

    def log_message(self, *_: object) -> None:
        """Say nothing: who scrapes does so for months."""


class _Server(ThreadingMixIn, WSGIServer):
    daemon_threads = True

    def __init__(self, listener: socket.socket) -> None:
        super().__init__(listener.getsockname()[:2], _Handler, bind_and_activate=False)
        self.socket.close()
        self.socket = listener
        self.server_name, self.server_port = listener.getsockname()[:2]
        self.setup_environ()
        self._places = threading.BoundedSemaphore(REQUESTS_MAX)

    def process_request(self, request: Any, client_address: Any) -> None:
        if self._places.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._places.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        if not isinstance(sys.exception(), OSError):  # who leaves, or says nothing, is no error
            super().handle_error(request, client_address)


@contextmanager
def serving(listener: socket.socket, app: Callable[..., Any]) -> Iterator[None]:
    """Serve a WSGI application on a socket that listens."""
    with _Server(listener) as server:
        server.set_app(app)
        threading.Thread(target=server.serve_forever, name="figures", daemon=True).start()
        try:
            yield
        finally:
            server.shutdown()
