"""ROS message types: the standard ones, and those that a bag defines. Requires the extra ``bag``."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore


@cache
def known_types(ros1: bool) -> Typestore:
    """Return the types that come with ROS 1 or ROS 2."""
    return get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)


def types_told(definition: str, type_name: str) -> Mapping[str, Any]:
    """Return the types in a bag's definition of a message, in ROS's msg or OMG's IDL; bad ones raise any exception."""
    if not definition.lstrip().startswith(("=", "module")):
        return get_types_from_msg(definition, type_name)
    parts = [part.split("\n", 1)[1] if part.startswith("IDL: ") else part for part in definition.split("=" * 80 + "\n")]
    return {name: fields for part in parts if part.strip() for name, fields in get_types_from_idl(part).items()}
