"""Bytes of every message type: golden, round trip, plain msgpack, schema hashes, errors."""

import tracemalloc
import typing
import weakref
from pathlib import Path
from typing import Annotated, Any, Literal

import msgpack
import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from footfall.messages.array import DTYPES, Array, finite
from footfall.messages.body import BodyStates, Falls
from footfall.messages.bus import Inlet
from footfall.messages.codec import Codec, Header, MessageError, plain
from footfall.messages.graph import Edge, Input
from footfall.messages.objectives import AgentObjectives, Objectives, TargetSpeed
from footfall.messages.samples import samples
from footfall.messages.schema import compatible, fields_of, json_schema, schema_hash
from footfall.messages.score import Score
from footfall.messages.topics import TOPICS

GOLDEN = Path(__file__).parent / "golden_messages.txt"
"""A line a topic: name, schema hash, body of its sample; `python -m footfall.messages.samples` prints it."""


def same(a: Any, b: Any) -> bool:
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, list):
        return len(a) == len(b) and all(map(same, a, b))
    return type(a) is type(b) and a == b


def through(topic: str, message: msgspec.Struct) -> Any:
    codec = Codec(topic, TOPICS[topic].type)
    body, frames = codec.encode(message)
    return codec.decode(body, [memoryview(frame.tobytes()) for frame in frames])


def test_golden_bytes_cover_every_topic_and_have_not_changed() -> None:
    golden = dict(line.split(" ", 1) for line in GOLDEN.read_text().splitlines())
    assert sorted(golden) == sorted(TOPICS)
    for name, message in samples().items():
        codec = Codec(name, TOPICS[name].type)
        schema, body = golden[name].split()
        text = "run `python -m footfall.messages.samples` if the change is wanted"
        assert codec.schema.hex() == schema, f"{name}: another schema; {text}"
        assert codec.encode(message)[0].hex() == body, f"{name}: other bytes; {text}"
        assert same(plain(codec.decode(bytes.fromhex(body))), plain(message))


@pytest.mark.parametrize("scale", [1, 30])
@pytest.mark.parametrize("name", sorted(TOPICS))
def test_round_trip_and_plain_msgpack(name: str, scale: int) -> None:
    message = samples(scale=scale)[name]
    assert same(plain(through(name, message)), plain(message))
    codec = Codec(name, TOPICS[name].type)
    record = codec.encode_inline(message)
    assert same(plain(codec.decode(record)), plain(message))
    assert rebuilt(msgpack.unpackb(record), []) == rebuilt_expected(plain(message))
    body, frames = codec.encode(message)
    assert rebuilt(msgpack.unpackb(body), frames) == rebuilt_expected(plain(message))


def rebuilt(value: Any, frames: list[np.ndarray]) -> Any:
    """A body as read by the reference msgpack, its arrays as (dtype, shape, bytes)."""
    if isinstance(value, dict):
        return {key: rebuilt(item, frames) for key, item in value.items()}
    if isinstance(value, list):
        if len(value) == 3 and isinstance(value[0], str) and value[0] in DTYPES:
            data = frames[value[2]].tobytes() if isinstance(value[2], int) else value[2]
            return value[0], tuple(value[1]), data
        return [rebuilt(item, frames) for item in value]
    return value


def rebuilt_expected(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: rebuilt_expected(item) for key, item in value.items()}
    if isinstance(value, list):
        return [rebuilt_expected(item) for item in value]
    return (value.dtype.str, value.shape, value.tobytes()) if isinstance(value, np.ndarray) else value


def messages_of(kind: type[msgspec.Struct]) -> st.SearchStrategy[Any]:
    """Valid messages of a type: named lengths agree, floats are finite."""
    return st.fixed_dictionaries({"length": st.integers(0, 3)}).flatmap(
        lambda drawn: build(kind, drawn["length"])
    )


def build(kind: type[msgspec.Struct], length: int) -> st.SearchStrategy[Any]:
    values = {field.name: value_of(field, length) for field in fields_of(kind)}
    return st.builds(kind, **values)


def value_of(field: Any, length: int) -> st.SearchStrategy[Any]:
    if field.array is None:
        return plain_value(field.annotation, length)
    shape = tuple(n if isinstance(n, int) else length for n in field.array.shape)
    dtype = field.array.numpy_dtype
    if dtype.kind == "f":
        elements = st.floats(-1e6, 1e6, width=dtype.itemsize * 8)  # type: ignore[call-overload]
        return arrays(dtype, shape, elements=elements, fill=st.just(0.5))
    return arrays(dtype, shape, fill=st.just(1))


def bounded(annotation: Any, meta: msgspec.Meta, length: int) -> st.SearchStrategy[Any]:
    if annotation is float:
        low, high = meta.gt if meta.gt is not None else meta.ge, meta.le
        return st.floats(low, high, exclude_min=meta.gt is not None, allow_nan=False, allow_infinity=False)
    assert typing.get_origin(annotation) is list, f"teach this test about {annotation} with {meta}"
    return st.lists(
        plain_value(typing.get_args(annotation)[0], length), min_size=meta.min_length or 0, max_size=4
    )


def plain_value(annotation: Any, length: int) -> st.SearchStrategy[Any]:
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if hasattr(annotation, "__metadata__"):
        metas = [extra for extra in annotation.__metadata__ if isinstance(extra, msgspec.Meta)]
        return bounded(arguments[0], metas[0], length) if metas else plain_value(arguments[0], length)
    if origin is Literal:
        return st.sampled_from(arguments)
    if origin is list:
        return st.lists(plain_value(arguments[0], length), max_size=3)
    if origin is tuple:
        return st.tuples(*(plain_value(one, length) for one in arguments))
    if origin is dict:
        return st.dictionaries(st.text(max_size=5), plain_value(arguments[1], length), max_size=3)
    if arguments:
        return st.one_of(*(plain_value(one, length) for one in arguments))
    if isinstance(annotation, type) and issubclass(annotation, msgspec.Struct):
        return build(annotation, length)
    known = {
        bool: st.booleans(),
        int: st.integers(-(2**63), 2**63 - 1),
        float: st.floats(allow_nan=False, allow_infinity=False),
        str: st.text(st.characters(exclude_categories=["Cs"]), max_size=8),
        type(None): st.none(),
    }
    return known.get(annotation, st.none())


@pytest.mark.parametrize("name", sorted(TOPICS))
@settings(max_examples=8, deadline=None)
@given(st.data())
def test_any_valid_message_comes_back_the_same(name: str, data: st.DataObject) -> None:
    message = data.draw(messages_of(TOPICS[name].type))
    assert same(plain(through(name, message)), plain(message))


# --- schemas -------------------------------------------------------------------------------------


def kind(name: str = "Kind", tag: Any = None, **fields: Any) -> type[msgspec.Struct]:
    rows = [(key, *value) if isinstance(value, tuple) else (key, value) for key, value in fields.items()]
    return msgspec.defstruct(name, rows, frozen=True, tag=tag)


F4 = Annotated[np.ndarray, Array("f4", ("N", 3), "m", "world")]
BASE = kind(a=int, b=F4, c=(float, 1.0))
CHANGES: dict[str, type[msgspec.Struct]] = {
    "name of the type": kind("Other", a=int, b=F4, c=(float, 1.0)),
    "tag": kind(tag="kind", a=int, b=F4, c=(float, 1.0)),
    "name of a field": kind(z=int, b=F4, c=(float, 1.0)),
    "type of a field": kind(a=float, b=F4, c=(float, 1.0)),
    "order": kind(b=F4, a=int, c=(float, 1.0)),
    "new required field": kind(a=int, b=F4, d=str, c=(float, 1.0)),
    "missing required field": kind(b=F4, c=(float, 1.0)),
    "optional": kind(a=int | None, b=F4, c=(float, 1.0)),
    "dtype": kind(a=int, b=Annotated[np.ndarray, Array("f8", ("N", 3), "m", "world")], c=(float, 1.0)),
    "shape": kind(a=int, b=Annotated[np.ndarray, Array("f4", ("N", 4), "m", "world")], c=(float, 1.0)),
    "unit": kind(a=int, b=Annotated[np.ndarray, Array("f4", ("N", 3), "cm", "world")], c=(float, 1.0)),
    "frame": kind(a=int, b=Annotated[np.ndarray, Array("f4", ("N", 3), "m", "agent")], c=(float, 1.0)),
    "NaN": kind(a=int, b=Annotated[np.ndarray, Array("f4", ("N", 3), "m", "world", True)], c=(float, 1.0)),
    "bounds": kind(a=Annotated[int, msgspec.Meta(ge=0)], b=F4, c=(float, 1.0)),
    "literal": kind(a=Literal["1"], b=F4, c=(float, 1.0)),
    "literal of another type": kind(a=Literal[1], b=F4, c=(float, 1.0)),
    "inside": kind(a=kind("In", x=int), b=F4, c=(float, 1.0)),
    "deeper inside": kind(a=kind("In", x=float), b=F4, c=(float, 1.0)),
}
ADDITIONS = {
    "default": kind(a=int, b=F4, c=(float, 2.0)),
    "new field with default": kind(a=int, b=F4, c=(float, 1.0), d=(str, "x")),
    "no field with default": kind(a=int, b=F4),
}


def test_every_change_changes_the_hash() -> None:
    everything = [BASE, *CHANGES.values(), *ADDITIONS.values()]
    assert len({schema_hash(one) for one in everything}) == len(everything)
    assert schema_hash(kind(a=int, b=F4, c=(float, 1.0))) == schema_hash(BASE)


def test_hashes_do_not_depend_on_the_process() -> None:
    assert schema_hash(BodyStates).hex() in GOLDEN.read_text()


@pytest.mark.parametrize("change", CHANGES)
def test_other_required_fields_are_refused_naming_both_sides(change: str) -> None:
    inlet = received(CHANGES[change], BASE)
    assert inlet.take(None) == []
    assert (inlet.rejected, inlet.received, inlet.last_sequence) == (1, 0, 0)
    ours, theirs = schema_hash(BASE).hex(), schema_hash(CHANGES[change]).hex()
    text = f"t: schema: source sends Kind as {theirs}, sink knows it as {ours}; run both from one release"
    assert str(inlet.faults[0]) == text


@pytest.mark.parametrize("change", ADDITIONS)
def test_fields_with_defaults_may_differ_and_it_is_said(change: str) -> None:
    inlet = received(ADDITIONS[change], BASE, times=3)
    got = [one.message for one in inlet.take(None)]
    assert [one.a for one in got] == [7] * 3
    assert [one.c for one in got] == [1.0 if change != "default" else 2.0] * 3
    assert inlet.rejected == 0
    assert len(inlet.faults) == 1
    assert "fields with defaults differ; reading what fits" in str(inlet.faults[0])


def test_a_changed_field_with_default_is_an_error_that_names_both_sides() -> None:
    inlet = received(kind(a=int, b=F4, c=(str, "x")), BASE)
    assert inlet.take(None) == []
    assert "c: Expected `float`, got `str` (sent as schema" in str(inlet.faults[1])


def test_frames_of_unknown_fields_are_left_aside() -> None:
    newer = kind(
        a=int, b=F4, c=(float, 1.0), d=(Annotated[np.ndarray, Array("f4", ("D",))], np.zeros(9000, "f4"))
    )
    assert received(newer, BASE).take(None)[0].message.a == 7


def received(sent_as: type[msgspec.Struct], read_as: type[msgspec.Struct], times: int = 1) -> Inlet:
    """What an inlet makes of messages of another type."""
    values: dict[str, Any] = {"a": 7, "z": 7, "b": np.zeros((2, 3), "f4"), "d": "y"}
    for field in fields_of(sent_as):
        if field.array is not None and field.name == "b":
            wide = tuple(2 if n == "N" else n for n in field.array.shape)
            values["b"] = np.zeros(wide, field.array.dtype)  # type: ignore[arg-type]
        elif field.structs:
            values[field.name] = field.structs[0](x=1)
    names = {f.name for f in msgspec.structs.fields(sent_as) if f.required}
    sender, receiver = Codec("t", sent_as), Codec("t", read_as)
    inlet = Inlet(Edge("t", "source", "sink", "t", Input("t", "queue", 10), False, False), receiver, False)
    for sequence in range(times):
        body, frames = sender.encode(sent_as(**{k: v for k, v in values.items() if k in names}))
        head = Header(sequence, 0, 0, sender.schema, len(frames)).pack()
        inlet.put([head + body, *(f.tobytes() for f in frames)])
    return inlet


def test_compatible() -> None:
    assert all(compatible(schema_hash(BASE), schema_hash(one)) for one in ADDITIONS.values())
    assert not any(compatible(schema_hash(BASE), schema_hash(one)) for one in CHANGES.values())


@pytest.mark.parametrize("name", sorted(TOPICS))
def test_every_type_has_a_json_schema(name: str) -> None:
    from jsonschema import Draft202012Validator

    Draft202012Validator.check_schema(json_schema(TOPICS[name].type))


# --- errors --------------------------------------------------------------------------------------

IDS = np.arange(2, dtype="i4")
STATES = np.zeros((2, 24, 13), "f4")


@pytest.mark.parametrize(
    "message, text",
    [
        (BodyStates(IDS, STATES.astype("f8")), "t: joints: has dtype <f8, must be <f4"),
        (BodyStates(IDS, STATES.astype(">f4")), "t: joints: has dtype >f4, must be <f4"),
        (BodyStates(IDS, STATES[:, :3]), "t: joints: has shape (2, 3, 13), must be (N, 24, 13)"),
        (
            BodyStates(IDS[:1], STATES),
            "t: joints: has shape (2, 24, 13), must be (N, 24, 13) with N = 1 as in",
        ),
        (BodyStates(IDS, STATES * np.float32("nan")), "t: joints: holds NaN or infinity"),
        (BodyStates(IDS, None), "t: joints: is a NoneType, must be an ndarray"),  # type: ignore[arg-type]
        (BodyStates([1, 2], STATES), "t: ids: is a list, must be an ndarray"),  # type: ignore[arg-type]
        (Falls(IDS, np.zeros((2, 3), "f4"), "report"), "t: is a Falls, must be a BodyStates"),
    ],
)
def test_what_is_not_as_promised_is_not_sent(message: msgspec.Struct, text: str) -> None:
    with pytest.raises(MessageError) as caught:
        Codec("t", BodyStates).encode(message)  # type: ignore[arg-type]
    assert str(caught.value).startswith(text)


def test_values_that_cannot_be_sent() -> None:
    speed = Objectives([AgentObjectives(1, [TargetSpeed(float("inf"))])])
    with pytest.raises(MessageError, match=r"t: agents\[0\]\.objectives\[0\]\.speed: is inf, must be finite"):
        Codec("t", Objectives).encode(speed)
    with pytest.raises(MessageError, match="t: object cannot stand in a message"):
        Codec("t", Objectives).encode(Objectives([object()]))  # type: ignore[list-item]
    score = samples()["score"]
    assert isinstance(score, Score)
    for value in (2**70, "\ud800"):
        with pytest.raises(MessageError):
            Codec("t", Score).encode(msgspec.structs.replace(score, entered=value))
    with pytest.raises(MessageError, match="collisions: Expected `int`, got `str`"):
        codec = Codec("t", Score)
        codec.decode(codec.encode(msgspec.structs.replace(score, collisions="many"))[0])


def test_numpy_scalars_are_numbers() -> None:
    score = msgspec.structs.replace(samples()["score"], entered=np.int64(3), agent_seconds=np.float32(0.5))
    got = through("score", score)
    assert (got.entered, got.agent_seconds) == (3, 0.5)


@pytest.mark.parametrize(
    "head, text",
    [
        (b"", "0 bytes, must be at least 36"),
        (b"GG" + bytes(34), "starts with b'GG', must start with b'FF'"),
        (b"FF\x09" + bytes(33), "wire version 9, this side speaks 1"),
        (Header(0, -1, 0, bytes(8), 0).pack(), "is -1, must not be negative"),
    ],
)
def test_bad_headers(head: bytes, text: str) -> None:
    with pytest.raises(MessageError, match=r"^t: header") as caught:
        Header.unpack("t", head)
    assert text in str(caught.value)


@pytest.mark.parametrize(
    "shape", [[2**60, "x"], [2**60, b"x"], [[None], 2**60], [True, 2], [-1, -2], [1.0], None]
)
def test_what_is_no_shape_is_refused_before_anything_is_made_of_it(shape: Any) -> None:
    codec = Codec("t", BodyStates)
    body: Any = msgpack.unpackb(codec.encode(BodyStates(IDS, STATES))[0])
    body["ids"][1] = shape
    with pytest.raises(
        MessageError, match=r"^t: ids: shape .* is not a list of at most 8 lengths$"
    ) as caught:
        codec.decode(msgspec.msgpack.encode(body))
    assert len(str(caught.value)) < 200


@pytest.mark.parametrize("place", [0, 1, 2])
def test_what_is_wrong_is_cut_before_it_is_told(place: int) -> None:
    codec = Codec("t", BodyStates)
    body: Any = msgpack.unpackb(codec.encode(BodyStates(IDS, STATES))[0])
    body["ids"][place] = [[0] * 1_000_000]
    sent = msgspec.msgpack.encode(body)
    tracemalloc.start()
    with pytest.raises(MessageError, match=r"^t: ids: "):
        codec.decode(sent)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 10 * len(sent)  # a list of a million numbers, and no text of them


def test_faults_that_are_told_are_few() -> None:
    codec = Codec("t", BodyStates)
    inlet = Inlet(Edge("t", "a", "b", "t", Input("t", "queue", 10), False, False), codec, False)
    body, _ = codec.encode(BodyStates(IDS[:0], STATES[:0]))
    for number in range(100):  # each knows another set of fields with defaults
        schema = codec.schema[:4] + number.to_bytes(4, "little")
        inlet.put([Header(number, 0, 0, schema, 0).pack() + body])
    assert inlet.received == 100 and len(inlet.faults) == 8


def test_repeated_and_misannounced_messages_are_rejected() -> None:
    codec = Codec("t", BodyStates)
    inlet = Inlet(Edge("t", "a", "b", "t", Input("t", "queue", 10), False, False), codec, False)
    body, _ = codec.encode(BodyStates(IDS[:0], STATES[:0]))
    one = [Header(3, 0, 0, codec.schema, 0).pack() + body]
    inlet.put(one)
    inlet.put(one)
    inlet.put([Header(4, 0, 0, codec.schema, 2).pack() + body, b"x"])
    assert len(inlet.take(None)) == 1
    assert [str(fault) for fault in inlet.faults] == [
        "t: header.sequence: 3 came after 3; it is left aside",
        "t: frames: header says 2, 1 came",
    ]


@pytest.mark.parametrize("wrong", [5 + (1 << 30), 5 + (1 << 60)])
def test_one_broken_sequence_number_costs_one_message(wrong: int) -> None:
    codec = Codec("t", BodyStates)
    inlet = Inlet(Edge("t", "a", "b", "t", Input("t", "queue", 10), False, False), codec, False)

    def put(number: int) -> int:
        inlet.put([bytes(codec.pack(BodyStates(IDS[:0], STATES[:0]), number, 0, 0)[0])])
        return len(inlet.take(None))

    assert [put(number) for number in (4, wrong, 5, 6)] == [1, 0, 1, 1]
    assert inlet.rejected == 1 and inlet.dropped == 0
    assert [put(number) for number in (wrong, wrong + 1, wrong + 2)] == [0, 1, 1]  # it is so after all


@pytest.mark.parametrize("where", ["inside", "in a frame"])
def test_the_word_of_a_sender_is_taken_only_where_it_is_trusted(where: str) -> None:
    count = 3 if where == "inside" else 100
    codec = Codec("t", BodyStates)
    head, frames = codec.pack(
        BodyStates(np.arange(count, dtype="i4"), np.ones((count, 24, 13), "f4")), 0, 0, 0
    )
    one = np.float32(1.0).tobytes()
    parts = [bytes(part) for part in (head, *frames)]
    assert Header.unpack("t", parts[0]).checked and len(parts) == 1 + (where != "inside")
    spoiled = parts[-1].rindex(one)
    parts[-1] = parts[-1][:spoiled] + np.float32(np.nan).tobytes() + parts[-1][spoiled + 4 :]
    edge = Edge("t", "a", "b", "t", Input("t", "queue", 10), False, False)
    for trusting in (False, True):
        inlet = Inlet(edge, codec, False, trusting)
        inlet.put(parts)
        assert len(inlet.take(None)) == trusting
        assert [fault.reason for fault in inlet.faults] == ["holds NaN or infinity"] * (not trusting)
    unchecked = Inlet(edge, codec, False, trusting=True)
    header = msgspec.structs.replace(Header.unpack("t", parts[0]), checked=False).pack()
    unchecked.put([header + parts[0][Header.SIZE :], *parts[1:]])
    assert unchecked.take(None) == [] and unchecked.rejected == 1


def test_finite() -> None:
    for size in (1, 100, 50_000):
        array = np.full(size, 1e30, "f4")
        assert finite(array)
        array[size // 2] = np.inf
        assert not finite(array)
        array[size // 2] = np.nan
        assert not finite(array)


def test_arrays_live_no_longer_than_their_message() -> None:
    codec = Codec("body_states", BodyStates)
    states = np.zeros((60, 24, 13), "f4")
    states.flags.writeable = False
    kept = weakref.ref(states)
    message = BodyStates(np.arange(60, dtype="i4"), states)
    assert len(codec.encode(message)[1]) == 1
    del message, states
    assert kept() is None


def test_large_arrays_are_looked_through_again_where_they_may_have_changed() -> None:
    codec = Codec("body_states", BodyStates)
    ids = np.arange(60, dtype="i4")
    states = np.zeros((60, 24, 13), "f4")
    view = states[:]
    view.flags.writeable = False
    thawed = states.copy()
    thawed.flags.writeable = False
    for array in (states, view, thawed):
        codec.encode(BodyStates(ids, array))
        codec.encode(BodyStates(ids, array))
    thawed.flags.writeable = True
    states[3, 2, 1] = thawed[3, 2, 1] = np.nan
    for array in (states, view, thawed, states.copy()):
        with pytest.raises(MessageError, match=r"NaN|finite"):
            codec.encode(BodyStates(ids, array))


def test_noncontiguous_and_empty_arrays() -> None:
    wide = np.arange(2 * 24 * 26, dtype="f4").reshape(2, 24, 26)[:, :, ::2]
    np.testing.assert_array_equal(through("body_states", BodyStates(IDS, wide)).joints, wide)
    tall = np.asfortranarray(np.random.default_rng(0).random((2, 24, 13), dtype=np.float32))
    np.testing.assert_array_equal(through("body_states", BodyStates(IDS, tall)).joints, tall)
    assert through("body_states", BodyStates(IDS[:0], STATES[:0])).joints.shape == (0, 24, 13)
