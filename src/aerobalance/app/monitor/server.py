"""The web server: the page, its actions, the reports, and the viewers' sockets."""

from __future__ import annotations

import asyncio
import contextlib
import json
import threading
import time
from collections.abc import AsyncIterator, Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Final
from urllib.parse import quote

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from starlette.applications import Starlette
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, JSONResponse, Response, StreamingResponse
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket

from aerobalance.acquisition.setup import setup_from
from aerobalance.acquisition.source_settings import RigName
from aerobalance.app.monitor.access import REPORT_POLICY, AccessControl, AccessPolicy
from aerobalance.app.monitor.checks import Kind
from aerobalance.app.monitor.display import DisplayState, plain
from aerobalance.app.monitor.folder import RECORDINGS
from aerobalance.app.monitor.form import form_of
from aerobalance.app.monitor.messages import News, Watching
from aerobalance.app.monitor.session import Beginning, MonitorSession
from aerobalance.app.monitor.setups import check_files, rig_setup
from aerobalance.app.monitor.state import state_of
from aerobalance.app.monitor.tasks import TOGETHER
from aerobalance.app.monitor.viewer import Viewer
from aerobalance.app.options import as_options
from aerobalance.io.locked_file import is_locked
from aerobalance.io.messages import first_fault
from aerobalance.recording.errors import FitError, ReadError

STATIC: Final = Path(__file__).parent / "static"

LARGEST_BODY: Final = 1_000_000
"""Largest body of a request [bytes]."""

MOST_VIEWERS: Final = 16
"""Viewers at once."""

LATEST_PRESS: Final = 10.0
"""Time that a press of a button may be on its way [s]."""

Short = Annotated[str, Field(max_length=100)]
Text = Annotated[str, Field(max_length=10_000)]


class _Body(BaseModel):
    model_config = ConfigDict(extra="forbid")


class _RecordBody(_Body):
    name: Short
    notes: Text = ""
    seconds: Annotated[float, Field(gt=0, le=1e7, allow_inf_nan=False)] | None = None
    pressed: Annotated[float, Field(allow_inf_nan=False)] | None = None

    @property
    def asked(self) -> float:
        """When the button was pressed, on the steady clock [s]; the page says it by this computer's clock [ms]."""
        ago = 0.0 if self.pressed is None else time.time() - self.pressed / 1e3
        return time.monotonic() - min(max(ago, 0.0), LATEST_PRESS)


class _Mark(_Body):
    text: Annotated[str, Field(max_length=200)] = ""


class _Control(_Body):
    name: Short
    value: Annotated[float, Field(allow_inf_nan=False)] = 0.0


class _TaskBody(_Body):
    verb: Annotated[str, Field(pattern="^(info|decay|rig|force|together)$")]
    recording: Short
    others: Annotated[list[Short], Field(max_length=TOGETHER)] = []
    component: Annotated[str, Field(pattern="^[A-Z]{2}$")] | None = None
    mass: Annotated[str, Field(max_length=30, pattern=r"^[0-9.eE+-]*$")] | None = None
    dynamics: Short | None = None


class _Apply(_Body):
    setup: dict[str, Any]
    name: Short | None = None


class _Rig(_Body):
    rig: RigName


class _Use(_Body):
    recording: Short


class _Test(_Body):
    test: Short


class _Check(_Body):
    kind: Kind


class _Empty(_Body):
    pass


class _Stop(_Body):
    pass


class Page:
    """The page's server without its network: what is shown, the session, and the application.

    Parameters
    ----------
    begin
        What it begins with.
    policy
        Who may use it.
    """

    def __init__(self, begin: Beginning, *, policy: AccessPolicy) -> None:
        self.display = DisplayState()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._version = 0
        self._state_text = ""
        self._state_of = -1
        self._viewers = 0
        self._begin = begin
        self.session: MonitorSession
        self.ending = asyncio.Event()
        self._hands = ThreadPoolExecutor(2)
        self.app = AccessControl(
            Starlette(
                routes=[
                    Route("/", self._index),
                    Route("/api/state", self._get_state),
                    Route("/api/recordings", self._get_recordings),
                    Route("/api/setup", self._get_setup),
                    Route("/api/tests", self._get_tests),
                    Route("/api/task/{number:int}", self._get_task),
                    Route("/api/{action}", self._act, methods=["POST"]),
                    Route("/report/{name}", self._report),
                    Route("/file/{name}", self._file),
                    Route("/campaign/{name:path}", self._campaign_page),
                    WebSocketRoute("/live", self._live),
                    Mount("/static", StaticFiles(directory=STATIC)),
                ],
                lifespan=self._lifespan,
            ),
            policy,
        )
        self._actions: Mapping[str, tuple[type[_Body], Callable[[Any], Any]]] = {
            "record": (_RecordBody, self._record),
            "stop": (_Stop, lambda _: self.session.records.stop()),
            "trigger": (_Empty, lambda _: self.session.records.call()),
            "mark": (_Mark, lambda it: self.session.records.note(it.text or "mark")),
            "zero": (_Empty, lambda _: self.session.zero()),
            "acknowledge": (_Empty, lambda _: self.session.alarms.acknowledge()),
            "clear_zero": (_Empty, lambda _: self.session.clear_zero()),
            "test": (_Check, lambda it: self.session.checks.press(it.kind)),
            "give_up": (_Empty, lambda _: self.session.checks.give_up()),
            "control": (_Control, lambda it: self.session.source.control(it.name, it.value)),
            "job": (_TaskBody, self._job),
            "use": (_Use, lambda it: self.session.use_dynamics(it.recording)),
            "cancel": (_Empty, lambda _: self.session.tasks.cancel()),
            "setup": (_Apply, self._apply),
            "check": (_Apply, lambda it: check_files(setup_from(it.setup), self.session.folder)),
            "rig": (_Rig, self._rig),
            "sweep": (_Empty, lambda _: self.session.begin_sweep()),
            "watch": (_Test, lambda it: self.session.campaign.begin(it.test)),
            "end_watch": (_Empty, lambda _: self.session.campaign.end()),
            "restart": (_Empty, lambda _: self.session.open()),
        }

    # ---- life

    @contextlib.asynccontextmanager
    async def _lifespan(self, _: Starlette) -> AsyncIterator[None]:
        self._loop = asyncio.get_running_loop()
        self.session = MonitorSession(self._begin, heard=self._heard, changed=self._changed, mark=self._marked)
        opening = threading.Thread(target=self.session.open, daemon=True)
        opening.start()
        try:
            yield
        finally:
            self.ending.set()
            await self.display.tell()
            await asyncio.to_thread(self.session.close)
            self._hands.shutdown(wait=False)

    def close(self) -> None:
        """End what is behind the page, where it has begun."""
        session = getattr(self, "session", None)
        if session is not None:
            session.close()

    def _call(self, what: Callable[[], None]) -> None:
        """Have something done in the server's loop, from any thread."""
        if self._loop is not None:
            with contextlib.suppress(RuntimeError):  # the loop has ended
                self._loop.call_soon_threadsafe(what)

    def _heard(self, answer: Watching | News) -> None:
        self._call(partial(self._show, answer))

    def _show(self, answer: Watching | News) -> None:
        if isinstance(answer, Watching):
            self.display.begin(answer)
        else:
            self.display.take(answer)
        self._wake()

    def _marked(self, text: str, kind: str) -> None:
        self._call(lambda: self.display.mark(text, kind=kind))

    def _changed(self) -> None:
        def change() -> None:
            self._version += 1
            self._wake()

        self._call(change)

    def _wake(self) -> None:
        if self._loop is not None:
            self._loop.create_task(self.display.tell())

    def _state(self) -> tuple[int, str]:
        """Version of the state and its text, drawn up once for all viewers."""
        if self._state_of != self._version:
            self._state_of = self._version
            self._state_text = json.dumps(plain({"type": "state", **state_of(self.session)}), separators=(",", ":"))
        return self._version, self._state_text

    # ---- pages and files

    async def _index(self, _: Request) -> Response:
        return FileResponse(STATIC / "index.html", media_type="text/html; charset=utf-8")

    async def _get_state(self, _: Request) -> Response:
        state = await asyncio.to_thread(state_of, self.session)
        more = {"numbers": self.display.numbers, "viewers": self._viewers, "processes": self.session.processes()}
        return JSONResponse(plain(state | more))

    async def _get_recordings(self, _: Request) -> Response:
        try:
            return JSONResponse(plain(await asyncio.to_thread(self.session.folder.with_results)))
        except OSError as problem:
            return JSONResponse({"error": str(problem)}, 409)

    async def _get_setup(self, _: Request) -> Response:
        source = self.session.source
        info = None if source.session is None else source.session.info
        return JSONResponse(plain(form_of(source.setup, info)))

    async def _get_task(self, request: Request) -> Response:
        task = self.session.tasks.listed.get(request.path_params["number"])
        return JSONResponse(plain(task)) if task else JSONResponse({"error": "there is no such task"}, 404)

    async def _get_tests(self, _: Request) -> Response:
        return JSONResponse(await asyncio.to_thread(self.session.campaign.tests))

    async def _report(self, request: Request) -> Response:
        try:
            path = self.session.folder.file(request.path_params["name"])
        except ValueError as problem:
            return JSONResponse({"error": str(problem)}, 404)
        if path.suffix != ".html" or not path.is_file():
            return JSONResponse({"error": "there is no such report"}, 404)
        return _shown(path)

    async def _campaign_page(self, request: Request) -> Response:
        try:
            return _shown(self.session.campaign.page(request.path_params["name"]))
        except ValueError as problem:
            return JSONResponse({"error": str(problem)}, 404)

    async def _file(self, request: Request) -> Response:
        try:
            path = self.session.folder.file(request.path_params["name"])
        except ValueError as problem:
            return JSONResponse({"error": str(problem)}, 404)
        if path.suffix.lower() not in (*RECORDINGS, ".json", ".toml", ".html") or not path.is_file():
            return JSONResponse({"error": "there is no such file"}, 404)
        return await asyncio.to_thread(_download, path)

    # ---- actions

    async def _act(self, request: Request) -> Response:
        action = self._actions.get(request.path_params["action"])
        if action is None:
            return JSONResponse({"error": "there is no such action"}, 404)
        model, act = action
        try:
            body = model.model_validate_json(await _body(request))
            # a record can be stopped whatever else is asked for and not done yet
            hands = self._hands if model is _Stop else None
            found = await asyncio.get_running_loop().run_in_executor(hands, act, body)
        except ClientDisconnect:
            return Response(status_code=400)  # to nobody
        except (_TooLargeError, ValidationError, ReadError, FitError, ValueError, OSError) as problem:
            return _refusal(problem, model)
        return JSONResponse({"done": True, "number": found if isinstance(found, int) else None})

    def _record(self, body: _RecordBody) -> None:
        self.session.records.begin(body.name, notes=body.notes, seconds=body.seconds, asked=body.asked)

    def _job(self, body: _TaskBody) -> int:
        settings = {key: value for key in ("component", "mass", "dynamics") if (value := getattr(body, key))}
        return self.session.tasks.run(body.verb, [body.recording, *body.others], settings)

    def _apply(self, body: _Apply) -> None:
        self.session.apply(setup_from(body.setup), name=body.name)

    def _rig(self, body: _Rig) -> None:
        self.session.apply(rig_setup(body.rig), name=None)

    # ---- viewers

    async def _live(self, socket: WebSocket) -> None:
        if self._viewers >= MOST_VIEWERS:
            await socket.close(1013, f"{MOST_VIEWERS} viewers are connected already")
            return
        await socket.accept()
        self._viewers += 1
        serving = asyncio.create_task(Viewer(socket, self.display, self._state).serve())
        ending = asyncio.create_task(self.ending.wait())
        try:
            await asyncio.wait((serving, ending), return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._viewers -= 1
            serving.cancel()
            ending.cancel()
            with contextlib.suppress(asyncio.CancelledError, Exception):
                await serving
            with contextlib.suppress(Exception):
                await socket.close(1001)


def _shown(path: Path) -> Response:
    """A report, which shows itself and does nothing else."""
    return FileResponse(
        path, media_type="text/html; charset=utf-8", headers={"content-security-policy": REPORT_POLICY}
    )


def _download(path: Path) -> Response:
    """A file to be kept; what a record that is being written holds at this moment, as a whole file."""
    if not is_locked(path):
        return FileResponse(path, media_type="application/octet-stream", filename=path.name)
    from aerobalance.io.hdf5_snapshot import FileSnapshot  # noqa: PLC0415 - the library of HDF5 comes with it

    try:
        snapshot = FileSnapshot(path)
    except (ReadError, OSError) as problem:
        return JSONResponse({"error": getattr(problem, "what", str(problem))}, 409)
    quoted = quote(path.name)
    headers = {
        "content-length": str(snapshot.size),
        "content-disposition": f"attachment; filename*=utf-8''{quoted}",
    }
    return StreamingResponse(snapshot.parts(), media_type="application/octet-stream", headers=headers)


class _TooLargeError(Exception):
    """A request has a body that is too large."""


async def _body(request: Request) -> bytes:
    """Body of a request, of a limited size."""
    parts, size = [], 0
    async for part in request.stream():
        size += len(part)
        if size > LARGEST_BODY:
            raise _TooLargeError(f"the request is larger than {LARGEST_BODY} bytes")
        parts.append(part)
    return b"".join(parts) or b"{}"


def _refusal(problem: Exception, model: type[_Body]) -> Response:
    """Return what was wrong with a request, and with which field."""
    if isinstance(problem, ValidationError):
        where, what = first_fault(problem, model)
        text = f"{where}: {what}" if where else "the request is no JSON"
        return JSONResponse({"error": text, "where": where}, 422)
    if isinstance(problem, ReadError):
        return JSONResponse({"error": as_options(problem.what), "where": problem.where}, 422)
    return JSONResponse({"error": as_options(str(problem))}, 413 if isinstance(problem, _TooLargeError) else 409)
