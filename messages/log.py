"""Logs of runs: MCAP files with one self-contained msgpack record a message (`docs/logs.md`)."""

from .log_format import LogChannel, LogError
from .log_reader import Logged, LogReader, Order
from .log_writer import DiskFullError, LogWriter

__all__ = ["DiskFullError", "LogChannel", "LogError", "LogReader", "LogWriter", "Logged", "Order"]
