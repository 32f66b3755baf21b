"""A graph's own topics beside the built-in ones."""

import os
import sys
from importlib import import_module

from .config import ConfigError
from .graph import Graph
from .topics import TOPICS, Topic


def resolve_topics(graph: Graph) -> dict[str, Topic]:
    """All topics of a graph by name.

    Raises:
        ConfigError: a custom topic has a built-in one's name, cannot be imported or is not a `Topic`.
    """
    topics = dict(TOPICS)
    if graph.custom_topics and os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())  # where `python -m` looks, and so the nodes themselves
    for name, path in graph.custom_topics.items():
        if name in TOPICS:
            raise ConfigError(f"topic {name}: is a built-in one; choose another name")
        module, _, attribute = path.partition(":")
        try:
            topic = getattr(import_module(module), attribute)
        except (ImportError, AttributeError, ValueError) as error:
            raise ConfigError(f"topic {name}: cannot import {path!r}: {error}") from None
        if not isinstance(topic, Topic) or topic.name != name:
            raise ConfigError(f"topic {name}: {path!r} is {topic!r}, must be a Topic named {name!r}")
        topics[name] = topic
    return topics
