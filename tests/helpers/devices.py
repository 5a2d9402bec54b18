"""Devices in processes of their own, which a test starts and kills."""

import socket
import subprocess
import sys
import time

# The command publish with a set-up; it waits for a line before it listens, as starting Python takes its time.
RIG = """
import sys
from pathlib import Path
import opendaq
from aerobalance.acquisition import opendaq_server, simulated
from aerobalance.app.commands.publish import publish
sys.stdin.readline()
print(publish(setup=Path(sys.argv[2]), port=int(sys.argv[1]), say=lambda text: print(text, flush=True)))
"""


def free_port():
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


def reachable(port, process):
    """Wait until a server listens."""
    limit = time.monotonic() + 120
    while time.monotonic() < limit:
        assert process.poll() is None, process.communicate()
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.05)
    raise AssertionError("the server does not listen")


class Server:
    """A process that is an openDAQ device, from `listen` on."""

    def __init__(self, program, port, *arguments) -> None:
        command = [sys.executable, "-c", program, str(port), *map(str, arguments)]
        pipe = subprocess.PIPE
        self.port = port
        self.process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True)

    def listen(self):
        self.process.stdin.write("now\n")
        self.process.stdin.flush()
        reachable(self.port, self.process)
        self.first = self.process.stdout.readline().strip()

    def __enter__(self):
        return self

    def __exit__(self, *_: object) -> None:
        self.kill()

    def kill(self):
        self.process.kill()
        self.process.communicate()
