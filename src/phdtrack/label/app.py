"""The page on which a person marks false detections and births: its addresses, and what they answer."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from phdtrack.errors import InputError
from phdtrack.label import Label, Mark
from phdtrack.label.session import Session

STATIC = Path(__file__).parent / "static"
# A person's clicks: a lasso around every box of a full frame is far below.
_LONGEST = 4_000_000
_KEPT = {"Cache-Control": "private, max-age=86400, immutable"}


def label_app(session: Session) -> Starlette:
    """The application; put `guard.Guard` around it before anybody is let in."""

    def answer(work: Callable[[Request, dict[str, Any]], Response]) -> Callable[[Request], Any]:
        """``work`` in a thread, with the JSON that was sent; what it cannot use is a 400 with a sentence."""

        async def endpoint(request: Request) -> Response:
            try:
                sent = await _sent(request)
                return await run_in_threadpool(work, request, sent)
            except InputError as error:
                return JSONResponse({"error": str(error)}, 400)

        return endpoint

    def number(request: Request) -> int:
        return int(request.path_params["number"])

    def page(request: Request, sent: dict[str, Any]) -> Response:
        return Response((STATIC / "label.html").read_bytes(), media_type="text/html; charset=utf-8")

    def overview(request: Request, sent: dict[str, Any]) -> Response:
        return JSONResponse(session.overview())

    def frame(request: Request, sent: dict[str, Any]) -> Response:
        return JSONResponse(session.frame(number(request)))

    def still(request: Request, sent: dict[str, Any]) -> Response:
        session.frame(number(request))
        return Response(session.still(number(request)), media_type="image/jpeg", headers=_KEPT)

    def crop(request: Request, sent: dict[str, Any]) -> Response:
        data = session.crop(number(request), int(request.path_params["box"]))
        return Response(data, media_type="image/jpeg", headers=_KEPT)

    def alike(request: Request, sent: dict[str, Any]) -> Response:
        return JSONResponse(session.alike(number(request), int(request.path_params["box"])))

    def suggestions(request: Request, sent: dict[str, Any]) -> Response:
        return JSONResponse(session.suggestions())

    def place_map(request: Request, sent: dict[str, Any]) -> Response:
        mark: Mark = "birth" if request.path_params["mark"] == "birth" else "false"
        return Response(session.place_map(mark), media_type="image/png")

    def export(request: Request, sent: dict[str, Any]) -> Response:
        lines = ["frame,box,mark", *(f"{x.frame},{x.box},{x.mark}" for x in session.store.labels())]
        name = {"Content-Disposition": 'attachment; filename="labels.csv"'}
        return PlainTextResponse("\n".join(lines) + "\n", media_type="text/csv", headers=name)

    def change(request: Request, sent: dict[str, Any]) -> Response:
        at, key = number(request), _text(sent, "key")
        match request.path_params["what"]:
            case "marks":
                marks = session.checked([_label(item) for item in sent.get("marks", [])])
                session.store.mark(at, marks, _text(sent, "who"), key)
            case "undo":
                session.store.undo(at, key)
            case "redo":
                session.store.redo(at, key)
            case "done":
                session.store.finish(at, bool(sent.get("done", True)), key)
            case what:
                return JSONResponse({"error": f"nothing is called {what}"}, 404)
        return JSONResponse(session.frame(at) | {"progress": session.overview()["progress"]})

    return Starlette(
        routes=[
            Route("/", answer(page)),
            Route("/api/overview", answer(overview)),
            Route("/api/frame/{number:int}", answer(frame)),
            Route("/api/frame/{number:int}/alike/{box:int}", answer(alike)),
            Route("/api/frame/{number:int}/{what:str}", answer(change), methods=["POST"]),
            Route("/api/suggestions", answer(suggestions)),
            Route("/api/map/{mark:str}.png", answer(place_map)),
            Route("/api/labels.csv", answer(export)),
            Route("/still/{number:int}.jpg", answer(still)),
            Route("/crop/{number:int}/{box:int}.jpg", answer(crop)),
            Mount("/static", StaticFiles(directory=STATIC)),
        ]
    )


async def _sent(request: Request) -> dict[str, Any]:
    """The JSON object of a request that changes something; {} of one that asks."""
    if request.method != "POST":
        return {}
    body = bytearray()
    async for part in request.stream():
        body += part
        if len(body) > _LONGEST:
            raise InputError(f"expected at most {_LONGEST} bytes")
    import json

    try:
        sent = json.loads(body or b"{}")
    except ValueError:
        raise InputError("expected JSON") from None
    if not isinstance(sent, dict):
        raise InputError("expected a JSON object")
    return sent


def _text(sent: dict[str, Any], name: str) -> str:
    value = sent.get(name, "")
    if not isinstance(value, str) or len(value) > 100:
        raise InputError(f"expected a short text as {name}")
    return value


def _label(item: Any) -> Label:
    if not isinstance(item, dict) or type(item.get("frame")) is not int or type(item.get("box")) is not int:
        raise InputError("expected marks as objects with frame, box and mark", cure="Reload the page")
    return Label(item["frame"], item["box"], item.get("mark", ""))
