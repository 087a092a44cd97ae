"""An object store over HTTP that serves a folder, and faulty answers."""

import contextlib
import re
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import parse_qs, unquote, urlsplit

from store_faults import Answer, listing, objects, status, with_length


class Handler(BaseHTTPRequestHandler):
    """Serves `/BUCKET/SCENE/...`, where a scene may have a fault."""

    def do_GET(self) -> None:
        """A listing or an object."""
        parts = urlsplit(self.path)
        query = parse_qs(parts.query)
        self.prefix = unquote(query.get("prefix", [""])[0])
        is_listing = "list-type" in query or "prefix" in query
        place = self.prefix if is_listing else unquote(parts.path).removeprefix("/bucket/")
        scene = place.partition("/")[0]
        target, answer = self.server.faults.get(scene, ("", None))
        if answer and (target == "list") == is_listing and (is_listing or re.search(target, place)):
            self.server.served[scene] = self.server.served.get(scene, 0) + 1
        elif is_listing:
            answer = listing(objects)
        else:
            path = self.server.folder / place.partition("/")[2]
            known = path.resolve().is_relative_to(self.server.folder) and path.is_file()
            answer = with_length(path.stat().st_size, path.read_bytes()) if known else status("404 No")
        self.close_connection = True
        with contextlib.suppress(OSError):
            for part in answer(self):
                self.wfile.write(part)

    do_HEAD = do_GET

    def objects(self) -> Iterator[tuple[str, int]]:
        """Keys and sizes of the objects below the prefix of a listing."""
        scene, _, inner = self.prefix.partition("/")
        for path in sorted(self.server.folder.rglob("*")):
            name = str(path.relative_to(self.server.folder))
            if path.is_file() and name.startswith(inner):
                yield f"{scene}/{name}", path.stat().st_size

    def log_message(self, *_: object) -> None:
        """Says nothing."""


class Store(ThreadingHTTPServer):
    """A server on loopback of a folder."""

    daemon_threads = True

    def __init__(self, folder: Path) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.folder = folder.resolve()
        self.faults: dict[str, tuple[str, Answer]] = {}
        """By scene: `list` or a pattern of objects, and what is answered."""
        self.served: dict[str, int] = {}
        """Faulty answers by scene."""
        threading.Thread(target=self.serve_forever, daemon=True).start()

    @property
    def endpoint(self) -> str:
        """Its address."""
        return f"http://127.0.0.1:{self.server_port}"

    def handle_error(self, *_: object) -> None:
        """Clients that leave are expected."""
