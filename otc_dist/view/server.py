"""The page of a run that goes on, and the newest stretch of it, over HTTP.

`/` is the page that `replay --html` writes, with one script more, which asks for `/newest` whenever
it has played what it has. So nothing is done for a page that nobody looks at.
"""

import json
import socket
import sys
import threading
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import parse_qs, urlsplit

from otc_dist.replay import html
from otc_dist.report import files
from otc_dist.run.folder import RunFolder
from otc_dist.system.ports import Port
from otc_dist.terminal.errors import UserError
from otc_dist.terminal.printable import on_page, say
from otc_dist.view.newest import Newest, Step

_PATIENCE = 10.0  # seconds that a client may take for its question, or to take an answer
_WAITING = """<!DOCTYPE html>
<meta charset="utf-8">
<meta http-equiv="refresh" content="1">
<title>{run}</title>
<p>{run}: no step of a deployment has been taken yet. The first ones show by themselves.</p>
"""


def serve(folder: RunFolder, port: Port, over: threading.Event) -> None:
    """Say where the page of a run is, and answer there until it is `over`.

    Raises:
        UserError: `folder` is no run's, there is nothing to be seen, or nobody can listen there.
    """
    going_on = files.run_record(folder).get("state") in files.GOING_ON
    newest = Newest(folder)
    if newest.stretch() is None and not going_on:
        raise UserError(f"{folder.root} has no log of a deployment to show, and does not go on")
    with _Server(port, newest, folder.root.name) as server:
        thread = threading.Thread(target=server.serve_forever, name="server")
        thread.start()
        say(f"http://{port}/")
        over.wait()
        server.shutdown()
        thread.join()


class _Server(ThreadingHTTPServer):
    """Answers browsers, each on a thread of its own.

    Args:
        run: what it is called.

    Raises:
        UserError: nobody can listen there.
    """

    def __init__(self, port: Port, newest: Newest, run: str) -> None:
        self._newest, self._run, self._lock = newest, run, threading.Lock()
        self.address_family = socket.AF_INET6 if ":" in port.host else socket.AF_INET
        try:
            super().__init__((port.host, port.number), _Answer)
        except OSError as error:
            raise port.refused(error) from None

    def page(self) -> str:
        """What a browser is shown first. Raises as `Newest.stretch`."""
        packed = self.stretch(None)
        if packed is None:
            return _WAITING.format(run=on_page(self._run))
        return html.filled(str(packed["title"]), str(packed["lead"]), packed, "live.js")

    def stretch(self, after: Step | None) -> dict[str, object] | None:
        """What `live.js` takes; None if there are no such steps. Raises as `Newest.stretch`."""
        with self._lock:  # a scene's simulator is at one place at a time
            timeline = self._newest.stretch(after)
            if timeline is None:
                return None
            return {
                "title": html.title(timeline),
                "lead": html.about(timeline),
                "deployment": timeline.header.deployment,
                **html.packed(timeline),
            }

    def handle_error(self, request: object, client_address: object) -> None:
        """A browser that has gone is no error."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)  # type: ignore[arg-type]


class _Answer(BaseHTTPRequestHandler):
    server: _Server
    timeout = _PATIENCE

    def do_GET(self) -> None:
        asked = urlsplit(self.path)
        try:
            if asked.path == "/":
                self._send(HTTPStatus.OK, self.server.page(), "text/html")
            elif asked.path == "/newest":
                packed = self.server.stretch(_after(asked.query))
                if packed is None:
                    self._send(HTTPStatus.NO_CONTENT)
                else:
                    self._send(HTTPStatus.OK, json.dumps(packed), "application/json")
            else:
                self._send(HTTPStatus.NOT_FOUND, "there are / and /newest")
        except UserError as error:
            self._send(HTTPStatus.SERVICE_UNAVAILABLE, str(error))

    def log_message(self, *_: object) -> None:
        """What is asked is nobody's concern."""

    def _send(self, status: HTTPStatus, text: str = "", kind: str = "text/plain") -> None:
        body = text.encode()
        self.send_response(status)
        self.send_header("Cache-Control", "no-store")
        if status != HTTPStatus.NO_CONTENT:
            self.send_header("Content-Type", f"{kind}; charset=utf-8")
            self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)


def _after(query: str) -> Step | None:
    """Which step the page has. Raises UserError if the question is none of the page's."""
    asked = parse_qs(query)
    if not asked:
        return None
    try:
        return Step(*(int(asked[name][0]) for name in ("deployment", "step")))
    except (KeyError, ValueError):
        raise UserError("the question is: newest?deployment=K&step=N") from None
