"""Change numbers in a YAML text and nothing else: comments, order and spacing stay."""

from __future__ import annotations

from collections.abc import Mapping

import yaml

from lightopt.config._document import YamlError, parse
from lightopt.config._source import Keys, dotted
from lightopt.errors import InputError

__all__ = ["edit_numbers"]


def edit_numbers(text: str, values: Mapping[Keys, float], *, name: str) -> str:
    """The text with other numbers at some keys.

    Parameters
    ----------
    text
        A YAML document that lightopt has read without complaint.
    values
        Path of keys to number, such as ``("lights", 0, "elevation_deg")``; the keys are there.
    name
        Of the file, for errors.

    Raises
    ------
    InputError
        Where a number cannot be changed alone, since an anchor shares it with another place.

    Examples
    --------
    >>> edit_numbers("a: {b: 1.50, c: 2}  # keep", {("a", "b"): 3.0}, name="x.yaml")
    'a: {b: 3, c: 2}  # keep'
    """
    root = yaml.compose(text, Loader=yaml.SafeLoader)
    places = {keys: _scalar(root, keys) for keys in values}
    edited = text
    for keys, node in sorted(places.items(), key=lambda item: item[1].start_mark.index, reverse=True):
        start, end = node.start_mark.index, node.end_mark.index
        edited = f"{edited[:start]}{_number(values[keys])}{edited[end:]}"
    _check(text, edited, values, name)
    return edited


def _scalar(root: yaml.Node | None, keys: Keys) -> yaml.ScalarNode:
    node = root
    for key in keys:
        if isinstance(node, yaml.SequenceNode) and isinstance(key, int):
            node = node.value[key]
        elif isinstance(node, yaml.MappingNode):
            node = next(value for name, value in node.value if name.value == key)
    assert isinstance(node, yaml.ScalarNode)
    return node


def _number(value: float) -> str:
    # at most nine decimals, which is finer than any stage, and no exponent
    return f"{round(value, 9):.9f}".rstrip("0").rstrip(".")


def _check(before: str, after: str, values: Mapping[Keys, float], name: str) -> None:
    # all else must read as before
    expected = parse(before).data
    try:
        found = parse(after).data
    except YamlError:  # an anchor was lost
        found = None
    for keys, value in values.items():
        *path, last = keys
        place: object = expected
        for key in path:
            place = place[key]  # type: ignore[index]  # pyright: ignore[reportIndexIssue]
        place[last] = float(_number(value))  # type: ignore[index]  # pyright: ignore[reportIndexIssue]
    if expected != found:
        raise InputError(
            f"{name}: {', '.join(dotted(keys) for keys in values)} cannot be changed one by one, since an anchor (&) "
            "shares them with another place; write them out"
        )
