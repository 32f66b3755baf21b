"""Topics of the little graph."""

import msgspec

from footfall.messages.topics import Topic


class Beat(msgspec.Struct, frozen=True):
    """One beat."""

    number: int


BEAT = Topic("beat", Beat, rate_hz=30)
ECHO = Topic("echo", Beat, rate_hz=30)
ECHO2 = Topic("echo2", Beat, rate_hz=30)
