"""Topics of a policy's rollout: what it did (`body_states`), what it was to do, what it was rewarded for.

A rollout is a log like any other; its graph names these topics, so that every tool can read them.
"""

from typing import Annotated

import msgspec
import numpy as np

from .array import Array
from .body import BodyStates
from .topics import BODIES, BODY_STATES, Topic


class RewardTerms(msgspec.Struct, frozen=True):
    """What everybody was rewarded for in one control step."""

    ids: Annotated[np.ndarray, Array("i4", ("N",))]
    names: list[str]
    """The terms (K), `reward` for their weighted sum."""
    values: Annotated[np.ndarray, Array("f4", ("N", "K"))]


class FootContacts(msgspec.Struct, frozen=True):
    """Whether heel and ball of the left and the right foot stand on the ground."""

    ids: Annotated[np.ndarray, Array("i4", ("N",))]
    standing: Annotated[np.ndarray, Array("?", ("N", 2, 2))]
    reference: Annotated[np.ndarray | None, Array("?", ("N", 2, 2))] = None
    """Whether they should."""


REFERENCE_BODY_STATES = Topic("reference_body_states", BodyStates, rate_hz=30)
REWARD_TERMS = Topic("reward_terms", RewardTerms, rate_hz=30)
FOOT_CONTACTS = Topic("foot_contacts", FootContacts, rate_hz=30)

ROLLOUT_TOPICS: dict[str, Topic] = {
    topic.name: topic for topic in (BODIES, BODY_STATES, REFERENCE_BODY_STATES, REWARD_TERMS, FOOT_CONTACTS)
}
"""By name; of these only `bodies` and `body_states` must be there."""
CUSTOM_TOPICS: dict[str, str] = {
    REFERENCE_BODY_STATES.name: f"{__name__}:REFERENCE_BODY_STATES",
    REWARD_TERMS.name: f"{__name__}:REWARD_TERMS",
    FOOT_CONTACTS.name: f"{__name__}:FOOT_CONTACTS",
}
"""`Graph.custom_topics` of a rollout."""
