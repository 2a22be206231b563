"""`ffcomp serve`: everything that a person does with files, on a page in the browser."""

from __future__ import annotations

import sys
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from ffcomp.cli.command import verb
from ffcomp.cli.common import require, say
from ffcomp.errors import RequestError
from ffcomp.request import ADVANCED, OUTPUT, REACH, SPEED, Option, Request, shared_with

if TYPE_CHECKING:
    from socket import socket

    from ffcomp.serve.settings import ServeSettings


@dataclass(frozen=True)
class ServeRequest(Request):
    """A server: who reaches it, and what it keeps."""

    host: Annotated[
        str,
        Option(
            "Address to listen on. Any other than this computer's own requires a token from every visitor.",
            REACH,
            metavar="ADDRESS",
        ),
    ] = "127.0.0.1"
    port: Annotated[int, Option("Port to listen on.", REACH, metavar="N", low=0, high=65535)] = 8017
    name: Annotated[
        tuple[str, ...], Option("Another host name of this server. May be repeated.", REACH, metavar="NAME")
    ] = ()
    certificate: Annotated[Path | None, Option("Certificate, for HTTPS (PEM).", REACH, metavar="FILE")] = None
    key: Annotated[Path | None, Option("Its private key (PEM).", REACH, metavar="FILE")] = None
    folder: Annotated[
        Path | None, Option("Where work is kept. Default: the user's data folder.", OUTPUT, metavar="DIR")
    ] = None
    largest_mb: Annotated[int, Option("Largest accepted file.", OUTPUT, metavar="MB", low=1)] = 1024
    jobs: Annotated[int, Option("Jobs that run at the same time.", SPEED, "--jobs -j", metavar="N", low=1)] = 1
    open_it: Annotated[bool, Option("Open the page in the browser.", ADVANCED, "--open")] = False

    def check(self) -> None:
        """Check that a certificate has its key."""
        if (self.certificate is None) != (self.key is None):
            raise RequestError("--certificate and --key go together.")


@verb
def serve(request: ServeRequest) -> None:
    """Serve a web page on this computer where you drop prints.

    The page compensates and compares prints, imports machines, plans measurements and diagnoses captures. Nothing
    leaves this computer. Stop it with Ctrl-C; waiting jobs continue after the next start.

    Example: ffcomp serve --open
    """
    for package in ("starlette", "uvicorn"):
        require(package)
    import webbrowser

    import uvicorn

    from ffcomp.serve.app import Server
    from ffcomp.serve.settings import MEGABYTE, ServeSettings, is_local, kept_token

    folder = request.folder
    if folder is None:
        import platformdirs

        folder = Path(platformdirs.user_data_dir("ffcomp")) / "serve"
    settings = ServeSettings(
        **shared_with(request, ServeSettings, folder=folder, names=request.name),
        largest_bytes=request.largest_mb * MEGABYTE,
        secure=request.certificate is not None,
        token="" if is_local(request.host) else kept_token(folder),
    )
    with _listening(settings) as door:
        settings = replace(settings, port=door.getsockname()[1])
        app = Server(settings).app()
        _say(settings)
        if request.open_it:
            webbrowser.open(settings.address)
        with suppress(KeyboardInterrupt):  # that is how it ends
            uvicorn.Server(
                uvicorn.Config(
                    app,
                    log_level="warning",
                    access_log=False,
                    server_header=False,
                    ws="none",
                    timeout_keep_alive=20,
                    timeout_graceful_shutdown=3,
                    limit_concurrency=300,
                    ssl_certfile=request.certificate,
                    ssl_keyfile=None if request.key is None else str(request.key),
                )
            ).run([door])


def _listening(settings: ServeSettings) -> socket:
    """Open the port before anything is promised about it."""
    import socket as sockets

    family = sockets.AF_INET6 if ":" in settings.host else sockets.AF_INET
    try:
        return sockets.create_server((settings.host, settings.port), family=family, backlog=128)
    except OSError as error:
        where = f"{settings.host}, port {settings.port}"
        raise RequestError(f"{where}: {error.strerror or error}. Choose another with --port N.") from None


def _say(settings: ServeSettings) -> None:
    """Print the address on stdout, warnings on stderr."""
    print(f"{settings.address}{'?token=' + settings.token if settings.token else ''}", flush=True)
    say(f"ffcomp: Work is kept in {settings.folder}. End with Ctrl-C.")
    if settings.token and not settings.secure:
        say(
            "ffcomp: Other computers can reach this page, with the token of the address above. Without HTTPS the token "
            "and your prints can be read on the way: use it in your own network only, or give --certificate and --key, "
            "or reach it by ssh -L 8017:localhost:8017."
        )
    sys.stderr.flush()
