"""`ffcomp serve`: everything that a person does with files, on a page in the browser."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ffcomp.request import ADVANCED, OUTPUT, REACH, SPEED

if TYPE_CHECKING:
    from socket import socket

    import uvicorn

    from ffcomp.serve.guard import Guard
    from ffcomp.serve.settings import Settings

Host = Annotated[
    str,
    typer.Option(
        metavar="ADDRESS",
        rich_help_panel=REACH,
        help="Address to listen on. Others than this computer's own ask every visitor for a token.",
    ),
]
Port = Annotated[int, typer.Option(metavar="N", min=0, max=65535, rich_help_panel=REACH, help="Port to listen on.")]
Name = Annotated[
    list[str] | None,
    typer.Option(
        "--name",
        metavar="NAME",
        rich_help_panel=REACH,
        help="Another name by which browsers reach this server. May be repeated.",
    ),
]
Frame = Annotated[
    list[str] | None,
    typer.Option(
        "--frame",
        metavar="URL",
        rich_help_panel=REACH,
        help="Address of a page that may show this one as a panel, e.g. http://mainsailos.local. May be repeated.",
    ),
]
Certificate = Annotated[
    Path | None,
    typer.Option("--certificate", metavar="FILE", rich_help_panel=REACH, help="Certificate, for HTTPS (PEM)."),
]
Key = Annotated[
    Path | None, typer.Option("--key", metavar="FILE", rich_help_panel=REACH, help="Its private key (PEM).")
]
Moonraker = Annotated[
    str,
    typer.Option(
        metavar="URL",
        rich_help_panel=REACH,
        help="The printer's Moonraker, e.g. http://mainsailos.local:7125: its prints are listed, and compensated ones "
        "put beside them.",
    ),
]
Folder = Annotated[
    Path | None,
    typer.Option(
        "--folder", metavar="DIR", rich_help_panel=OUTPUT, help="Where work is kept. Default: the user's data folder."
    ),
]
Keep = Annotated[
    float, typer.Option(metavar="N", min=0.01, rich_help_panel=OUTPUT, help="Remove work that ended N days ago.")
]
Room = Annotated[
    float, typer.Option(metavar="GB", min=0.1, rich_help_panel=OUTPUT, help="Largest size of all work together.")
]
Largest = Annotated[int, typer.Option(metavar="MB", min=1, rich_help_panel=OUTPUT, help="Largest file that is taken.")]
Jobs = Annotated[
    int, typer.Option("--jobs", "-j", metavar="N", min=1, rich_help_panel=SPEED, help="Jobs at the same time.")
]
Open = Annotated[bool, typer.Option("--open", rich_help_panel=ADVANCED, help="Open the page in the browser.")]


def serve(
    host: Host = "127.0.0.1",
    port: Port = 8017,
    name: Name = None,
    frame: Frame = None,
    certificate: Certificate = None,
    key: Key = None,
    moonraker: Moonraker = "",
    folder: Folder = None,
    keep_days: Keep = 14.0,
    room_gb: Room = 20.0,
    largest_mb: Largest = 1024,
    jobs: Jobs = 1,
    open_it: Open = False,
) -> None:
    """Serve a page to drop prints on, in the browser, on this computer.

    Prints are compensated, compared and looked at there, machines imported, moves planned and captures diagnosed.
    Nothing leaves this computer. End it with Ctrl-C; work that waits goes on when it is started again.

    Example: ffcomp serve --open
    """
    from ffcomp.cli.common import exit_codes, require

    with exit_codes():
        for package in ("starlette", "uvicorn"):
            require(package)
        if (certificate is None) != (key is None):
            raise typer.BadParameter("--certificate and --key go together.")
        from ffcomp.serve.settings import is_local, kept_token

        kept = folder or _data_folder()
        settings = _settings(
            kept, host, port, jobs, largest_mb, room_gb, keep_days, name, frame, moonraker, certificate is not None
        )
        if not is_local(host):
            from dataclasses import replace

            settings = replace(settings, token=kept_token(kept))
        _run(settings, certificate, key, open_it)


def _settings(
    folder: Path,
    host: str,
    port: int,
    jobs: int,
    largest_mb: int,
    room_gb: float,
    keep_days: float,
    name: list[str] | None,
    frame: list[str] | None,
    moonraker: str,
    secure: bool,
) -> Settings:
    from urllib.parse import urlsplit

    from ffcomp.serve.settings import MEGABYTE, Settings

    for url in (*(frame or ()), *([moonraker] if moonraker else [])):
        if urlsplit(url).scheme not in ("http", "https") or not urlsplit(url).hostname or set(url) & set(" ;,'\""):
            raise typer.BadParameter(f"{url}: an address begins with http:// or https://.")
    return Settings(
        folder=folder,
        host=host,
        port=port,
        jobs=jobs,
        largest_bytes=largest_mb * MEGABYTE,
        room_bytes=int(room_gb * 1024 * MEGABYTE),
        keep_days=keep_days,
        names=tuple(name or ()),
        frames=tuple(frame or ()),
        moonraker=moonraker,
        secure=secure,
    )


def _data_folder() -> Path:
    import platformdirs

    return Path(platformdirs.user_data_dir("ffcomp")) / "serve"


def _run(settings: Settings, certificate: Path | None, key: Path | None, open_it: bool) -> None:
    from contextlib import suppress
    from dataclasses import replace

    import uvicorn

    from ffcomp.cli.compiled import first_run
    from ffcomp.serve.app import Server

    with _listening(settings) as door:
        settings = replace(settings, port=door.getsockname()[1])
        app = Server(settings, warm=not first_run("compensate")).app()
        _say(settings)
        if open_it:
            typer.launch(settings.address)
        with suppress(KeyboardInterrupt):  # that is how it ends
            uvicorn.Server(_config(app, certificate, key)).run([door])


def _listening(settings: Settings) -> socket:
    """Open the port before anything is promised about it."""
    import socket as sockets

    from ffcomp.errors import RequestError

    family = sockets.AF_INET6 if ":" in settings.host else sockets.AF_INET
    try:
        return sockets.create_server((settings.host, settings.port), family=family, backlog=128)
    except OSError as error:
        where = f"{settings.host}, port {settings.port}"
        raise RequestError(f"{where}: {error.strerror or error}. Choose another with --port N.") from None


def _config(app: Guard, certificate: Path | None, key: Path | None) -> uvicorn.Config:
    import uvicorn

    return uvicorn.Config(
        app,
        log_level="warning",
        access_log=False,
        server_header=False,
        ws="none",
        timeout_keep_alive=20,
        timeout_graceful_shutdown=3,
        limit_concurrency=300,
        ssl_certfile=None if certificate is None else str(certificate),
        ssl_keyfile=None if key is None else str(key),
    )


def _say(settings: Settings) -> None:
    """Print the address on stdout; what to mind of it on stderr."""
    from ffcomp.cli.common import say

    print(f"{settings.address}{'?token=' + settings.token if settings.token else ''}", flush=True)
    say(f"ffcomp: Work is kept in {settings.folder}. End with Ctrl-C.")
    if settings.token and not settings.secure:
        say(
            "ffcomp: Other computers can reach this page, with the token of the address above. Without HTTPS the token "
            "and your prints can be read on the way: use it in your own network only, or give --certificate and --key, "
            "or reach it by ssh -L 8017:localhost:8017."
        )
    sys.stderr.flush()
