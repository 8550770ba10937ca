"""The strict YAML reader beneath the configuration."""

from __future__ import annotations

import random

import pytest
import yaml

from lightopt.config._strict_yaml import YamlError, parse


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("5e7", 5e7),
        ("1e-3", 1e-3),
        (".5", 0.5),
        ("5.", 5.0),
        ("-0.0", -0.0),
        ("+12", 12),
        ("0x1F", 31),
        ("0o17", 15),
        ("017", 17),
        ("0b11", "0b11"),
        ("1_000", "1_000"),
        ("1:30", "1:30"),
        ("2024-01-01", "2024-01-01"),
        ("yes", "yes"),
        ("no", "no"),
        ("on", "on"),
        ("off", "off"),
        ("true", True),
        ("False", False),
        ("tRue", "tRue"),
        ("~", None),
        ("", None),
        ("Null", None),
        ("'12'", "12"),
        ('"true"', "true"),
        ("inf", "inf"),
        ("=", "="),
    ],
)
def test_scalars_are_those_of_yaml_1_2(text: str, value: object) -> None:
    document = parse(f"a: {text}\n")
    assert document.problems == []
    assert document.data == {"a": value}
    assert type(document.data["a"]) is type(value)  # type: ignore[index]


def test_keys_are_text() -> None:
    assert parse("1: a\non: b\nnull: c\n").data == {"1": "a", "on": "b", "null": "c"}


def test_lines_of_keys_and_items() -> None:
    lines = parse("# top\na:\n  b:\n    - 1\n    - c:\n        2\n").lines
    assert lines[()] == 2
    assert lines["a",] == 2
    assert lines["a", "b"] == 3
    assert lines["a", "b", 0] == 4
    assert lines["a", "b", 1, "c"] == 5


def test_aliases_are_written_out() -> None:
    assert parse("a: &x [1, 2]\nb: *x\n").data == {"a": [1, 2], "b": [1, 2]}


@pytest.mark.parametrize(
    ("text", "line", "keys", "words"),
    [
        ("a: 1\nb: 2\na: 3\n", 3, (), 'key "a" is given twice; the first is in line 1'),
        ("a: {b: 1, b: 1}\n", 1, ("a",), "twice"),
        ("x: 1\na: !!python/object/apply:os.system ['true']\n", 2, ("a",), "python/object/apply:os.system"),
        ("a: !!float 3\n", 1, ("a",), "tag !!float is not allowed"),
        ("a: !unit 3\n", 1, ("a",), "tag !unit is not allowed"),
        ("a: ! 3\n", 1, ("a",), "tag ! is not allowed"),
        ("a: !!map {b: 1}\n", 1, ("a",), "tag !!map"),
        ("!!str a: 1\n", 1, (), "key of plain text"),
        ("? [1, 2]\n: 3\n", 1, (), "key of plain text"),
        ("a: &x {b: 1}\nc:\n  <<: *x\n", 3, ("c",), "<<"),
        ("a:\n  - 1\n  - .NaN\n", 3, ("a", 1), "finite"),
        ("a: -.INF\n", 1, ("a",), "finite"),
        ("a: 1e400\n", 1, ("a",), "finite"),
        ('a: "\\ud800"\n', 1, ("a",), "surrogate"),
        ('"\\ud800": 1\n', 1, (), "surrogate"),
    ],
)
def test_problems_that_do_not_stop_the_reading(text: str, line: int, keys: tuple[object, ...], words: str) -> None:
    (problem,) = parse(text).problems
    assert (problem.line, problem.keys) == (line, keys)
    assert words in problem.message


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("a: 1\n\tb: 2\n", 2, "a tab"),
        ("a:\n\t- 1\n", 2, "a tab"),
        ("a: b: c\n", 1, 'a second ": "'),
        ("a: 1\nb\nc: 2\n", 3, 'expected "key: value" before this line'),
        ("a:\n    b: 1\n  c: 2\n", 3, "indented differently"),
        ("a: [1, 2\nb: 3\n", 2, "line 1"),
        ('a: "open\n', 2, "line 1"),
        ("a: 1\n---\nb: 2\n", 2, "second document"),
        ("a: *x\n", 1, "*x refers to"),
        ("a: &x [*x]\n", 1, "*x refers to"),
        ('a: "\\UFFFFFFFF"\n', 1, "not valid YAML"),
        ("a: @x\n", 1, "not valid YAML"),
        ("a: " + "[" * 60 + "]" * 60, 1, "nested"),
        ("a: [" + "1," * 30_000 + "]", 1, "more than 20000 values"),
    ],
)
def test_errors_that_stop_the_reading(text: str, line: int, words: str) -> None:
    with pytest.raises(YamlError) as caught:
        parse(text)
    assert caught.value.problem.line == line
    assert words in caught.value.problem.message


def test_a_bomb_does_not_go_off() -> None:
    lines = ["l0: &l0 [" + ", ".join(["lol"] * 9) + "]"]
    lines += [f"l{i}: &l{i} [" + ", ".join([f"*l{i - 1}"] * 9) + "]" for i in range(1, 30)]
    with pytest.raises(YamlError, match="aliases expand"):
        parse("\n".join(lines))


def test_a_chain_of_aliases_is_as_deep_as_it_is() -> None:
    lines = ["l0: &l0 [1]", *(f"l{i}: &l{i} [*l{i - 1}]" for i in range(1, 100))]
    with pytest.raises(YamlError, match="aliases expand"):
        parse("\n".join(lines))


@pytest.mark.skipif(not hasattr(yaml, "CSafeLoader"), reason="this PyYAML has no parser in C")
def test_both_parsers_of_pyyaml_read_the_same(bench, monkeypatch) -> None:
    """What a file means does not depend on whether PyYAML came with its parser in C."""
    text, draw = bench.rig.read_text(encoding="utf-8"), random.Random(1)
    texts = [text]
    for _ in range(1000):
        start = draw.randrange(len(text) - 60)
        some = list(text[start : start + draw.randrange(5, 60)])
        for _ in range(draw.randrange(1, 4)):
            some.insert(
                draw.randrange(len(some) + 1),
                draw.choice("{}[]:,-?&*!|>'\"%@`# \t\n\\~<=ab1.\u00e9\ufeff\r\u0085\u2028"),
            )
        texts.append("".join(some))

    def read(text: str) -> object:
        try:
            return parse(text)
        except YamlError as error:
            return error.problem

    quickly = [read(text) for text in texts]
    monkeypatch.delattr(yaml, "CSafeLoader")
    assert [read(text) for text in texts] == quickly
