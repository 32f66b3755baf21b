"""JSON Schema of launch files, for completion and checks in editors."""

from typing import Any

import msgspec

from .launch_file import LaunchFile, NodeFile, PortInput

_ARGUMENT = {"type": "string", "pattern": r"^\$"}


def launch_schema() -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of a launch file; numbers, booleans and choices may be `$argument` too."""
    _, parts = msgspec.json.schema_components(
        [LaunchFile, NodeFile, PortInput], ref_template="#/$defs/{name}"
    )
    node = parts["NodeFile"]
    port = {"anyOf": [{"enum": ["latest", "queue", "reliable"]}, {"$ref": "#/$defs/PortInput"}]}
    node["properties"]["inputs"]["anyOf"] = [
        {"type": "array", "items": {"type": "string"}},
        {"type": "object", "additionalProperties": port},
    ]
    node["required"] = []  # a file that includes another may give only some keys of a node
    file = parts.pop("LaunchFile")
    file["properties"]["nodes"]["additionalProperties"] = {
        "anyOf": [{"$ref": "#/$defs/NodeFile"}, {"type": "null"}]
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **_allow_arguments(file),
        "title": "footfall launch file",
        "$defs": {name: _allow_arguments(part) for name, part in sorted(parts.items())},
    }


def _allow_arguments(struct: dict[str, Any]) -> dict[str, Any]:
    properties = {name: _or_argument(schema) for name, schema in struct["properties"].items()}
    return {**struct, "properties": properties}


def _or_argument(schema: dict[str, Any]) -> dict[str, Any]:
    """The schema of a value, or of the argument that stands for it."""
    note = {key: schema[key] for key in ("description", "default") if key in schema}
    bare = {key: value for key, value in schema.items() if key not in note}
    choices = bare.get("anyOf", [bare])
    if any(choice.get("type") == "string" for choice in choices):
        return schema
    return {**note, "anyOf": [*choices, _ARGUMENT]}
