"""Models, schemas and messages: nothing undescribed, nothing that falls through."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml
from hypothesis import HealthCheck, given, settings, strategies as st
from pydantic import ValidationError

from lightopt.config import PartConfig, RigConfig, json_schema, load_part, load_rig
from lightopt.config._part import MeshConfig
from lightopt.core.errors import InputError
from lightopt.core.units import MM_PER_UNIT

CONFIGS = Path(__file__).parents[2] / "configs"
# the kinds of error that the models can raise, each with its own message; any other gets a general one
KNOWN_ERRORS = frozenset(
    {"absent", "complaint", "expected", "extra_forbidden", "literal_error", "missing", "model_type", "too_long"}
    | {"too_short", "tuple_type"}
)
SAMPLES = [("rig", p) for p in sorted((CONFIGS / "rigs").glob("*.yaml"))]
SAMPLES += [("part", p) for p in sorted((CONFIGS / "parts").glob("*.yaml"))]


@pytest.mark.parametrize("kind", ["rig", "part", "batch"])
def test_committed_schema_is_fresh(kind: Any) -> None:
    committed = json.loads((CONFIGS / "schema" / f"{kind}.json").read_text(encoding="utf-8"))
    assert committed == json_schema(kind), "run scripts/write_schemas.py"


@pytest.mark.parametrize("kind", ["rig", "part", "batch"])
def test_every_field_is_described(kind: Any) -> None:
    schema = json_schema(kind)
    jsonschema.Draft202012Validator.check_schema(schema)
    assert schema["title"] == f"lightopt {kind}"
    for model in (schema, *schema["$defs"].values()):
        assert model["description"]
        assert model["additionalProperties"] is False
        for name, field in model["properties"].items():
            assert field.get("description", "").endswith("."), name


@pytest.mark.parametrize(("kind", "path"), SAMPLES, ids=lambda v: getattr(v, "stem", v))
def test_samples_satisfy_the_schema(kind: Any, path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert text.startswith(f"# yaml-language-server: $schema=../schema/{kind}.json\n")
    assert (path.parent / f"../schema/{kind}.json").is_file()
    validator = jsonschema.Draft202012Validator(json_schema(kind))
    data = yaml.safe_load(text)
    validator.validate(data)
    data["colour"] = 1
    assert not validator.is_valid(data)


def test_units_are_those_of_the_package() -> None:
    for units in MM_PER_UNIT:
        assert MeshConfig(file="a.stl", units=units).units == units  # type: ignore[arg-type]


RIG = load_rig(CONFIGS / "rigs" / "four-panel.yaml").model_dump(mode="json")
PART = load_part(CONFIGS / "parts" / "cover-knob.yaml").model_dump(mode="json")
PROBES: list[Any] = [None, True, 0, -1, 3, 1.5, 1e300, 10**299, float("nan"), "x", "12", "", "auto", "sum"]
PROBES += [[], [1], [2, 1], ["x", 1], [1, 2, 3], [None] * 1001, {}, {"a": 1}, {"name": "x"}, object()]


def paths(data: Any, here: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Of what is listed, only the first two: all others are of the same kind."""
    if here:
        yield here
    items = data.items() if isinstance(data, dict) else enumerate(data[:2]) if isinstance(data, list) else ()
    for key, value in items:
        yield from paths(value, (*here, key))


def with_value(data: Any, path: tuple[Any, ...], value: Any) -> Any:
    """A copy of nested data with another value at a path; what is beside the path is shared."""
    changed = copy.copy(data)
    changed[path[0]] = value if len(path) == 1 else with_value(data[path[0]], path[1:], value)
    return changed


def error_kinds(model: Any, data: Any, folder: Path) -> set[str]:
    try:
        model.model_validate(data, context={"folder": folder})
    except ValidationError as error:
        return {e["type"] for e in error.errors()}
    return set()


@pytest.mark.parametrize(("model", "data"), [(RigConfig, RIG), (PartConfig, PART)])
def test_no_kind_of_error_falls_through(model: Any, data: Any, tmp_path: Path) -> None:
    changed = (with_value(data, path, probe) for path in paths(data) for probe in PROBES)
    kinds = {kind for value in changed for kind in error_kinds(model, value, tmp_path)}
    assert kinds <= KNOWN_ERRORS
    assert {"expected", "complaint", "missing", "extra_forbidden", "model_type"} <= kinds


@pytest.mark.parametrize(("load", "data"), [(load_rig, RIG), (load_part, PART)])
def test_strict_about_types(load: Any, data: Any, tmp_path: Path) -> None:
    """Every leaf of the samples refuses a boolean, and every number refuses its own text."""
    (tmp_path / "cover-knob.step").write_bytes((CONFIGS / "parts" / "cover-knob.step").read_bytes())
    file = tmp_path / "x.yaml"
    for path in paths(data):
        inner = data
        for key in path:
            inner = inner[key]
        if isinstance(inner, (dict, list)):
            continue
        for value in (True, str(inner)) if isinstance(inner, (int, float)) else (True,):
            file.write_text(json.dumps(with_value(data, path, value)))
            with pytest.raises(InputError, match="expected"):
                load(file)


def test_integers_are_numbers() -> None:
    rig = RigConfig.model_validate(with_value(RIG, ("camera", "distance_mm"), 550))
    assert type(rig.camera.distance_mm) is float


# ---- whatever is in the file, the answer is a configuration or an InputError

TOKENS = [
    "format: ",
    "lightopt-rig/1",
    "\n",
    "  ",
    "- ",
    "lights:",
    "camera:",
    "[",
    "]",
    "{",
    "}",
    ":",
    ",",
    "&a ",
    "*a",
]
TOKENS += ["!!x ", "'", '"', "#", "|", ">", "?", "%", "---", "...", "1e5", "~", ".nan", "\t", "<<: ", "\\", "\x85", "é"]
SCALARS = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8)
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=8,
)
QUICK = settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture], database=None)


def check(data: bytes, folder: Path) -> None:
    file = folder / "x.yaml"
    file.write_bytes(data)
    for message in (*complaints(load_rig, file), *complaints(load_part, file)):
        assert message.startswith(str(file))
        assert "Input should" not in message
        assert "cannot be used here" not in message
        message.encode()
        assert message.removeprefix(str(file)).isprintable()


def complaints(load: Any, file: Path) -> tuple[str, ...]:
    try:
        load(file)
    except InputError as error:
        return error.messages or ("no message at all",)
    return ()


@QUICK
@given(data=st.binary(max_size=60))
def test_any_bytes(data: bytes, tmp_path: Path) -> None:
    check(data, tmp_path)


@pytest.mark.slow
@QUICK
@given(tokens=st.lists(st.sampled_from(TOKENS) | st.text(max_size=3), max_size=20))
def test_any_text(tokens: list[str], tmp_path: Path) -> None:
    check("".join(tokens).encode("utf-8", "replace"), tmp_path)


@QUICK
@given(draw=st.data(), value=VALUES)
def test_any_value_anywhere(draw: st.DataObject, value: Any, tmp_path: Path) -> None:
    base = draw.draw(st.sampled_from([RIG, PART]))
    path = draw.draw(st.sampled_from(sorted(paths(base), key=str)))
    check(json.dumps(with_value(base, path, value)).encode(), tmp_path)
    if isinstance(path[-1], str):
        other = (*path[:-1], draw.draw(st.text(max_size=8)))
        check(json.dumps(with_value(base, other, value)).encode(), tmp_path)
