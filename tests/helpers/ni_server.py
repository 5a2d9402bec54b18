"""An NI gRPC Device Server that has no device: what the real client needs of it, on a clock of its own."""

from __future__ import annotations

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import grpc
import numpy as np
from nidaqmx._stubs import nidaqmx_pb2 as messages
from nidaqmx._stubs import nidaqmx_pb2_grpc as stubs

CURRENT_POSITION, OFFSET, RELATIVE_TO, OVERWRITE, RATE = 0x1221, 0x190B, 0x190A, 0x1211, 0x1344
MOST_RECENT, CURRENT = 10428, 10425


class FakeTask:
    """A task whose samples count themselves: sample i of channel c is i + c * 1e9."""

    def __init__(self) -> None:
        self.channels: dict[str, Any] = {}
        self.rate = 0.0
        self.buffer = 0
        self.began: float | None = None
        self.position = 0
        self.attributes = {OFFSET: 0, RELATIVE_TO: CURRENT, OVERWRITE: 0}

    @property
    def acquired(self) -> int:
        return 0 if self.began is None else int((time.monotonic() - self.began) * self.rate)


class FakeServer(stubs.NiDAQmxServicer):
    """Serves tasks, and fails when it is told to.

    `held` keeps readings waiting, `silent` stops the sample clock (`cut` samples are read then, and lost), `broken`
    answers every reading with an error code, `absent` refuses new tasks, `largest` is the fastest rate of the device,
    and `shortest` the length of its buffer where it is set [samples].
    """

    def __init__(self, port: int = 0) -> None:
        self.tasks: dict[str, FakeTask] = {}
        self.held = threading.Event()
        self.silent = False
        self.cut = 0
        self.broken = 0
        self.absent = False
        self.largest = 50_000.0
        self.shortest = 0
        self.made = 0
        self._server = grpc.server(ThreadPoolExecutor(4))
        stubs.add_NiDAQmxServicer_to_server(self, self._server)
        self.port = self._server.add_insecure_port(f"127.0.0.1:{port}")
        self._server.start()

    def __enter__(self) -> FakeServer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self._server.stop(0).wait()

    def GetSystemInfoAttributeUInt32(self, request, context):  # noqa: N802 - names of the protocol from here on
        return messages.GetSystemInfoAttributeUInt32Response(value=25)  # a version of the driver

    def CreateTask(self, request, context):  # noqa: N802
        if self.absent:
            fail(context, -201003, "Device cannot be accessed.")
        self.made += 1
        name = request.session_name or f"task {self.made}"
        self.tasks[name] = FakeTask()
        return messages.CreateTaskResponse(task={"name": name}, new_session_initialized=True)

    def ClearTask(self, request, context):  # noqa: N802
        self.tasks.pop(request.task.name, None)
        return messages.ClearTaskResponse()

    def _create(self, request, context, response):
        task = self.tasks[request.task.name]
        if "ai99" in request.physical_channel:
            fail(context, -200170, "Physical channel specified does not exist on this device.")
        task.channels[request.name_to_assign_to_channel] = request
        return response

    def CreateAIBridgeChan(self, request, context):  # noqa: N802
        return self._create(request, context, messages.CreateAIBridgeChanResponse())

    def CreateAIVoltageChan(self, request, context):  # noqa: N802
        return self._create(request, context, messages.CreateAIVoltageChanResponse())

    def CreateAIAccelChan(self, request, context):  # noqa: N802
        return self._create(request, context, messages.CreateAIAccelChanResponse())

    def CfgSampClkTiming(self, request, context):  # noqa: N802
        task = self.tasks[request.task.name]
        task.rate, task.buffer = min(request.rate, self.largest), self.shortest or request.samps_per_chan
        return messages.CfgSampClkTimingResponse()

    def GetTimingAttributeDouble(self, request, context):  # noqa: N802
        assert request.attribute_raw == RATE
        return messages.GetTimingAttributeDoubleResponse(value=self.tasks[request.task.name].rate)

    def GetTaskAttributeUInt32(self, request, context):  # noqa: N802
        return messages.GetTaskAttributeUInt32Response(value=len(self.tasks[request.task.name].channels))

    def GetTaskAttributeString(self, request, context):  # noqa: N802
        return messages.GetTaskAttributeStringResponse(value=", ".join(self.tasks[request.task.name].channels))

    def GetReadAttributeString(self, request, context):  # noqa: N802
        return messages.GetReadAttributeStringResponse(value=", ".join(self.tasks[request.task.name].channels))

    def GetReadAttributeUInt32(self, request, context):  # noqa: N802
        return messages.GetReadAttributeUInt32Response(value=len(self.tasks[request.task.name].channels))

    def SetReadAttributeInt32(self, request, context):  # noqa: N802
        self.tasks[request.task.name].attributes[request.attribute_raw] = request.value_raw
        return messages.SetReadAttributeInt32Response()

    def GetReadAttributeUInt64(self, request, context):  # noqa: N802
        assert request.attribute_raw == CURRENT_POSITION
        return messages.GetReadAttributeUInt64Response(value=self.tasks[request.task.name].position)

    def StartTask(self, request, context):  # noqa: N802
        self.tasks[request.task.name].began = time.monotonic()
        return messages.StartTaskResponse()

    def StopTask(self, request, context):  # noqa: N802
        return messages.StopTaskResponse()

    def ReadAnalogF64(self, request, context):  # noqa: N802
        task = self.tasks[request.task.name]
        if self.broken:
            fail(context, self.broken, "The device is gone.")
        rows, limit = request.num_samps_per_chan, time.monotonic() + request.timeout
        while self.held.is_set():
            time.sleep(0.01)
        if task.attributes[RELATIVE_TO] == MOST_RECENT:
            task.position = max(0, task.acquired + task.attributes[OFFSET])
        while task.acquired < task.position + rows or self.silent:
            if time.monotonic() > limit:
                task.position += self.cut
                fail(context, -200284, "Some or all of the samples requested are not yet acquired.", read=self.cut)
            time.sleep(0.001)
        if task.position < task.acquired - task.buffer:
            fail(context, -200279, "Attempted to read samples that are no longer available.")
        counts = np.arange(task.position, task.position + rows) + 1e9 * np.arange(len(task.channels))[:, np.newaxis]
        task.position += rows
        return messages.ReadAnalogF64Response(read_array=counts.ravel(), samps_per_chan_read=rows)


def fail(context, code: int, text: str, *, read: int = 0) -> None:
    """End a call as the server does for an error of the driver."""
    context.set_trailing_metadata((("ni-error", str(code)), ("ni-samps-per-chan-read", str(read))))
    context.abort(grpc.StatusCode.UNKNOWN, text)
