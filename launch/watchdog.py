"""Parent of a graph's processes: nothing it has started outlives it or the launcher.

The launcher runs this file as a program of its own (standard library only, in a session of its own) and
speaks JSON lines with it. In go {"start": name, "argv": [...], "env": {...}, "output": path} and
{"signal": name, "number": n}; out come {"started": name, "pid": n}, {"broken": name, "reason": text} and
{"ended": name, "pid": n, "code": n}. When the input ends - the launcher is done, or was killed - everything
is stopped. It is a child subreaper: a grandchild whose parents have died, in whatever session, becomes its
child and is found. Should it be killed itself, the kernel kills the nodes.
"""

import ctypes
import json
import os
import select
import signal
import subprocess
import sys
import time
from contextlib import suppress

PR_SET_PDEATHSIG = 1
PR_SET_CHILD_SUBREAPER = 36
GRACE = 1.5
"""From SIGTERM to SIGKILL when the launcher has gone [s]."""

_prctl = ctypes.CDLL(None, use_errno=True).prctl if sys.platform == "linux" else None


def main() -> None:
    """Serve until the input ends, then stop everything."""
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    wake_read, wake_write = os.pipe()
    os.set_blocking(wake_read, False)
    os.set_blocking(wake_write, False)
    signal.set_wakeup_fd(wake_write, warn_on_full_buffer=False)
    terminated: list[int] = []
    signal.signal(signal.SIGCHLD, lambda number, frame: None)
    signal.signal(signal.SIGTERM, lambda number, frame: terminated.append(number))
    if _prctl:
        _prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    family = Family()
    pending = b""
    while not terminated:
        for ready in select.select([0, wake_read], [], [])[0]:
            if ready == wake_read:
                os.read(wake_read, 4096)
                family.reap()
                continue
            data = os.read(0, 65536)
            if not data:
                terminated.append(0)
            *lines, pending = (pending + data).split(b"\n")
            for line in lines:
                family.obey(json.loads(line))
    family.end()


class Family:
    """The processes started, and whatever they have started."""

    def __init__(self) -> None:
        self.names: dict[int, str] = {}

    def obey(self, order: dict) -> None:
        """Start a process or send a signal to a whole group."""
        if "start" in order:
            self.start(order["start"], order["argv"], order["env"], order["output"])
        else:
            for pid in [pid for pid, name in self.names.items() if name == order["signal"]]:
                kill_group(pid, order["number"])

    def start(self, name: str, argv: list[str], env: dict[str, str], output: str) -> None:
        """Start a process as leader of its own session."""
        try:
            with open(output, "ab") as file:
                process = subprocess.Popen(
                    argv,
                    env=env,
                    stdin=subprocess.DEVNULL,
                    stdout=file,
                    stderr=subprocess.STDOUT,
                    start_new_session=True,
                    preexec_fn=die_with_parent,  # safe: there is one thread here
                )
        except OSError as error:
            tell({"broken": name, "reason": f"{argv[0]}: {error}"})
            return
        process.returncode = 0  # reaped below, not by subprocess
        self.names[process.pid] = name
        tell({"started": name, "pid": process.pid})

    def reap(self) -> None:
        """Collect the dead; a dead leader takes its group along."""
        while True:
            try:
                dead = os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)
            except ChildProcessError:
                return
            if dead is None:
                return
            if dead.si_pid in self.names:
                kill_group(dead.si_pid, signal.SIGKILL)
            _, status = os.waitpid(dead.si_pid, 0)
            if name := self.names.pop(dead.si_pid, None):
                tell({"ended": name, "pid": dead.si_pid, "code": os.waitstatus_to_exitcode(status)})

    def end(self) -> None:
        """Stop everything: SIGTERM to what runs, then SIGKILL until nobody is left."""
        for pid in self.names:
            kill_group(pid, signal.SIGTERM)
        deadline = time.monotonic() + GRACE
        while self.names and time.monotonic() < deadline:
            self.reap()
            time.sleep(0.01)
        deadline = time.monotonic() + 10
        while left := descendants():
            for pid in left:
                kill(pid, signal.SIGKILL)
            self.reap()
            time.sleep(0.005)
            if time.monotonic() > deadline:  # stuck in the kernel
                return


def die_with_parent() -> None:
    """In the child, before exec: the kernel kills it when the watchdog dies."""
    if _prctl:
        _prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    for number in (signal.SIGINT, signal.SIGHUP):  # ignored signals would stay ignored
        signal.signal(number, signal.SIG_DFL)


def tell(event: dict) -> None:
    """One line to the launcher, if it is still there."""
    with suppress(OSError):
        os.write(1, json.dumps(event).encode() + b"\n")


def kill(pid: int, number: int) -> None:
    """Send a signal to a process that may be gone."""
    with suppress(ProcessLookupError):
        os.kill(pid, number)


def kill_group(pid: int, number: int) -> None:
    """Send a signal to a process group that may be gone."""
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(pid, number)


def descendants() -> list[int]:
    """Children of this process, their children, and so on."""
    children: dict[int, list[int]] = {}
    for entry in os.listdir("/proc"):
        if entry.isdigit():
            try:
                with open(f"/proc/{entry}/stat", "rb") as file:
                    parent = int(file.read().rpartition(b")")[2].split()[1])
            except (OSError, ValueError, IndexError):
                continue
            children.setdefault(parent, []).append(int(entry))
    found: list[int] = []
    queue = [os.getpid()]
    while queue:
        queue += (below := children.get(queue.pop(), []))
        found += below
    return found


if __name__ == "__main__":
    main()
