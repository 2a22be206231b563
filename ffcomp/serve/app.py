"""The server's HTTP interface."""

from __future__ import annotations

import json
import os
import shutil
import threading
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import asdict, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Route

from ffcomp.serve import machines, messages
from ffcomp.serve.commands import KINDS, MOVES_PLAN, checked, forms
from ffcomp.serve.guard import Guard
from ffcomp.serve.jobs import Job
from ffcomp.serve.runner import Runner
from ffcomp.serve.settings import MEGABYTE, ServeSettings
from ffcomp.serve.uploads import Refused, Uploads, is_full, new_id
from ffcomp.version import __version__

BODY, MOST_FILES = 1 << 16, 500  # bytes of a request that is not a file, and files of a job
PAGE = {
    "/": ("index.html", "text/html; charset=utf-8"),
    "/page.js": ("page.js", "text/javascript; charset=utf-8"),
    "/jobs.js": ("jobs.js", "text/javascript; charset=utf-8"),
    "/asking.js": ("asking.js", "text/javascript; charset=utf-8"),
    "/page.css": ("serve.css", "text/css; charset=utf-8"),
}
INLINE = {".svg": "image/svg+xml", ".html": "text/html; charset=utf-8"}


class Server:
    """One server: its settings, uploads and jobs."""

    def __init__(self, settings: ServeSettings) -> None:
        settings.folder.mkdir(parents=True, exist_ok=True)
        settings = replace(settings, folder=settings.folder.resolve())  # processes run in folders of their own
        self.settings = settings
        self.uploads = Uploads(settings)
        self.runner = Runner(settings)
        self.creating = threading.Lock()

    def app(self) -> Guard:
        """Return the application."""
        routes = [
            *(Route(path, self._page) for path in PAGE),
            Route("/api/state", self._answer(self.state)),
            Route("/api/forms", self._answer(lambda request, fields: forms())),
            Route("/api/files", self.take, methods=["POST"]),
            Route("/api/jobs", self._answer(self.create), methods=["POST"]),
            Route("/api/jobs/{id}/{action:str}", self._answer(self.act), methods=["POST"]),
            Route("/api/jobs/{id}/log", self._answer(self.log), methods=["GET"]),
            Route("/api/jobs/{id}/files/{name}", self._answer(self.file)),
        ]
        return Guard(Starlette(routes=routes, lifespan=self._lifespan), self.settings)

    @asynccontextmanager
    async def _lifespan(self, app: Starlette) -> AsyncIterator[None]:
        self.uploads.clean()
        self.runner.start()
        yield
        await run_in_threadpool(self.runner.stop)

    # -- the page --

    def _page(self, request: Request) -> Response:
        name, kind = PAGE[request.url.path]
        text = files("ffcomp.serve").joinpath("page", name).read_text(encoding="utf-8")
        if name.endswith(".css"):
            text = files("ffcomp.report").joinpath("page.css").read_text(encoding="utf-8") + text
        return Response(text, media_type=kind)

    def _answer(self, handle: Callable[[Request, Any], Any]) -> Callable[[Request], Awaitable[Response]]:
        """Make a handler of a function that may take its time: of the request and its JSON, to JSON or a response."""

        async def handler(request: Request) -> Response:
            try:
                fields = await _fields_of(request) if request.method == "POST" else {}
                result = await run_in_threadpool(handle, request, fields)
            except Refused as refused:
                return _refusal(refused)
            except OSError as error:
                if not is_full(error):
                    raise
                return _refusal(Refused(507, "The disk is full: remove work that is done, and try again."))
            return result if isinstance(result, Response) else JSONResponse(result)

        return handler

    def state(self, request: Request, fields: Any) -> dict[str, Any]:
        """Return everything that the page shows."""
        return {
            "version": __version__,
            "machines": machines.listed(),
            "jobs": [asdict(replace(job, pid=0)) for job in self.runner.all()],
            "largest_mb": self.settings.largest_bytes // MEGABYTE,
        }

    # -- files and jobs --

    async def take(self, request: Request) -> Response:
        """Take one file, the body of the request."""
        length = request.headers.get("content-length", "0")
        try:
            if length.isdigit() and int(length) > self.settings.largest_bytes:
                raise Refused(413, f"More than {self.settings.largest_bytes // MEGABYTE} MB are not taken here.")
            upload = await self.uploads.take(request.query_params.get("name", ""), request.stream())
        except Refused as refused:
            return _refusal(refused)
        return JSONResponse(asdict(upload), 201)

    def create(self, request: Request, fields: Any) -> dict[str, Any]:
        """Queue a job: `kind`, `files` (ids), `machine` (a name), `options`, and `plan`, the job that made it."""
        kind, options = str(fields.get("kind")), checked(str(fields.get("kind")), fields.get("options", {}))
        ids = fields.get("files", [])
        if not isinstance(ids, list) or len(ids) > MOST_FILES:
            raise Refused(400, "The files must be a list.")
        files = [self.uploads.find(str(each)) for each in ids]
        planned = fields.get("plan")  # the job that has made it
        plan = [self.runner.kept.output(self.runner.find(str(planned)), MOVES_PLAN)] if planned else []
        if len(files) not in KINDS[kind].inputs:
            raise Refused(400, "That needs a file." if not files else "That takes one file at a time.")
        machine = str(fields.get("machine") or "")
        if KINDS[kind].machine:
            machines.path_of(machine)
        if len(KINDS[kind].inputs) > 1 and any(upload.name.lower().endswith(".json") for upload, _ in files):
            raise Refused(400, "A plan is not dropped: choose the moves that this server has written.")
        names = [upload.name for upload, _ in files] + [path.name for path in plan]
        if len(set(names)) < len(names):
            raise Refused(400, "Two of the files have the same name.")
        title = KINDS[kind].title.format(name=names[0] if names else "", machine=machine)
        job = Job(new_id(), kind, title, machine if KINDS[kind].machine else "", tuple(names), options)

        def place(folder: Path) -> None:
            for path in (*(path for _, path in files), *plan):
                _link(path, folder / path.name)

        with self.creating:
            made = self.runner.add(job, place)
        return asdict(made)

    def act(self, request: Request, fields: Any) -> dict[str, Any]:
        """Do one thing with a job: cancel, again, remove, keep its machine file."""
        id_, action = request.path_params["id"], request.path_params["action"]
        if action == "cancel":
            return asdict(self.runner.cancel(id_))
        if action == "again":
            return asdict(self.runner.again(id_))
        if action == "remove":
            self.runner.remove(id_)
            return {}
        if action == "keep":
            return {"machine": machines.keep(self.runner.find(id_), self.runner.kept, str(fields.get("name", "")))}
        raise Refused(404, "There is no such action.")

    def log(self, request: Request, fields: Any) -> Response:
        """Return what the processes of a job have said."""
        job = self.runner.find(request.path_params["id"])
        text = messages.log_end(self.runner.kept.place(job.id))
        return Response(text, media_type="text/plain; charset=utf-8")

    def file(self, request: Request, fields: Any) -> Response:
        """Give a file that a job has made; pictures and pages to be looked at with `?view=1`."""
        job = self.runner.find(request.path_params["id"])
        path = self.runner.kept.output(job, request.path_params["name"])
        kind = INLINE.get(path.suffix)
        if kind and request.query_params.get("view"):
            return FileResponse(path, media_type=kind)
        return FileResponse(path, filename=path.name, media_type="application/octet-stream")


def _refusal(refused: Refused) -> Response:
    return JSONResponse({"error": refused.sentence}, refused.status)


async def _fields_of(request: Request) -> Any:
    """Read a request's JSON, which is small."""
    body = b""
    async for piece in request.stream():
        body += piece
        if len(body) > BODY:
            raise Refused(413, "The request is too large.")
    try:
        fields = json.loads(body or b"{}")
    except ValueError:
        fields = None
    if not isinstance(fields, dict):
        raise Refused(400, "The request is not a JSON object.")
    return fields


def _link(source: Path, target: Path) -> None:
    """Put a file into a job's folder without taking its room twice, where the file system can."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copyfile(source, target)
