"""Endpoints that answer with the result of a function, and with static files."""

from __future__ import annotations

import mimetypes
from collections.abc import Awaitable, Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from phdtrack.errors import InputError
from phdtrack.files import json_value

JSON = "application/json"
MAX_BODY = 2**20
"""Bytes that a request may send."""
Endpoint = Callable[[Request], Awaitable[Response]]


def static(folder: Path) -> list[Route]:
    """Routes to the files of a folder, read once, below /static."""

    def endpoint_of(file: Path) -> Endpoint:
        data = file.read_bytes()
        media = mimetypes.guess_type(file.name)[0]

        async def answer(request: Request) -> Response:
            return Response(data, media_type=media)

        return answer

    return [Route(f"/static/{file.name}", endpoint_of(file)) for file in sorted(folder.iterdir())]


def endpoint(
    work: Callable[..., Any],
    media: str = JSON,
    headers: Mapping[str, str] | None = None,
    query: Sequence[str] = (),
) -> Endpoint:
    """An endpoint that answers with the result of ``work``, which runs in a thread; an `InputError`
    becomes a 400 with its sentence.

    Parameters
    ----------
    work : is called with the parameters of the path, those of the ``query``, and as ``sent`` the
        body of a POST.
    media : type of the answer; `JSON` encodes the result.
    headers : of the answer.
    query : names of parameters; one that the address lacks is empty.
    """

    async def answer(request: Request) -> Response:
        arguments: dict[str, Any] = dict(request.path_params)
        for name in query:
            arguments[name] = request.query_params.get(name, "")
        if request.method == "POST":
            arguments["sent"] = await _body(request)
        try:
            result = await run_in_threadpool(work, **arguments)
        except InputError as error:
            return JSONResponse({"error": str(error)}, 400)
        if media == JSON:
            return JSONResponse(json_value(result))
        return Response(result, 200, headers, media)

    return answer


async def _body(request: Request) -> bytes:
    """The body of a request. Raises `HTTPException` if it is too long."""
    body = bytearray()
    async for part in request.stream():
        body += part
        if len(body) > MAX_BODY:
            raise HTTPException(413, f"expected at most {MAX_BODY} bytes")
    return bytes(body)
