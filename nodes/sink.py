"""Takes whatever it is sent and counts it, so that a replay can show that everything arrives.

In: anything, `reliable`. Out: nothing but its diagnostics.
"""

import sys

from .process import Process, run_process


def swallow(process: Process) -> None:
    """Take messages until stopped; the bus counts them."""
    process.ready()
    while True:
        process.wait()
        for inlet in process.bus.inlets:
            inlet.pending.clear()


def main() -> int:
    """Run as a process of a graph."""
    return run_process(swallow)


if __name__ == "__main__":
    sys.exit(main())
