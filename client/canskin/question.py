"""Requests that one service answers."""

import msgspec


class Question(msgspec.Struct, frozen=True):
    """A request that one service answers: its name, and the types of request and reply."""

    name: str
    request: type[msgspec.Struct]
    reply: type[msgspec.Struct]
