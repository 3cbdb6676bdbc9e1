"""A robot's teleop in a pseudo-terminal, into which keys are typed as a person would."""

from __future__ import annotations

import contextlib
import os
import pty
import subprocess
import threading

from hitchhike_ros.core.errors import HitchhikeError

_QUIT = b"\x04"
_SHOWN = 4096  # bytes of what it has shown that are kept


class TeleopTerminal:
    """A context that starts the teleop of robot ``name``, and gives it ``leave_s`` of wall time to end."""

    def __init__(self, name: str, leave_s: float) -> None:
        self._name, self._leave_s = name, leave_s
        self._terminal, slave = pty.openpty()
        command = ["rosrun", "hitchhike_ros", "teleop", f"__ns:=/{name}", "__name:=teleop"]
        self._process = subprocess.Popen(command, stdin=slave, stdout=slave, stderr=slave, start_new_session=True)
        os.close(slave)
        self._shown = b""
        threading.Thread(target=self._read, daemon=True).start()

    def __enter__(self) -> TeleopTerminal:
        return self

    def __exit__(self, *_exc: object) -> None:
        with contextlib.suppress(OSError):  # it has gone by itself
            os.write(self._terminal, _QUIT)
        try:
            self._process.wait(self._leave_s)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        os.close(self._terminal)

    def type(self, keys: str) -> None:
        """Press these keys.

        Raises:
            HitchhikeError: teleop has ended.
        """
        self.check()
        os.write(self._terminal, keys.encode())

    def check(self) -> None:
        """Raises HitchhikeError when teleop has ended, with what it said."""
        if self._process.poll() is not None:
            raise HitchhikeError(f"teleop of {self._name} has ended: {self._shown.decode(errors='replace')}")

    def _read(self) -> None:
        """Read what teleop shows: a terminal that nobody reads from would fill up."""
        with contextlib.suppress(OSError):  # the terminal is closed
            while data := os.read(self._terminal, _SHOWN):
                self._shown = (self._shown + data)[-_SHOWN:]
