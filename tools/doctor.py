"""`footfall doctor`: is everything here that is needed, and nothing here that should not be?"""

import argparse
import json
import os
import re
import shutil
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import Literal

MIN_DISK = 1 << 30
"""Free space below which recordings soon stop [bytes]."""
Grade = Literal["ok", "note", "bad"]


@dataclass(frozen=True)
class Finding:
    """One thing looked at."""

    subject: str
    grade: Grade
    """`bad` is in the way of footfall's core, `note` of some of what it can do."""
    text: str
    remedy: str = ""


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `doctor` to the command line."""
    parser = subparsers.add_parser(
        "doctor",
        help="check the installation and look for left-over processes",
        description="Check packages, drawing, run directory, disk, cores, and what earlier runs have left.",
    )
    parser.add_argument("--clean", action="store_true", help="remove what ended runs have left behind")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(args: argparse.Namespace) -> int:
    """Look at everything; returns 1 if something is in the way."""
    cleaned = None
    if args.clean:
        from ..launch.leftovers import clean

        cleaned = dict(zip(("processes", "directories"), clean(), strict=True))
    findings = [finding for look in LOOKS for finding in look()]
    if args.json:
        print(json.dumps({"findings": [asdict(f) for f in findings], "cleaned": cleaned}))
    else:
        if cleaned:
            print(f"cleaned: {cleaned['processes']} processes, {cleaned['directories']} run directories")
        width = max(len(finding.subject) for finding in findings)
        for finding in findings:
            remedy = f"; {finding.remedy}" if finding.remedy else ""
            print(f"{finding.grade:<4}  {finding.subject:<{width}}  {finding.text}{remedy}")
    return 1 if any(finding.grade == "bad" for finding in findings) else 0


def python() -> Iterator[Finding]:
    """The interpreter."""
    yield Finding("python", "ok", f"{sys.version.split()[0]}, {sys.executable}")


def packages() -> Iterator[Finding]:
    """Every required package, and those of the extras."""
    for extra, requirements in _requirements().items():
        missing = [text for text in requirements if not _satisfied(text)]
        have = ", ".join(f"{_name(text)} {_version(text)}" for text in requirements if _satisfied(text))
        subject = f"extra {extra}" if extra else "packages"
        if missing:
            remedy = f"pip install 'footfall[{extra}]'" if extra else "pip install --upgrade footfall"
            yield Finding(subject, "note" if extra else "bad", f"missing: {', '.join(missing)}", remedy)
        else:
            yield Finding(subject, "ok", have)


def _requirements() -> dict[str, list[str]]:
    """Requirements by extra; the core's under the empty name."""
    found: dict[str, list[str]] = {"": []}
    for line in requires("footfall") or []:
        text, _, marker = line.partition(";")
        extra = re.search(r"extra == ['\"](\w+)['\"]", marker)
        found.setdefault(extra[1] if extra else "", []).append(text.strip())
    return found


def _name(requirement: str) -> str:
    return re.split(r"[<>=!~ \[]", requirement, maxsplit=1)[0]


def _version(requirement: str) -> str | None:
    try:
        return version(_name(requirement))
    except PackageNotFoundError:
        return None


def _satisfied(requirement: str) -> bool:
    """Whether the package is there, in the least release asked for."""
    have = _version(requirement)
    least = re.search(r">=\s*([\d.]+)", requirement)
    return have is not None and (least is None or _numbers(have) >= _numbers(least[1]))


def _numbers(release: str) -> tuple[int, ...]:
    return tuple(int(n) for n in re.findall(r"\d+", release.split("+")[0])[:3])


def drawing() -> Iterator[Finding]:
    """Whether MuJoCo can draw without a display."""
    if _version("mujoco") is None:
        yield Finding("drawing", "note", "no mujoco", "pip install 'footfall[sim]'")
        return
    from ..models.render.gl import RenderError, find_gl_backend

    try:
        yield Finding("drawing", "ok", f"MuJoCo draws off screen with {find_gl_backend()}")
    except RenderError as error:
        yield Finding("drawing", "note", str(error))


def run_directory() -> Iterator[Finding]:
    """Where sockets go: writable, ours alone, and short enough."""
    from ..launch.run_dir import runs_home
    from ..messages.topics import TOPICS
    from ..messages.zmq_bus import endpoint

    try:
        home = runs_home()
        longest = max(TOPICS, key=len)
        endpoint(home / f"pedestrians-{2**22}", longest, "map_server", "controller")
    except (OSError, ValueError, RuntimeError) as error:
        yield Finding("run directory", "bad", str(error), "set XDG_RUNTIME_DIR to a short path of yours")
    else:
        yield Finding("run directory", "ok", str(home))


def disk() -> Iterator[Finding]:
    """Room for recordings here, and for sockets and logs."""
    from ..launch.run_dir import runs_home

    for subject, place in (("disk here", Path.cwd()), ("disk of runs", runs_home())):
        free = shutil.disk_usage(place).free
        grade: Grade = "ok" if free > MIN_DISK else "note"
        yield Finding(subject, grade, f"{free / (1 << 30):.1f} GB free at {place}")


def cores() -> Iterator[Finding]:
    """Processors, and threads that numerical libraries would start."""
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    grade: Grade = "ok" if count > 1 else "note"
    yield Finding("cores", grade, f"{count} usable; each node gets the `threads` of its launch file")


def runs() -> Iterator[Finding]:
    """Graphs that run, and what ended ones have left."""
    from ..launch.leftovers import dead_runs, orphans
    from ..launch.running import running

    for graph in running():
        yield Finding("running", "ok", f"{graph.name} in {graph.run_dir}")
    for orphan in orphans():
        text = f"process {orphan.pid} of an ended run: {orphan.command}"
        yield Finding("orphan", "note", text, "footfall doctor --clean ends it")
    if dead := dead_runs():
        yield Finding("ended runs", "ok", f"{len(dead)} directories with logs; doctor --clean removes them")


LOOKS = (python, packages, drawing, run_directory, disk, cores, runs)
