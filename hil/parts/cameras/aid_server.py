"""Page of the set-up aid: the newest pair and its numbers, on this computer only."""

from __future__ import annotations

import json
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from hil.errors import BadInput

_FOLDER: Final = Path(__file__).parent
_FILES: Final = {
    "/": ("aid_page.html", "text/html; charset=utf-8"),
    "/aid.css": ("aid.css", "text/css"),
    "/aid.js": ("aid.js", "text/javascript"),
}
_HOST: Final = "127.0.0.1"
_NAMES: Final = (_HOST, "localhost")
_HEADERS: Final = {
    "Content-Security-Policy": "default-src 'self'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}


class AidServer:
    """Serves what ``show`` was given last, until ``close``. port: 0 for a free one. Raises BadInput for a used one."""

    def __init__(self, port: int) -> None:
        self._state: dict[str, Any] = {"number": 0, "left": None, "right": None, "saved": None}
        self._pictures: dict[str, np.ndarray] = {}
        self._asked = threading.Event()
        try:
            self._server = ThreadingHTTPServer((_HOST, port), self._handler())
        except OSError as error:
            raise BadInput.single("--port", "", f"{port}: cannot listen: {error.strerror or error}") from error
        self._server.daemon_threads = True
        self._thread = threading.Thread(target=self._server.serve_forever, name="camera-aid", daemon=True)
        self._thread.start()

    @property
    def address(self) -> str:
        """Address of the page."""
        return f"http://{_HOST}:{self._server.server_address[1]}/"

    def show(self, state: dict[str, Any], pictures: dict[str, np.ndarray]) -> None:
        """Show a pair: its numbers, and its images (h, w, 3) by "left" and "right"."""
        self._pictures, self._state = {**self._pictures, **pictures}, state

    def asked_to_save(self) -> bool:
        """Return whether the next pair is to be saved, once for each request of the page."""
        asked = self._asked.is_set()
        self._asked.clear()
        return asked

    def close(self) -> None:
        """End; idempotent."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def _answer(self, path: str) -> tuple[bytes, str] | None:
        """Return content and type of ``path``, None if there is none."""
        if path in _FILES:
            name, kind = _FILES[path]
            return (_FOLDER / name).read_bytes(), kind
        if path == "/state.json":
            return json.dumps(self._state).encode(), "application/json"
        picture = self._pictures.get(path[1:-4]) if path.endswith(".jpg") else None
        return None if picture is None else (cv2.imencode(".jpg", picture)[1].tobytes(), "image/jpeg")

    def _handler(self) -> type[BaseHTTPRequestHandler]:
        server = self

        class Handler(BaseHTTPRequestHandler):
            timeout = 5.0

            def do_GET(self) -> None:
                answer = server._answer(self.path.partition("?")[0]) if self._is_local() else None
                self._send(404 if answer is None else 200, *(answer or (b"", "text/plain")))

            def do_POST(self) -> None:
                # a page of another site cannot set this header
                asked = self.path == "/save" and self._is_local() and "X-Camera-Aid" in self.headers
                if asked:
                    server._asked.set()
                self._send(204 if asked else 403, b"", "text/plain")

            def _is_local(self) -> bool:
                """Whether the page was asked for by this computer's name: not by one that was pointed at it."""
                return self.headers.get("Host", "").rpartition(":")[0] in _NAMES

            def _send(self, status: int, content: bytes, kind: str) -> None:
                self.send_response(status)
                for name, value in (*_HEADERS.items(), ("Content-Type", kind), ("Content-Length", str(len(content)))):
                    self.send_header(name, value)
                self.end_headers()
                self.wfile.write(content)

            def log_message(self, *_: Any) -> None:
                """Print nothing: requests are frequent."""

        return Handler
