"""A JSON file as somebody else might have written it: one thing in it is not what it must be."""

import json
from collections.abc import Iterator

ODD = (
    "null", "true", "-1", "1.5", "1e400", "NaN", str(10**30), '"x"', '"../../x"', '"a\\u0000b"',
    '"\\u001b[31mred"', "[]", "[[[1]]]", "{}", '{"a": {"b": [null]}}', "[" * 100_000,
)  # fmt: skip
NO_OBJECT = (b"", b"{", b"[]", b"null", b'"x"', b"\xff\xfe", b"[" * 100_000)
_MARK = "here stands something odd"


def twisted(content: bytes) -> Iterator[bytes]:
    """Each field of a JSON object, nested ones too, in turn missing and as everything odd."""
    yield from NO_OBJECT
    whole = json.loads(content)
    for place in _places(whole):
        yield json.dumps(_changed(whole, place, missing=True)).encode()
        marked = json.dumps(_changed(whole, place, missing=False))
        yield from (marked.replace(f'"{_MARK}"', odd).encode() for odd in ODD)


def _places(value: object) -> Iterator[tuple[str | int, ...]]:
    inner = value.items() if isinstance(value, dict) else enumerate(value)  # type: ignore[arg-type]
    for key, item in inner:
        yield (key,)
        if isinstance(item, dict | list):
            yield from ((key, *rest) for rest in _places(item))


def _changed(whole: object, place: tuple[str | int, ...], *, missing: bool) -> object:
    copy = json.loads(json.dumps(whole))
    target = copy
    for key in place[:-1]:
        target = target[key]
    if missing:
        del target[place[-1]]
    else:
        target[place[-1]] = _MARK
    return copy
